"""Output of a study: tables as Markdown and netCDF, and a picture; all files in one writer."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import pairwise
from math import nan
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from cases.scene.scene import Scene
from cases.scene.units import attribute, in_brackets
from cases.scene.written import duration
from cases.show.fields import attributes_of, write_variables
from cases.show.files import write_text
from cases.show.page import PLOTS, as_script_data, origin_record, page_record, script_record
from cases.show.pictures.draw import study_figure
from cases.show.pictures.panel import Field, Panel, live_plots
from cases.show.pictures.svg import svg_text
from cases.show.text import html_table, render, text_table
from cases.show.variables import Variables
from cases.show.words import reader_words

MARKUP = re.compile(r"[\\`*_\[\]<>&#|~$]")
"""Characters to which Markdown gives a meaning inside a line, HTML and formulas included."""

FORMATS: Mapping[str, Callable[[Any], str]] = {
    **dict.fromkeys(("seconds", "quartiles ±", "first call more"), duration),
    **dict.fromkeys(("coefficients", "simulation to this"), duration),
    "memory": lambda size: f"{size / 1e6:.2g} MB",
    **dict.fromkeys(("mean", "limit"), "{:.6g}".format),
    "value": "{:.10g}".format,
}
"""Functions that write the values of a column, by its name; others are written to three digits."""


def cell(value: Any, column: str = "") -> str:
    """Return ``value`` as text: floats by ``FORMATS[column]`` or to three digits.

    A dash for None, NaN and empty text; the entries of a tuple are separated by spaces.
    """
    if isinstance(value, tuple):
        value = " ".join(map(cell, value))
    if value is None or value == "" or value != value:
        return "–"
    if not isinstance(value, float):
        return str(value)
    if column in FORMATS:
        return FORMATS[column](value)
    return f"{value:#.3g}" if 0.01 <= abs(value) < 100 or not value else f"{value:.2e}"


@dataclass(frozen=True)
class Table:
    """Rows of equal keys, which are the columns, under a title; remarks stand below them.

    ``name`` is the dimension of the rows in netCDF; ``units`` has the unit of a column by its name.
    The first ``parameters`` columns have numbers that were given: they are shown to ten digits. All
    methods need one row at least.
    """

    name: str
    title: str
    rows: Sequence[Mapping[str, Any]]
    remarks: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    parameters: int = 0

    def cells(self) -> tuple[list[str], list[list[str]]]:
        """Return the names of the columns with their units, and the rows, all as text."""
        rows = [[reader_words(cell(v, column)) for column, v in row.items()] for row in self.rows]
        for row, own in zip(self.rows, rows, strict=True):
            own[: self.parameters] = [f"{v:.10g}" for v in list(row.values())[: self.parameters]]
        return [key + in_brackets(self.units.get(key, "")) for key in self.rows[0]], rows

    def unrepeated(self) -> tuple[list[str], list[list[str]]]:
        """Return ``cells``; first cells equal to the row above are empty, but the last never is."""
        head, rows = self.cells()
        for above, row in reversed(list(pairwise(rows))):
            same = [a == b for a, b in zip(above, row, strict=True)]
            count = [*same[:-1], False].index(False)
            row[:count] = [""] * count
        return head, rows

    @property
    def texts(self) -> list[bool]:
        """Whether all cells of a column are text, for every column in order."""
        return [all(isinstance(row[key], str) for row in self.rows) for key in self.rows[0]]

    def lines(self, width: int) -> list[str]:
        """Return the lines of title, table and remarks for a terminal of ``width`` columns."""
        head, rows = self.unrepeated()
        words = (*self.texts, False).index(False)
        wrapped = [line for remark in self.remarks for line in wrap(reader_words(remark), width)]
        return [self.title, "", *text_table([head, *rows], width, max(words, 1)), "", *wrapped, ""]

    def markdown(self) -> list[str]:
        """Return title, rows in aligned columns, and remarks; first cells are not repeated."""
        head, rows = self.unrepeated()
        widths = [max(3, *map(len, column)) for column in zip(head, *rows, strict=True)]
        rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
        lines = [f"## {self.title}", ""]
        for first, *others in (head, rule, *rows):
            cells = [first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]
            lines.append(f"| {' | '.join(cells)} |")
        return [
            *lines,
            "",
            *(line for remark in map(reader_words, self.remarks) for line in (remark, "")),
        ]

    def html(self) -> str:
        """Return the names of the columns and all rows as an HTML table, nothing else."""
        head, rows = self.cells()
        return html_table([head, *rows])

    def variables(self) -> Variables:
        """Return the columns as netCDF variables ``name_column``: numbers (None: NaN) or text."""
        columns: Variables = {}
        for key in self.rows[0]:
            values = [row[key] for row in self.rows]
            if all(value is None or isinstance(value, int | float) for value in values):
                column = np.array([nan if value is None else value for value in values], float)
            else:
                column = np.array(list(map(cell, values)))
            variable = re.sub(r"\W+", "_", f"{self.name}_{key}".replace("²", "2")).strip("_")
            unit = self.units.get(key)
            words = {"units": attribute(unit)} if unit else {}
            columns[variable] = ((self.name,), column, words)
        return columns


@dataclass(frozen=True)
class Page:
    """The page of a study: its title, tables, and panels of a picture.

    Tables without rows are left out. ``gridded`` are the variables of a study over a grid: netCDF
    has them in the place of the tables, and the first table is written as comma-separated values,
    too. ``summary`` is shown on a terminal once the page is written; empty: the whole page is.
    """

    name: str
    scene: Scene
    title: str
    tables: Sequence[Table]
    panels: Sequence[Panel | Field]
    summary: str = ""
    gridded: Variables | None = None

    def shown(self, width: int) -> str:
        """Return the page for a terminal of ``width`` columns; as Markdown if ``width`` is 0."""
        if not width:
            return self.text().rstrip()
        tables = [line for t in self.tables if t.rows for line in t.lines(width)]
        return "\n".join([*wrap(self.title, width), "", *tables]).rstrip()

    def text(self) -> str:
        """Return the page as Markdown.

        Characters of ``MARKUP`` are escaped in the title, which has the scene's own, any text.
        """
        title = MARKUP.sub(r"\\\g<0>", self.title)
        tables = [line for t in self.tables if t.rows for line in t.markdown()]
        return "\n".join([f"# {title}", "", *tables]).rstrip() + "\n"

    def write(self, folder: Path, *, command: str = "") -> list[Path]:
        """Write files of the study's name: md, svg, html, nc and, with ``gridded``, csv.

        Returns their paths. ``folder`` must exist; its files are replaced. ``command`` made the
        page, which shows it; empty if Python did. Raises ``BadInput`` if a file cannot be written.
        """
        texts = {"md": self.text(), "svg": svg_text(study_figure(self.panels), salt=self.name)}
        variables = self.gridded
        if variables is None:
            variables = {k: v for t in self.tables if t.rows for k, v in t.variables().items()}
        else:
            stream, rows = StringIO(), self.tables[0].rows
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
            texts["csv"] = stream.getvalue()
        paths = {ending: folder / f"{self.name}.{ending}" for ending in (*texts, "html", "nc")}
        downloads = [path.name for ending, path in paths.items() if ending != "html"]
        data = script_record(live_plots(self.panels, "picture"))
        curves = [panel for panel in self.panels if isinstance(panel, Panel)]
        coincident = [(panel, note) for panel in curves for note in panel.coincidences()]
        record = {
            "page": self,
            "notes": [f"{p.title}: {note}." for p, note in coincident],
            "data": as_script_data(data),
            **page_record(PLOTS),
            **origin_record(command, downloads),
        }
        texts["html"] = render("study.html", record)
        attributes = {**attributes_of(self.scene), "title": self.title}
        for ending, text in texts.items():
            write_text(paths[ending], text)
        write_variables(variables, attributes, paths["nc"])
        return list(paths.values())
