"""Quantities of a run as tables: a row for each quantity, a column for each route or theory."""

from collections.abc import Iterator, Sequence
from textwrap import wrap

from cases.output.records import Record
from cases.output.words import named, theory_of_route
from cases.scene.units import bracketed
from cases.written import concise


def shown_rows(rows: Sequence[Record]) -> list[Record]:
    """Return the quantities by the first route of each method that solves, and that samples.

    Chosen for each observable on its own. Other solvers of the same equation agree with the first
    within their errors, or the run fails.
    """
    first: dict[tuple[str, str, str], str] = {}

    def route_of(row: Record) -> str:
        key = row["observable"], row["route"].partition("/")[0], row["error_kind"]
        return first.setdefault(key, row["route"])

    return [row for row in rows if route_of(row) == row["route"]]


def theory_table(rows: Sequence[Record]) -> Record:
    """Return the names of the theories as ``routes``, and of each quantity a cell by theory.

    Of ``rows``, each with its observable (``of``), ``quantity`` and ``cells``, those of
    ``shown_rows`` are taken; their units stand behind the quantities.
    """
    cells: dict[tuple[str, str], Record] = {}
    for row in shown_rows(rows):
        name = theory_of_route(row["route"])
        quantity = row["quantity"] + bracketed(row.get("unit") or "")
        cells.setdefault((row["observable"], quantity), {})[name] = row
    return {
        "routes": list(dict.fromkeys(name for own in cells.values() for name in own)),
        "rows": [{"of": of, "quantity": q, "cells": own} for (of, q), own in cells.items()],
    }


def quantity_tables(rows: Sequence[Record], width: int, every: bool = False) -> list[str]:
    """Return the lines of a table of each observable, see ``text_table``. ``every``: all routes."""
    lines: list[str] = []
    for heads, columns in quantity_columns(rows, every=every):
        lines += [*text_table([heads, *columns], width), ""]
    return lines


def quantity_columns(
    rows: Sequence[Record], *, every: bool = True
) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Yield of each observable its name above its quantities, and each route above its numbers.

    Of ``every`` route, else of those of ``shown_rows``, by the names of the theories.
    """
    rows = rows if every else shown_rows(rows)
    for observable in dict.fromkeys(row["observable"] for row in rows):
        own = [row for row in rows if row["observable"] == observable]
        routes = list(dict.fromkeys(row["route"] for row in own))
        cells = {(r["quantity"], r["route"]): concise(r["value"], r["error"]) for r in own}
        units = {row["quantity"]: bracketed(row.get("unit") or "") for row in own}
        heads = [observable, *(name + unit for name, unit in units.items())]
        words = named if every else theory_of_route
        yield heads, [[words(r), *(cells.get((n, r), "") for n in units)] for r in routes]


def text_table(columns: Sequence[Sequence[str]], width: int, words: int = 1) -> list[str]:
    """Return the lines of a table no wider than ``width`` where that can be.

    ``columns`` begin with their heads; the first ``words`` of them are text, the others numbers,
    which stand at the right. Where they do not fit, heads and texts go on in a line below; what
    then still does not fit is in another table below, with the first column again.
    """
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
        for row in zip(*(columns[k] for k in chosen), strict=True):
            cells = [wrap(t, max(own[k], 1)) or [""] for k, t in zip(chosen, row, strict=True)]
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
    """Indices of columns of such ``sizes`` that fit together, at least one in each block."""
    blocks: list[list[int]] = []
    left = -1
    for k, size in enumerate(sizes):
        left -= size + 2
        if left < 0:
            blocks.append([])
            left = width - size - 2
        blocks[-1].append(k)
    return blocks
