"""Answers in Python: as a data frame, labelled arrays, a figure, the tables of a notebook."""

from dataclasses import dataclass
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.figure import Figure

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
from fpk.answer.names import observable_name, parse_observable
from fpk.numeric.errors import InvalidInput, Unavailable

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


@dataclass(frozen=True, repr=False)
class PresentedAnswers(Answers):
    """``Answers`` as ``fpk.solve`` returns them: also as a data frame, labelled arrays, a figure.

    ::

        answers = fpk.solve(fpk.load("fig3a").system, ["q2"])
        answers["q2", "exact"], answers.of("q2"), answers.refusals, answers.problems
        answers.summary(), answers.to_xarray(), answers.plot("q2")
    """

    def summary(self) -> "DataFrame":
        """Return the quantities as a data frame: rows by observable and quantity.

        Columns by route, each with ``value``, ``error`` and ``error_kind``: ``numerical``, or
        ``sampling`` for one standard error; NaN for a missing answer. Empty without quantities.
        Needs pandas; raises ``Unavailable`` without. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).summary()
        """
        pandas = import_optional("pandas")
        frame: DataFrame = pandas.DataFrame([quantity_row(q) for q in self.quantities])
        if frame.empty:
            return frame
        routes = list(dict.fromkeys(frame["route"]))
        rows = list(dict.fromkeys(zip(frame["observable"], frame["quantity"], strict=True)))
        cells = ["value", "error", "error_kind"]
        wide = frame.set_index(["observable", "quantity", "route"])[cells].unstack("route")
        columns = pandas.MultiIndex.from_product([routes, cells])
        return wide.swaplevel(axis=1).reindex(index=rows, columns=columns)

    def to_xarray(self) -> "Dataset":
        """Return the densities and their errors on common grids, as in the file of a run.

        ``p_q2`` (route_q2, q2) is the density, ``error_q2`` its error, of the kind that
        ``error_kind_q2`` says; no units are named. Needs xarray; raises ``Unavailable`` without. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).to_xarray()["p_q2"]
        """
        variables: Variables = {}
        for observable in dict.fromkeys(d.observable for d in self.values()):
            variables |= density_variables([self], observable, Units())
        attributes = {"units": CONSISTENT, "program": f"vibro-fpk {program_version()}"}
        data: Dataset = import_optional("xarray").Dataset(dict(variables), attrs=attributes)
        return data.isel(curve=0, drop=True) if "curve" in data.dims else data

    def plot(self, observable: str, *, log: bool = False) -> Figure:
        """Return a figure of pyplot with the densities of ``observable`` by every route drawn.

        Contours for a pair. ``log``: on a logarithmic axis, down to 1e-6 of the largest, contours
        to 1e-3. Raises ``InvalidInput`` for an observable without a density. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).plot("q2", log=True)
        """
        of = parse_observable(observable, self.system.n)
        if not self.densities(of):
            there = "; ".join(dict.fromkeys(o for o, _ in self)) or "none"
            remedy = f"has no density; one of these has: {there}"
            raise InvalidInput("observable", observable_name(of), remedy)
        with mpl.rc_context(dict(STYLE)):
            figure = import_module("matplotlib.pyplot").figure()
            if len(of) == 2:
                return joint_figure(self, of, log=log, figure=figure)
            return column_figure([density_panel([self], of, log=log)], HEIGHT, figure=figure)

    def _repr_html_(self) -> str:
        """Return the quantities as tables, one for each observable, and notes, for a notebook."""
        rows = [plain(quantity_row(q)) for q in self.quantities]
        tables = map(html_table, quantity_rows(rows))
        notes = [*([NOTE] if rows else []), *map(reader_words, self.averaging_notes)]
        texts = [f"<p>{escape(text)}</p>" for text in (repr(self), *notes)]
        return "".join([texts[0], *tables, *texts[1:]])


def plot(density: AnyDensity, *, log: bool = False) -> Figure:
    """Return a figure of pyplot with one density and a band of ± its error.

    A density of two coordinates is drawn as contours; ``log``: on a logarithmic scale, the levels
    of the contours form a geometric sequence. ::

        answers = fpk.solve(fpk.load("fig3a").system, ["q2,p2"], methods=["exact"])
        fpk.plot(answers["q2,p2"], log=True)
    """
    with mpl.rc_context(dict(STYLE)):
        figure: Figure = import_module("matplotlib.pyplot").figure(layout="constrained")
        drawn = lone_density(density, log=log)
        if isinstance(drawn, Field):
            return contour_figure([drawn], density_words(density.observable), figure=figure)
        draw_curves(figure.subplots(), drawn)
    return figure


def import_optional(name: str) -> Any:
    """Return the imported package ``name``; raise ``Unavailable`` if it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        words = f"{name} is not installed; pip install 'vibro-fpk[frames]' brings it"
        raise Unavailable(words) from None
