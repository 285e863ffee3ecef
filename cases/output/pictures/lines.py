"""Pictures over one coordinate: densities, and differences of two answers with their bands."""

from collections.abc import Sequence
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.comparison.compare import joined
from cases.comparison.run import CurveOutcome
from cases.output.grids import values_on
from cases.output.pictures.style import (
    COLOURS,
    INK,
    LINES,
    MARKS,
    lines_of,
    samples_of,
    shown_range,
    simulation_of,
    symbol_of,
    two_solvers,
    words_of,
)
from fpk.density import Array, Density, SampledDensity, bin_differences
from fpk.observable import Observable

POINTS = 600
"""Points of a line."""

MARKERS = 56
"""Bins drawn as points."""

LONGEST_OF_THREE = 31
"""Letters of the longest label with which three columns fit."""


class Difference(NamedTuple):
    """One answer minus another at the points ``x``, and the ``band`` in which it may lie."""

    words: str
    x: Array
    values: Array
    band: Array


def density_figure(curves: Sequence[CurveOutcome], observable: Observable) -> Figure:
    """Draw the densities of one coordinate: deterministic as lines, sampled as points with bars.

    Several curves are distinguished by colour, and their routes by dashes; the routes of a single
    curve have their own colours, too.
    """
    figure = Figure(figsize=(6.6, 4.2), layout="constrained")
    axes = figure.subplots()
    alone = len(curves) == 1
    colours = dict(zip((c.label for c in curves), cycle(COLOURS), strict=False))
    legend: dict[str, Line2D] = {}
    if not alone:
        legend = {w: Line2D([], [], color=c, linewidth=3) for w, c in colours.items()}
    for curve in curves:
        densities = curve.densities(observable)
        x = np.linspace(*shown_range(densities.values()), POINTS)
        for route, dashes in zip(lines_of(curve, observable), LINES, strict=False):
            style: Any = {"color": route.colour if alone else colours[curve.label]}
            axes.plot(x, values_on(densities[route], x)[0], linestyle=dashes, **style)
            ink = style["color"] if alone else INK
            legend.setdefault(route.words, Line2D([], [], color=ink, linestyle=dashes))
        for route, sampled in samples_of(curve, observable).items():
            style = {
                "color": route.colour if alone else colours[curve.label],
                "marker": MARKS[route.solves],
                "linestyle": "none",
                "markersize": 3.4,
                "markerfacecolor": "none",
                "markeredgewidth": 0.9,
            }
            _points(axes, sampled, (x[0], x[-1]), style)
            style["color"] = style["color"] if alone else INK
            legend.setdefault(f"{route.words}, ±2 standard errors", Line2D([], [], **style))
    axes.autoscale(axis="x", tight=True)
    axes.set_ylim(bottom=0)
    axes.set_xlabel(words_of(observable[0]))
    axes.set_ylabel(f"density $p({symbol_of(observable[0])})$")
    _set_legend(figure, legend)
    return figure


def solver_differences(curve: CurveOutcome, observable: Observable) -> list[Difference]:
    """Return the difference of two solvers of one equation, in the errors that both state."""
    answers = two_solvers(curve, observable)
    if not answers:
        return []
    x = np.linspace(*shown_range(curve.densities(observable).values()), POINTS)
    (first, stated), (second, also_stated) = (values_on(d, x) for _, d in answers)
    a, b = (route.solver for route, _ in answers)
    return [Difference(f"{a} − {b}", x, first - second, stated + also_stated)]


def theory_differences(curve: CurveOutcome, observable: Observable) -> list[Difference]:
    """Return simulation − theory for every theory drawn, in two standard errors."""
    simulation, densities = simulation_of(curve, observable), curve.densities(observable)
    if simulation is None:
        return []
    few = joined(simulation, 2 * MARKERS)
    x, inside = _middles(few, shown_range(densities.values()))
    return [
        Difference(
            f"simulation − {route.words}",
            x,
            bin_differences(few, theory)[inside],
            2.0 * few.standard_error[inside],
        )
        for route in lines_of(curve, observable)
        if isinstance(theory := densities[route], Density)
    ]


def difference_figure(
    rows: Sequence[tuple[str, Sequence[Difference]]], observable: Observable, band: str
) -> Figure:
    """Draw the differences of each curve (label, differences) in a row, ``band`` in words."""
    figure = Figure(figsize=(6.6, 0.9 + 1.35 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    legend: dict[str, Line2D] = {}
    for axes, (label, differences), colour in zip(panels, rows, cycle(COLOURS), strict=False):
        axes.axhline(0.0, color=INK, linewidth=0.7)
        x, allowed = differences[0].x, differences[0].band
        axes.fill_between(x, -allowed, allowed, color=INK, alpha=0.16, linewidth=0)
        for difference, dashes in zip(differences, LINES, strict=False):
            style: Any = {"linewidth": 1.2, "linestyle": dashes}
            axes.plot(difference.x, difference.values, color=colour, **style)
            legend.setdefault(difference.words, Line2D([], [], color=INK, **style))
        axes.set_title(label)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2))
    legend[band] = Line2D([], [], color=INK, alpha=0.16, linewidth=6)
    _set_legend(figure, legend)
    figure.supylabel(f"difference of $p({symbol_of(observable[0])})$", fontsize=9.5)
    panels[-1].set_xlabel(words_of(observable[0]))
    return figure


def _points(
    axes: Axes, sampled: SampledDensity, ends: tuple[float, float], style: dict[str, Any]
) -> None:
    few = joined(sampled, MARKERS)
    x, inside = _middles(few, ends)
    error = 2.0 * few.standard_error[inside]
    axes.errorbar(x, few.values[inside], error, elinewidth=0.9, **style)


def _middles(sampled: SampledDensity, ends: tuple[float, float]) -> tuple[Array, Any]:
    """The middles of the bins between ``ends``, and which bins these are."""
    edges = sampled.edges[0]
    middles = 0.5 * (edges[1:] + edges[:-1])
    inside = (middles >= ends[0]) & (middles <= ends[1])
    return middles[inside], inside


def _set_legend(figure: Figure, legend: dict[str, Line2D]) -> None:
    """Words above the picture, in as many columns as its width has room for."""
    columns = 3 if max(map(len, legend)) <= LONGEST_OF_THREE else 2
    handles, labels = list(legend.values()), list(legend)
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, columnspacing=1.6)
