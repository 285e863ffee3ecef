"""Tables of a study: the same rows for a terminal and for a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable


@dataclass(frozen=True)
class Table:
    """A table with a title and, below it, remarks."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()


def terminal_text(title: str, tables: Sequence[Table]) -> str:
    """Return the tables drawn by rich, wide enough for their words."""
    stream = StringIO()
    console = Console(file=stream, width=130, highlight=False, emoji=False, markup=False)
    console.print(title)
    for table in tables:
        drawn = RichTable(title=table.title, box=SIMPLE_HEAD, title_justify="left", pad_edge=False)
        for k, name in enumerate(table.head):
            drawn.add_column(name, justify="left" if k == 0 else "right", overflow="fold")
        for row in table.rows:
            drawn.add_row(*row)
        console.print(drawn)
        for remark in table.remarks:
            console.print(remark)
    return stream.getvalue().rstrip()


def markdown_text(title: str, tables: Sequence[Table]) -> str:
    """Return the tables as a Markdown page."""
    parts = [f"# {title}", ""]
    for table in tables:
        parts += [f"## {table.title}", ""]
        parts += ["| " + " | ".join(table.head) + " |", "|---|" + "---:|" * (len(table.head) - 1)]
        parts += ["| " + " | ".join(row) + " |" for row in table.rows]
        parts += ["", *(line for remark in table.remarks for line in (remark, ""))]
    return "\n".join(parts).rstrip() + "\n"


def shown(value: float, digits: int = 2) -> str:
    """Return a number of a table; a dash where there is none."""
    return "–" if value != value else f"{value:.{digits}e}"


def shown_order(value: float, spread: float | None = None) -> str:
    """Return an order with its spread; a dash where there is none."""
    if value != value:
        return "–"
    return f"{value:.2f}" if spread is None else f"{value:.2f} ± {spread:.2f}"
