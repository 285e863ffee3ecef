"""Answers in Python: as a data frame, labelled arrays, a figure, the tables of a notebook."""

from html import escape
from importlib import import_module
from typing import Any

import matplotlib as mpl

from cases.compare.answers import Answers
from cases.scene.units import CONSISTENT, Units
from cases.scene.written import NOTE
from cases.show.digest import quantity_row
from cases.show.fields import density_variables
from cases.show.pictures.densities import HEIGHT, density_panel, joint_figure, lone_density
from cases.show.pictures.draw import column_figure, contour_figure, draw_curves
from cases.show.pictures.panel import Field
from cases.show.pictures.style import STYLE, density_words
from cases.show.records import plain, program_version
from cases.show.text import html_table, quantity_rows
from cases.show.variables import Variables
from cases.show.words import reader_words
from fpk.answer.density import AnyDensity
from fpk.answer.names import Observable, observable_name
from fpk.numeric.errors import InvalidInput, Unavailable


def summary_frame(answers: Answers) -> Any:
    """Return the quantities as a data frame of pandas with rows (observable, quantity).

    Columns (route, "value" or "error" or "error_kind"), NaN for a missing answer; empty without
    quantities. Raises ``Unavailable`` without pandas.
    """
    pandas = import_optional("pandas")
    frame = pandas.DataFrame([quantity_row(q) for q in answers.quantities])
    if frame.empty:
        return frame
    routes = list(dict.fromkeys(frame["route"]))
    rows = list(dict.fromkeys(zip(frame["observable"], frame["quantity"], strict=True)))
    cells = ["value", "error", "error_kind"]
    wide = frame.set_index(["observable", "quantity", "route"])[cells].unstack("route")
    columns = pandas.MultiIndex.from_product([routes, cells])
    return wide.swaplevel(axis=1).reindex(index=rows, columns=columns)


def dataset(answers: Answers) -> Any:
    """Return the densities and errors (route, coordinates) on common grids as an xarray data set.

    Names are as in ``write_netcdf``, without the dimension ``curve``; no units are named. Raises
    ``Unavailable`` if xarray is not installed.
    """
    xarray = import_optional("xarray")
    variables: Variables = {}
    for observable in dict.fromkeys(d.observable for d in answers.values()):
        variables |= density_variables([answers], observable, Units())
    data = xarray.Dataset(
        dict(variables), attrs={"units": CONSISTENT, "program": f"vibro-fpk {program_version()}"}
    )
    return data.isel(curve=0, drop=True) if "curve" in data.dims else data


def plot(answers: Answers, observable: Observable, *, log: bool) -> Any:
    """Return a pyplot figure of the densities, contours for a pair; ``InvalidInput`` if none."""
    densities = answers.densities(observable)
    if not densities:
        there = "; ".join(dict.fromkeys(o for o, _ in answers)) or "none"
        name = observable_name(observable)
        raise InvalidInput("observable", name, f"has no density; one of these has: {there}")
    with mpl.rc_context(dict(STYLE)):
        figure = import_module("matplotlib.pyplot").figure()
        if len(observable) == 2:
            return joint_figure(answers, observable, log=log, figure=figure)
        return column_figure([density_panel([answers], observable, log=log)], HEIGHT, figure=figure)


def plot_density(density: AnyDensity, *, log: bool) -> Any:
    """Return a figure of pyplot with one density and a band of ± its error, or contours of a pair.

    ``log``: a logarithmic scale; the levels of the contours form a geometric sequence.
    """
    with mpl.rc_context(dict(STYLE)):
        figure = import_module("matplotlib.pyplot").figure(layout="constrained")
        drawn = lone_density(density, log=log)
        if isinstance(drawn, Field):
            return contour_figure([drawn], density_words(density.observable), figure=figure)
        draw_curves(figure.subplots(), drawn)
    return figure


def html_tables(answers: Answers) -> str:
    """Return HTML: ``repr(answers)``, a table of the quantities of each observable, and notes."""
    rows = [plain(quantity_row(q)) for q in answers.quantities]
    parts = [f"<p>{escape(repr(answers))}</p>"]
    parts += map(html_table, quantity_rows(rows))
    notes = [*([NOTE] if rows else []), *map(reader_words, answers.averaging_notes)]
    return "".join([*parts, *(f"<p>{escape(note)}</p>" for note in notes)])


def import_optional(name: str) -> Any:
    """Return the imported package ``name``; raise ``Unavailable`` if it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        words = f"{name} is not installed; pip install 'vibro-fpk[frames]' brings it"
        raise Unavailable(words) from None
