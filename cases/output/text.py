"""Records as text and as HTML, by templates; damping terms and claims in words."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from cases.output.digest import claims_counted, curves_of, refusals_of, verdict_of
from cases.output.records import Record
from cases.output.tables import quantity_tables, text_table
from cases.output.words import effects_in_words, named, theory_of_route, with_key
from cases.scene.units import bracketed
from cases.written import NOTE, bound, duration, number, up, with_error


def rendered(template: str, record: Mapping[str, Any]) -> str:
    """Return the record in the form of a template; in HTML all its text is escaped."""
    return _templates().get_template(template).render(record).rstrip("\n")


@cache
def _templates() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=lambda name: name is not None and name.endswith("html"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["quantity_note"] = NOTE
    environment.filters |= {
        "quantities": quantity_tables,
        "num": number,
        "ljust": str.ljust,
        "duration": duration,
        "short": _short,
        "diagonal": _diagonal,
        "term": _term,
        "claim": _claim,
        "named": named,
        "theory": theory_of_route,
        "keyed": with_key,
        "effects": effects_in_words,
        "unit": bracketed,
        "table": _rows_table,
        "pm": with_error,
        "bound": bound,
        "up": up,
        "reasons": refusals_of,
        "curves": curves_of,
        "verdict": verdict_of,
        "counted": claims_counted,
    }
    return environment


def _claim(claim: Record) -> str:
    """Return the claim, the curve that it is about and what was measured."""
    where = f"{claim['curve']}: " if claim["curve"] else ""
    return named(f"{claim['claim']}; {where}{claim['measured']}")


def _rows_table(rows: list[list[str]], width: int, words: int = 1) -> list[str]:
    """Return the lines of a table of rows, the heads first, as ``text_table`` of its columns."""
    return text_table(list(zip(*rows, strict=True)), width, words) if len(rows) > 1 else []


def _term(term: Record) -> str:
    """The damping term as an equation: ``c11 += 0.05 q1^2 v2^2 H``."""
    powers = [(f"{key}{mass}", n) for key in ("q", "v") for mass, n in term[key].items()]
    powers += [("H", term["energy"])] if term["energy"] else []
    factors = [name if n == 1 else f"{name}^{n}" for name, n in powers]
    return f"c{term['i']}{term['j']} += {' '.join([_short(term['coefficient']), *factors])}"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_short(v) for v in value) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _diagonal(matrix: list[list[float]]) -> str:
    off = [x for i, row in enumerate(matrix) for j, x in enumerate(row) if i != j]
    if any(off):
        return "; ".join(_short(row) for row in matrix)
    return _short([row[i] for i, row in enumerate(matrix)])
