"""Quantities of a run as a table: a row for each quantity, a column for each route."""

from collections.abc import Iterator, Sequence
from math import ceil, floor, log10

from cases.output.records import Record

DIGITS = 7
"""Significant digits shown at most."""

SMALL = 1e-3
"""Error below which a number that may be zero is shown as zero and its error."""

NOTE = (
    "(3): error of the last digits, numerical or one standard error of sampling;\n"
    "without it the error is below the last digit."
)


def concise(value: float | None, error: float | None) -> str:
    """Return a number with its error in brackets, in units of the last digits: ``0.4123(5)``.

    The error is rounded up. There are no brackets where it is below the last of ``DIGITS`` digits;
    a number within its error of zero is ``0(2e-10)``; a dash stands for what is not known.
    """
    if value is None or error is None:
        return "–"
    if error == 0.0:
        return f"{value:.{DIGITS}g}"
    if abs(value) <= error < SMALL:
        unit = 10.0 ** floor(log10(error))
        return f"0({ceil(round(error / unit, 9)) * unit:.0e})"
    magnitude = floor(log10(max(abs(value), error)))
    last = magnitude - DIGITS + 1
    shift = magnitude if not -4 <= magnitude < 6 else 0
    suffix = f"e{shift:+03d}" if shift else ""
    bracket = ""
    if error >= 0.5 * 10.0**last:
        # Two digits of an error that begins with 1.
        leading = floor(log10(error))
        last = leading - (1 if error < 2.0 * 10.0**leading else 0)
        count = ceil(round(error / 10.0**last, 9))
        decimals = shift - last
        bracket = f"({count})" if decimals >= 0 else f"({count * 10**-decimals})"
    decimals = max(shift - last, 0)
    return f"{value / 10.0**shift:.{decimals}f}{bracket}{suffix}"


def shown_routes(rows: Sequence[Record]) -> list[str]:
    """Return of each method the first route that solves and the one that samples.

    Other solvers of the same equation agree with the first within their errors, or the run fails.
    """
    chosen: dict[tuple[str, str], str] = {}
    for row in rows:
        chosen.setdefault((row["route"].partition("/")[0], row["error_kind"]), row["route"])
    return list(chosen.values())


def quantity_tables(rows: Sequence[Record], width: int, every: bool = False) -> list[str]:
    """Return the lines of a table of each observable, no wider than ``width`` where that can be.

    Columns that do not fit are in a second table below. ``every``: all routes.
    """
    lines: list[str] = []
    for heads, columns in quantity_columns(rows, every=every):
        first = max(map(len, heads))
        for together in _blocks(columns, width - first - 2):
            widths = [max(map(len, column)) for column in together]
            for head, *row in zip(heads, *together, strict=True):
                texts = map(str.rjust, row, widths)
                lines.append("  ".join([head.ljust(first), *texts]).rstrip())
            lines.append("")
    return lines


def quantity_columns(
    rows: Sequence[Record], *, every: bool
) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Yield of each observable its name above its quantities, and each route above its numbers."""
    for observable in dict.fromkeys(row["observable"] for row in rows):
        own = [row for row in rows if row["observable"] == observable]
        routes = list(dict.fromkeys(row["route"] for row in own)) if every else shown_routes(own)
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
