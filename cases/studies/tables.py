"""Output of a study: tables as Markdown, rows as netCDF, a picture; all files in one writer."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from cases.output.fields import write_dataset
from cases.output.files import write_text
from cases.output.records import program_version
from cases.output.svg import svg_text
from cases.scene.scene import Scene

UNITS = ((3.156e7, "a"), (86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"))


@dataclass(frozen=True)
class Table:
    """A table with a title and, below it, remarks; ``cell`` says how values are written.

    ``head`` names the columns, separated by " | ".
    """

    title: str
    head: str
    rows: Sequence[Sequence[Any]]
    remarks: tuple[str, ...] = ()

    def markdown(self) -> list[str]:
        """Return title, rows in aligned columns, and remarks; repeats of a first cell are empty."""
        rows = [[cell(value) for value in row] for row in self.rows]
        firsts = [row[0] for row in rows]
        for row, first, before in zip(rows[1:], firsts[1:], firsts, strict=False):
            row[0] = "" if first == before else first
        head = self.head.split(" | ")
        widths = [max(3, *map(len, column)) for column in zip(head, *rows, strict=True)]
        rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
        lines = [f"## {self.title}", ""] if self.title else []
        for first, *others in (head, rule, *rows):
            cells = [first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]
            lines.append(f"| {' | '.join(cells)} |")
        return [*lines, "", *(line for remark in self.remarks for line in (remark, ""))]


def duration(seconds: float) -> str:
    """Return a time with a unit that suits it."""
    size, unit = next((u for u in UNITS if seconds >= u[0]), (1e-3, "ms"))
    value = seconds / size
    return (
        "–" if value != value else f"{value:.3g} {unit}" if value < 1e4 else f"{value:.1e} {unit}"
    )


def megabytes(size: float) -> str:
    """Return a memory in MB."""
    return "–" if size != size else f"{size / 1e6:.2g} MB"


def cell(value: Any) -> str:
    """Return a value of a table in words: three digits of a plain number, a dash for none."""
    if isinstance(value, tuple):
        value = " ".join(map(cell, value))
    if value is None or value == "" or value != value:
        return "–"
    if not isinstance(value, float):
        return str(value)
    return f"{value:#.3g}" if 0.01 <= abs(value) < 100 or not value else f"{value:.2e}"


@dataclass(frozen=True)
class Page:
    """What a study shows: its title, tables and closing words, rows for netCDF, and a picture.

    ``summary`` is all that is printed once the page is written, empty for the page itself; ``csv``
    returns lines of comma-separated values where a study has them.
    """

    name: str
    scene: Scene
    title: str
    tables: Sequence[Table]
    data: Callable[[], xr.Dataset]
    figure: Callable[[], Figure]
    closing: str = ""
    summary: str = ""
    csv: Callable[[], str] | None = None

    def text(self) -> str:
        """Return the page as Markdown, which a terminal shows as it is."""
        lines = [f"# {self.title}", "", *(line for t in self.tables for line in t.markdown())]
        return "\n".join([*lines, self.closing]).rstrip() + "\n"

    def write(self, folder: Path) -> list[Path]:
        """Write files of the study's name, md, nc, svg and where there are lines csv."""
        endings = ("md", "nc", "svg", "csv")[: 3 if self.csv is None else 4]
        paths = [folder / f"{self.name}.{ending}" for ending in endings]
        data = self.data()
        data.attrs |= {
            "title": self.title,
            "scene": self.scene.name,
            "scene_file": self.scene.text,
            "program": f"vibro-fpk {program_version()}",
        }
        write_text(paths[0], self.text())
        write_dataset(data, paths[1])
        write_text(paths[2], svg_text(self.figure(), salt=self.name))
        if self.csv is not None:
            write_text(paths[3], self.csv())
        return paths


def rows_dataset(**rows: Sequence[Mapping[str, Any]]) -> xr.Dataset:
    """Return rows of equal keys as variables, one dimension for each keyword."""
    data = xr.Dataset()
    for dimension, records in rows.items():
        for key in records[0] if records else ():
            column = [record[key] for record in records]
            kind = float if isinstance(column[0], bool) else None
            data[key] = (dimension, np.array(column, dtype=kind))
    return data
