"""Pictures over one coordinate: densities, and differences of two answers with their bands."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.comparison.compare import joined
from cases.comparison.run import CurveOutcome
from cases.output.grids import common_grid, values_on
from cases.output.pictures.choice import lines_of, samples_of, two_solvers
from cases.output.pictures.style import (
    COLOURS,
    GAP,
    INK,
    SHOWN,
    column_of_axes,
    density_words,
    symbol_of,
    unit_of,
    words_of,
)
from fpk.density import Array, SampledDensity, bin_differences
from fpk.observable import Observable, observable_name

POINTS = 600
"""Points of a line."""

MARKERS = 56
"""Bins drawn as points."""

LINES: Any = ("-", (0, (6, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)))
"""Dashes of the lines of one curve, by its routes."""

MARKS = {"full": "o", "averaged": "s"}
"""Markers of samples, by what the route solves."""

HEIGHT, ALONE, ROW = 3.1, 1.6, 0.9
"""Height in inches of the axes of densities, and of differences of a lone curve or one of many."""


class Difference(NamedTuple):
    """One answer minus another at the points ``x``, and the ``band`` in which it may lie."""

    words: str
    x: Array
    values: Array
    band: Array


def line_pictures(
    curves: Sequence[CurveOutcome], observable: Observable
) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything to be seen of one coordinate."""
    name = observable_name(observable)
    curves = sorted(curves, key=lambda c: c.value or 0.0)
    densities = [d for c in curves for d in c.densities(observable).values()]
    (x,) = common_grid(densities, cut=SHOWN, count=POINTS)
    ends = float(x[0]), float(x[-1])
    yield (
        f"density_{name}",
        f"Density of {name}: theory as lines, simulation as points with two standard errors.",
        density_figure(curves, observable, x),
    )
    rows = {c.label: solver_difference(c, observable, x) for c in curves}
    if any(rows.values()):
        words = (
            f"Numerical error for {name}: two solvers of the same equation against each other, and"
            " the errors that they state."
        )
        band = "±the errors that both state"
        yield f"solver_{name}", words, difference_figure(rows, observable, band=band, ends=ends)
    rows = {c.label: theory_differences(c, observable, x) for c in curves}
    if any(rows.values()):
        words = (
            f"Simulation minus theory for {name}. Inside the grey band the difference is chance; a"
            " curve that leaves it shows the averaging error where the theory is an averaged one."
        )
        band = "±2 standard errors"
        yield f"left_{name}", words, difference_figure(rows, observable, band=band, ends=ends)


def density_figure(curves: Sequence[CurveOutcome], observable: Observable, x: Array) -> Figure:
    """Draw the densities of one coordinate: deterministic as lines, sampled as points with bars.

    Several curves are distinguished by colour, and their routes by dashes; the routes of a single
    curve have their own colours, too.
    """
    alone = len(curves) == 1
    colours = dict(zip((c.label for c in curves), cycle(COLOURS), strict=False))
    legend: dict[str, Artist] = {}
    if not alone:
        legend = {w: Line2D([], [], color=c, linewidth=3) for w, c in colours.items()}
    lines: list[tuple[Array, Array, Mapping[str, Any]]] = []
    bars: list[tuple[Array, Array, Array, str]] = []
    for curve in curves:
        functions = lines_of(curve, observable).items()
        for (route, density), dashes in zip(functions, LINES, strict=False):
            style: dict[str, Any] = {"linestyle": dashes}
            colour = route.colour if alone else colours[curve.label]
            lines.append((x, values_on(density, x)[0], {**style, "color": colour}))
            ink = colour if alone else INK
            legend.setdefault(route.words, Line2D([], [], color=ink, **style))
        for route, sampled in samples_of(curve, observable).items():
            style = {
                "marker": MARKS[route.solves],
                "linestyle": "none",
                "markersize": 3.4,
                "markerfacecolor": "none",
                "markeredgewidth": 0.9,
            }
            few = joined(sampled, MARKERS)
            middles, inside = _middles(few, x)
            values, error = few.values[inside], 2.0 * few.standard_error[inside]
            colour = route.colour if alone else colours[curve.label]
            lines.append((middles, values, {**style, "color": colour}))
            bars.append((middles, values - error, values + error, colour))
            ink = colour if alone else INK
            words = f"{route.words}, ±2 standard errors"
            legend.setdefault(words, Line2D([], [], color=ink, **style))
    figure, (axes,) = column_of_axes(1, HEIGHT, legend, head=0.12)
    for x_values, values, drawn in lines:
        axes.plot(x_values, values, **drawn)
    for x_values, low, high, colour in bars:
        axes.vlines(x_values, low, high, color=colour, linewidth=0.9)
    axes.set(xlim=(x[0], x[-1]), xlabel=words_of(observable[0]))
    axes.set_ylim(bottom=0)
    axes.set_ylabel(density_words(observable))
    return figure


def solver_difference(curve: CurveOutcome, observable: Observable, x: Array) -> list[Difference]:
    """Return the difference of two solvers of one equation, in the errors that both state."""
    answers = two_solvers(curve, observable)
    if not answers:
        return []
    (first, stated), (second, also_stated) = (values_on(d, x) for _, d in answers)
    words = " − ".join(route.solver for route, _ in answers)
    return [Difference(words, x, first - second, stated + also_stated)]


def theory_differences(curve: CurveOutcome, observable: Observable, x: Array) -> list[Difference]:
    """Return simulation − theory for every theory drawn, in two standard errors."""
    for route, sampled in samples_of(curve, observable).items():
        if route.solves == "full":
            few = joined(sampled, 2 * MARKERS)
            middles, inside = _middles(few, x)
            band = 2.0 * few.standard_error[inside]
            return [
                Difference(
                    f"simulation − {r.words}", middles, bin_differences(few, theory)[inside], band
                )
                for r, theory in lines_of(curve, observable).items()
            ]
    return []


def difference_figure(
    rows: Mapping[str, Sequence[Difference]],
    observable: Observable,
    *,
    band: str,
    ends: tuple[float, float],
) -> Figure:
    """Draw the differences of each curve, by its label, in a row between ``ends``.

    ``band`` says in words what the band is.
    """
    shown = {label: differences for label, differences in rows.items() if differences}
    style: Any = {"linewidth": 1.2}
    legend: dict[str, Artist] = {
        d.words: Line2D([], [], color=INK, linestyle=dashes, **style)
        for differences in shown.values()
        for d, dashes in zip(differences, LINES, strict=False)
    }
    legend[band] = Line2D([], [], color=INK, alpha=0.16, linewidth=6)
    figure, panels = column_of_axes(len(shown), ROW if len(shown) > 1 else ALONE, legend, head=GAP)
    for axes, (label, differences), colour in zip(
        panels, shown.items(), cycle(COLOURS), strict=False
    ):
        x, allowed = differences[0].x, differences[0].band
        unit, words = unit_of(max(np.abs([allowed, *(d.values for d in differences)]).ravel()))
        axes.axhline(0.0, color=INK, linewidth=0.7)
        axes.fill_between(x, -allowed / unit, allowed / unit, color=INK, alpha=0.16, linewidth=0)
        for difference, dashes in zip(differences, LINES, strict=False):
            axes.plot(x, difference.values / unit, color=colour, linestyle=dashes, **style)
        axes.set_title(f"{label}   {words}".strip())
        axes.locator_params(axis="y", nbins=4)
    figure.supylabel(
        f"difference of p({symbol_of(observable[0])})", fontsize=9.5, x=0.005, ha="left"
    )
    panels[-1].set(xlim=ends, xlabel=words_of(observable[0]))
    return figure


def _middles(sampled: SampledDensity, x: Array) -> tuple[Array, Any]:
    """The middles of the bins between the ends of ``x``, and which bins these are."""
    edges = sampled.edges[0]
    middles = 0.5 * (edges[1:] + edges[:-1])
    inside = (middles >= x[0]) & (middles <= x[-1])
    return middles[inside], inside
