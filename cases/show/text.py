"""Records as text and as HTML, by templates, with tables of quantities; refusals in words."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, reduce
from html import escape
from itertools import chain, groupby, repeat
from pathlib import Path
from textwrap import wrap
from typing import Any, get_args

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from cases.compare.claims import Verdict
from cases.scene.units import in_brackets
from cases.scene.written import NOTE, bound, duration, number, up, with_error
from cases.show.digest import curves_of
from cases.show.records import Record
from cases.show.words import effects_in_words, reader_words, theory_of_route, with_key
from fpk.answer.method import solvers_of


def render(template: str, record: Mapping[str, Any]) -> str:
    """Return the file ``template`` of ``templates`` with ``record`` filled in, escaped in HTML."""
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
        "named": reader_words,
        "theory": theory_of_route,
        "keyed": with_key,
        "effects": effects_in_words,
        "unit": in_brackets,
        "table": text_table,
        "pm": with_error,
        "bound": bound,
        "up": up,
        "reasons": refusals_of,
        "answerer": lambda answer: f"{answer['words']} ({answer['solves']} equation)",
        "words": _answer_words,
        "tail": tail_words,
        "curves": curves_of,
        "verdict": verdict_of,
        "counted": claims_counted,
    }
    return environment


def _claim(claim: Record) -> str:
    """Return the claim, the curve that it is about and the measured number in words."""
    where = f"{claim['curve']}: " if claim["curve"] else ""
    return reader_words(f"{claim['claim']}; {where}{claim['measured']}")


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


def tail_words(row: Record) -> str:
    """Return a row of ``Answers.tails`` in words: P beyond a level, and a theory's factor to it."""
    sign = ">" if row["side"] == "above" else "<"
    beyond = f"P({row['observable']} {sign} {row['level']:.3g})"
    theory, reference = reader_words(row["theory"]), reader_words(row["reference"])
    ratio = with_error(row["ratio"], row["error"])
    known = number(row["probability"], 2)
    return f"tail: {beyond} is {known} by {reference}; {theory} gives {ratio} times that"


def _answer_words(label: str, question: Record) -> str:
    """Return theory and solver in words of the answer to ``question`` by the route ``label``."""
    words: dict[str, str] = {answer["route"]: answer["words"] for answer in question["answers"]}
    return words[label]


def refusals_of(curve: Record) -> list[Record]:
    """Return the refusals in ``curve``, an entry of ``curves_of``; one entry for each reason.

    ``routes`` names the theories in words, with their solvers if a theory has several; ``methods``
    has dictionaries, whose keys are solvers, by key of a theory; ``observables`` has the names that
    are refused. ``reason``, ``failed`` and ``gave_up`` are fields of ``refusal_record``.
    """
    joined: dict[tuple[str, bool, bool], Record] = {}
    for r in curve["methods"]:
        if not r["applies"]:
            reason = reduce(str.removeprefix, (f"{o}: " for o in r["observables"]), r["reason"])
            key = reason, r["failed"], r["gave_up"]
            entry = joined.setdefault(key, {"methods": {}, "observables": {}})
            entry["observables"] |= dict.fromkeys(r["observables"])
            entry["methods"].setdefault(r["method"], {})[r["solver"]] = None
    for (reason, failed, gave_up), entry in joined.items():
        routes = (
            theory_of_route(method)
            + (f" ({', '.join(own)})" if len(solvers_of(method)) > 1 else "")
            for method, own in entry["methods"].items()
        )
        entry |= {"routes": ", ".join(routes), "observables": list(entry["observables"])}
        entry |= {"reason": reason, "failed": failed, "gave_up": gave_up}
    return list(joined.values())


def verdict_of(digest: Record) -> str:
    """Return how many comparisons of a run were judged and how many checks fail, in words."""
    if digest["problems"]:
        count = len(digest["problems"])
        words = "1 check fails" if count == 1 else f"{count} checks fail"
        return f"{digest['judged']} judged comparisons, {words}"
    if not digest["judged"]:
        return "nothing to compare, every certificate holds"
    return f"{digest['judged']} judged comparisons, every check holds"


def claims_counted(claims: list[Record]) -> str:
    """Return how many claims of the source have which verdict: ``2 hold, 1 undecided``."""
    count = Counter(claim["verdict"] for claim in claims)
    plural = {"holds": "hold", "does not hold": "do not hold"}
    return ", ".join(
        f"{count[verdict]} {verdict if count[verdict] == 1 else plural.get(verdict, verdict)}"
        for verdict in get_args(Verdict)
        if count[verdict]
    )


def theory_table(rows: Sequence[Record], *, every: bool = False) -> Record:
    """Return a table of quantities with a column for each theory, whose names are ``routes``.

    ``rows`` are by ``quantity_row``, of one curve. ``every``: a column for each route; else for the
    first route of each method that solves, and that samples, chosen for each observable on its own.
    ``solved_by`` has the names of the columns by the equation, "full" or "averaged". Each of its
    ``rows`` has its observable (``of``), its ``quantity`` with the unit, and, in ``cells``, the
    given row by column if there is one.
    """
    first: dict[tuple[str, str, str], str] = {}
    cells: dict[tuple[str, str], Record] = {}
    solved_by: dict[str, list[str]] = {}
    words = reader_words if every else theory_of_route
    routes: dict[str, None] = {}
    for row in rows:
        key = row["observable"], row["route"].partition("/")[0], row["error_kind"]
        if every or first.setdefault(key, row["route"]) == row["route"]:
            name, quantity = words(row["route"]), row["label"] + in_brackets(row.get("unit") or "")
            if name not in routes:
                solved_by.setdefault(row["solves"], []).append(name)
            routes[name] = None
            cells.setdefault((row["observable"], quantity), {})[name] = row
    return {
        "routes": list(routes),
        "solved_by": solved_by,
        "rows": [{"of": of, "quantity": q, "cells": own} for (of, q), own in cells.items()],
    }


def quantity_tables(rows: Sequence[Record], width: int, every: bool = False) -> list[str]:
    """Return lines of a ``text_table`` and an empty line for each table of ``quantity_rows``."""
    lines: list[str] = []
    for table in quantity_rows(rows, every=every):
        lines += [*text_table(table, width), ""]
    return lines


def quantity_rows(rows: Sequence[Record], *, every: bool = True) -> Iterator[list[list[str]]]:
    """Yield the ``theory_table`` of each observable as rows of text: routes, equations, numbers."""
    for observable, own in groupby(rows, key=lambda row: row["observable"]):
        table = theory_table([*own], every=every)
        routes = table["routes"]
        solves = {name: kind for kind, names in table["solved_by"].items() for name in names}
        yield [
            [observable, *routes],
            ["equation solved", *(solves[name] for name in routes)],
            *(
                [row["quantity"], *(_cell(row["cells"].get(r)) for r in routes)]
                for row in table["rows"]
            ),
        ]


def _cell(row: Record | None) -> str:
    return with_error(row["value"], row["error"]) if row else ""


def html_table(rows: Sequence[Sequence[str]]) -> str:
    """Return the rows as a table of HTML, the heads of the columns first; texts are escaped."""
    head, *body = (
        f"<tr>{''.join(f'<{tag}>{escape(text)}</{tag}>' for text in row)}</tr>"
        for row, tag in zip(rows, chain(["th"], repeat("td")), strict=False)
    )
    return f"<table><thead>{head}</thead><tbody>{''.join(body)}</tbody></table>"


def text_table(rows: Sequence[Sequence[str]], width: int, words: int = 1) -> list[str]:
    """Return the lines of a table no wider than ``width`` columns if that is possible.

    ``rows`` begin with the heads of the columns; without further rows there are no lines. The first
    ``words`` columns are text, the others numbers, aligned right. In a narrow table heads and texts
    are wrapped; columns that still do not fit follow in another table, with the first column again.
    """
    if len(rows) < 2:
        return []
    columns = list(zip(*rows, strict=True))
    least = [max(len(w) for text in column for w in text.split() or [""]) for column in columns]
    numbers = [max(map(len, c[1:]), default=0) for c in columns]
    least[words:] = map(max, least[words:], numbers[words:])
    sizes = [max(map(len, column)) for column in columns]
    lines: list[str] = []
    for block in _blocks(least[1:], width - least[0]):
        chosen = [0, *(k + 1 for k in block)]
        own = {k: sizes[k] for k in chosen}
        while sum(own.values()) + 2 * len(own) - 2 > width:
            k = max(chosen, key=lambda k: (own[k] > least[k], own[k] - least[k], own[k]))
            if own[k] == least[k]:
                break
            own[k] -= 1
        for row in rows:
            cells = [wrap(row[k], max(own[k], 1)) or [""] for k in chosen]
            for i in range(max(map(len, cells))):
                texts = [cell[i] if i < len(cell) else "" for cell in cells]
                aligned = (
                    t.ljust(own[k]) if k < words else t.rjust(own[k])
                    for k, t in zip(chosen, texts, strict=True)
                )
                lines.append("  ".join(aligned).rstrip())
        lines.append("")
    return lines[:-1]


def _blocks(sizes: Sequence[int], width: int) -> list[list[int]]:
    """Split column indices into blocks with ``sizes``, + 2 each, within ``width`` if possible."""
    blocks: list[list[int]] = []
    left = -1
    for k, size in enumerate(sizes):
        left -= size + 2
        if left < 0:
            blocks.append([])
            left = width - size - 2
        blocks[-1].append(k)
    return blocks
