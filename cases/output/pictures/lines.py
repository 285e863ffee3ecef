"""Pictures over one coordinate: densities, differences of solvers, simulation minus theory."""

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.comparison.run import CurveOutcome
from cases.output.grids import values_on
from cases.output.pictures.style import (
    COLOURS,
    INK,
    LINES,
    MARKS,
    SHOWN,
    lines_of,
    samples_of,
    set_labels,
    shown_range,
    simulation_of,
    symbol_of,
    two_solvers,
    words_of,
)
from fpk.density import Array, Density, SampledDensity, bin_differences
from fpk.observable import Observable

MARKERS = 56
"""Bins drawn as points."""

LONGEST_OF_THREE = 31
"""Letters of the longest label with which three columns fit."""

SMALLEST = 1e-19
"""Smallest value on a logarithmic axis: round-off of a density of order one is above it."""


def density_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw the densities of one coordinate: deterministic as lines, sampled as points with bars.

    Several curves are distinguished by colour, and their routes by dashes; the routes of a single
    curve have their own colours, too.
    """
    figure, axes = _new_figure(4.2)
    legend: dict[str, Line2D] = {}
    ends = []
    alone = len(curves) == 1
    for curve, colour in zip(curves, cycle(COLOURS), strict=False):
        densities = curve.densities(observable)
        x = np.linspace(*shown_range(densities.values()), 600)
        ends.append((x[0], x[-1]))
        for route, dashes in zip(lines_of(curve, observable), LINES, strict=False):
            style: Any = {"color": route.colour if alone else colour, "linestyle": dashes}
            axes.plot(x, values_on(densities[route], x)[0], **style)
            _enter(legend, route.words, alone, **style)
        for route, sampled in samples_of(curve, observable).items():
            style = {
                "color": route.colour if alone else colour,
                "marker": MARKS[route.solves],
                "linestyle": "none",
                "markersize": 3.4,
                "markerfacecolor": "none",
                "markeredgewidth": 0.9,
            }
            _points(axes, sampled, x, style)
            _enter(legend, f"{route.words}, ±2 standard errors", alone, **style)
    axes.set_xlim(min(e[0] for e in ends), max(e[1] for e in ends))
    axes.set_ylim(bottom=0)
    set_labels(axes, observable[0])
    if not alone:
        colours = dict(zip((c.label for c in curves), cycle(COLOURS), strict=False))
        of_curves = {w: Line2D([], [], color=c, linewidth=3) for w, c in colours.items()}
        legend = {**of_curves, **legend}
    _legend(figure, legend)
    return figure


def solver_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw the difference of two solvers, and the errors that both state, on a log scale."""
    figure, axes = _new_figure(3.4)
    legend: dict[str, Line2D] = {}
    for curve, colour in zip(curves, cycle(COLOURS), strict=False):
        answers = two_solvers(curve, observable)
        if not answers:
            continue
        x = np.linspace(*shown_range(curve.densities(observable).values()), 500)
        (first, stated), (second, also_stated) = (values_on(d, x) for _, d in answers)
        if len(curves) > 1:
            legend[curve.label] = Line2D([], [], color=colour, linewidth=3)
        axes.plot(x, _positive(np.abs(first - second)), color=colour, linewidth=1.0)
        axes.plot(x, _positive(stated + also_stated), color=colour, linestyle=LINES[1])
        a, b = (route.solver for route, _ in answers)
        _enter(legend, f"|{a} − {b}|", False, linewidth=1)
    _enter(legend, "errors that both state, added", False, linestyle=LINES[1])
    axes.set_yscale("log")
    _legend(figure, legend)
    set_labels(axes, observable[0], "difference of $p$")
    return figure


def left_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw simulation − theory for each curve and route, with the band of chance around zero."""
    sampled = [
        (c, d)
        for c in curves
        if (d := simulation_of(c, observable)) is not None and lines_of(c, observable)
    ]
    figure = Figure(figsize=(6.6, 0.9 + 1.35 * len(sampled)), layout="constrained")
    rows = figure.subplots(len(sampled), 1, sharex=True, squeeze=False)[:, 0]
    legend: dict[str, Line2D] = {}
    for axes, (curve, simulation) in zip(rows, sampled, strict=True):
        densities = curve.densities(observable)
        colour = COLOURS[curves.index(curve) % len(COLOURS)]
        joined = _joined(simulation, 2 * MARKERS)
        x, error = _middles(joined), joined.standard_error
        shown = _within(x, shown_range(densities.values()))
        axes.fill_between(
            x[shown], -2 * error[shown], 2 * error[shown], color=INK, alpha=0.16, lw=0
        )
        axes.axhline(0.0, color=INK, linewidth=0.7)
        for route, dashes in zip(lines_of(curve, observable), LINES, strict=False):
            theory = densities[route]
            if isinstance(theory, Density):
                difference = bin_differences(joined, theory)[shown]
                style: Any = {"linewidth": 1.2, "linestyle": dashes}
                axes.plot(x[shown], difference, color=colour, **style)
                _enter(legend, f"simulation − {route.words}", False, **style)
        axes.set_title(curve.label)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2))
    legend["±2 standard errors"] = Line2D([], [], color=INK, alpha=0.16, lw=6)
    _legend(figure, legend)
    figure.supylabel(f"difference of $p({symbol_of(observable[0])})$", fontsize=9.5)
    rows[-1].set_xlabel(words_of(observable[0]))
    return figure


def _points(axes: Axes, sampled: SampledDensity, x: Array, style: dict[str, Any]) -> None:
    joined = _joined(sampled, MARKERS)
    middle = _middles(joined)
    shown = _within(middle, (float(x[0]), float(x[-1])))
    error = 2 * joined.standard_error[shown]
    axes.errorbar(middle[shown], joined.values[shown], error, elinewidth=0.9, **style)


def _joined(sampled: SampledDensity, wanted: int) -> SampledDensity:
    """Join bins until about ``wanted`` are left where the density counts."""
    heavy = int(np.count_nonzero(sampled.values > SHOWN * sampled.values.max()))
    bins = sampled.edges[0].size - 1
    factors = [f for f in range(1, max(heavy // wanted, 1) + 1) if bins % f == 0]
    return sampled.coarsened(max(factors))


def _middles(sampled: SampledDensity) -> Array:
    edges = sampled.edges[0]
    middles: Array = 0.5 * (edges[1:] + edges[:-1])
    return middles


def _within(x: Array, ends: tuple[float, float]) -> Any:
    return (x >= ends[0]) & (x <= ends[1])


def _positive(values: Array) -> Array:
    """Leave out what a log scale cannot show."""
    return np.where(values > SMALLEST, values, np.nan)


def _enter(legend: dict[str, Line2D], words: str, own_colour: bool, **style: Any) -> None:
    """Add an entry to the legend, in ink where the colour means something else."""
    if not own_colour:
        style["color"] = INK
    legend.setdefault(words, Line2D([], [], **style))


def _legend(figure: Figure, legend: dict[str, Line2D]) -> None:
    """Words above the picture, in as many columns as its width has room for."""
    columns = 3 if max(map(len, legend)) <= LONGEST_OF_THREE else 2
    handles, labels = list(legend.values()), list(legend)
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, columnspacing=1.6)


def _new_figure(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.6, height), layout="constrained")
    return figure, figure.subplots()
