"""Output of a study: tables for a terminal and a page, rows as netCDF, all files in one writer."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable

from cases.output.fields import write_dataset
from cases.output.files import write_text
from cases.output.records import program_version
from cases.output.svg import svg_text
from cases.scene.scene import Scene

UNITS = ((3.156e7, "a"), (86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"))


@dataclass(frozen=True)
class Table:
    """A table with a title and, below it, remarks; ``cell`` says how values are written."""

    title: str
    head: tuple[str, ...]
    rows: Sequence[Sequence[Any]]
    remarks: tuple[str, ...] = ()

    def text(self) -> list[list[str]]:
        """Return the rows in words; what the first column repeats is left out."""
        rows = [[cell(value) for value in row] for row in self.rows]
        firsts = [row[0] for row in rows]
        for row, first, before in zip(rows[1:], firsts[1:], firsts, strict=False):
            row[0] = "" if first == before else first
        return rows


class Seconds(float):
    """A time, written with a unit that suits it."""

    def __str__(self) -> str:
        """Return the time with its unit."""
        for size, unit in UNITS:
            if self >= size:
                value = self / size
                return f"{value:.3g} {unit}" if value < 1e4 else f"{value:.1e} {unit}"
        return "–" if self != self else f"{self * 1e3:.2g} ms"


class Bytes(float):
    """A memory, written in MB."""

    def __str__(self) -> str:
        """Return the memory in MB."""
        return "–" if self != self else f"{self / 1e6:.2g} MB"


def cell(value: Any) -> str:
    """Return a value of a table in words: 2 decimals of a plain number, a dash for none."""
    if value is None or value == "" or value != value:
        return "–"
    return f"{value:.2e}" if type(value) is float or isinstance(value, np.floating) else str(value)


def terminal_text(title: str, tables: Sequence[Table]) -> str:
    """Return the tables drawn by rich, wide enough for their words."""
    stream = StringIO()
    console = Console(file=stream, width=130, highlight=False, emoji=False, markup=False)
    console.print(title)
    for table in tables:
        drawn = RichTable(title=table.title, box=SIMPLE_HEAD, title_justify="left", pad_edge=False)
        for k, name in enumerate(table.head):
            drawn.add_column(name, justify="left" if k == 0 else "right", overflow="fold")
        for row in table.text():
            drawn.add_row(*row)
        console.print(drawn)
        for remark in table.remarks:
            console.print(remark)
    return stream.getvalue().rstrip()


def markdown_text(title: str, tables: Sequence[Table]) -> str:
    """Return the tables as a Markdown page."""
    parts = [f"# {title}", ""]
    for table in tables:
        parts += [f"## {table.title}", ""] if table.title else []
        parts += ["| " + " | ".join(table.head) + " |", "|---|" + "---:|" * (len(table.head) - 1)]
        parts += ["| " + " | ".join(row) + " |" for row in table.text()]
        parts += ["", *(line for remark in table.remarks for line in (remark, ""))]
    return "\n".join(parts).rstrip() + "\n"


def rows_dataset(**rows: Sequence[Mapping[str, Any]]) -> xr.Dataset:
    """Return rows of equal keys as variables, one dimension for each keyword."""
    data = xr.Dataset()
    for dimension, records in rows.items():
        for key in records[0] if records else ():
            column = [record[key] for record in records]
            kind = float if isinstance(column[0], bool) else None
            data[key] = (dimension, np.array(column, dtype=kind))
    return data


def write_study(
    name: str,
    folder: Path,
    scene: Scene,
    *,
    title: str,
    page: str,
    data: xr.Dataset,
    figure: Figure,
) -> list[Path]:
    """Write ``name`` with the endings md, nc and svg; return their paths."""
    paths = [folder / f"{name}.{ending}" for ending in ("md", "nc", "svg")]
    data.attrs |= {
        "title": title,
        "scene": scene.name,
        "scene_file": scene.text,
        "program": f"vibro-fpk {program_version()}",
    }
    write_text(paths[0], page)
    write_dataset(data, paths[1])
    write_text(paths[2], svg_text(figure, salt=name))
    return paths
