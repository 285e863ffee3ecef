"""Quantities of a run as tables: a row for each quantity, a column for each route or theory."""

from collections.abc import Iterator, Sequence

from cases.output.records import Record
from cases.output.words import theory_of_route
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
    ``shown_rows`` are taken.
    """
    cells: dict[tuple[str, str], Record] = {}
    for row in shown_rows(rows):
        name = theory_of_route(row["route"])
        cells.setdefault((row["observable"], row["quantity"]), {})[name] = row
    return {
        "routes": list(dict.fromkeys(name for own in cells.values() for name in own)),
        "rows": [{"of": of, "quantity": q, "cells": own} for (of, q), own in cells.items()],
    }


def quantity_tables(rows: Sequence[Record], width: int, every: bool = False) -> list[str]:
    """Return the lines of a table of each observable, no wider than ``width`` where that can be.

    Columns that do not fit are in a second table below. ``every``: all routes.
    """
    lines: list[str] = []
    for heads, columns in quantity_columns(rows if every else shown_rows(rows)):
        first = max(map(len, heads))
        for together in _blocks(columns, width - first - 2):
            widths = [max(map(len, column)) for column in together]
            for head, *row in zip(heads, *together, strict=True):
                texts = map(str.rjust, row, widths)
                lines.append("  ".join([head.ljust(first), *texts]).rstrip())
            lines.append("")
    return lines


def quantity_columns(rows: Sequence[Record]) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Yield of each observable its name above its quantities, and each route above its numbers."""
    for observable in dict.fromkeys(row["observable"] for row in rows):
        own = [row for row in rows if row["observable"] == observable]
        routes = list(dict.fromkeys(row["route"] for row in own))
        cells = {(r["quantity"], r["route"]): concise(r["value"], r["error"]) for r in own}
        names = list(dict.fromkeys(row["quantity"] for row in own))
        columns = [[route, *(cells.get((n, route), "") for n in names)] for route in routes]
        yield [observable, *names], columns


def _blocks(columns: Sequence[list[str]], width: int) -> list[list[list[str]]]:
    """The columns in blocks that are no wider than ``width``, at least one in each."""
    blocks: list[list[list[str]]] = []
    left = -1
    for column in columns:
        left -= max(map(len, column)) + 2
        if left < 0:
            blocks.append([])
            left = width - max(map(len, column))
        blocks[-1].append(column)
    return blocks
