"""Pictures over one coordinate: densities, differences of solvers, what is left."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.comparison.run import CurveOutcome
from cases.output.fields import values_on
from cases.output.pictures.style import (
    COLOURS,
    INK,
    LINES,
    SAMPLED,
    SHOWN,
    THEORIES,
    coincides,
    cycle,
    set_labels,
    shown_range,
    symbol_of,
    theories_in,
    words_of,
)
from fpk.density import AnyDensity, Array, Density, SampledDensity, bin_differences
from fpk.observable import Observable

MARKERS = 56
"""Bins drawn as points."""

LONGEST_OF_THREE = 31
"""Letters of the longest label with which three columns fit."""

MARKS = ("o", "s", "s")
"""Markers of the sampled routes: circles for the full system, squares for averaged equations."""


def density_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw the densities of one coordinate: theory as lines, simulation as points with bars."""
    figure, axes = _new_figure(4.2)
    drawn: dict[str, Line2D] = {}
    ends = []
    for curve, colour in zip(curves, cycle(COLOURS), strict=False):
        found = curve.densities(observable)
        lines = [r for r in theories_in(found) if not coincides(r, found, curve)]
        if "exact" in lines and "linear" in lines:
            lines.remove("linear")
        x = np.linspace(*shown_range(found), 600)
        ends.append((x[0], x[-1]))
        for route, dashes in zip(lines, LINES, strict=False):
            axes.plot(x, values_on(found[route], x)[0], color=colour, linestyle=dashes)
            drawn.setdefault(THEORIES[route], Line2D([], [], color=INK, linestyle=dashes))
        if "nonintegrable/fem" in found and "nonintegrable/fem" not in lines:
            y = values_on(found["nonintegrable/fem"], x)[0]
            axes.plot(x, y, color=INK, linewidth=0.9, linestyle=(0, (1, 2.5)), zorder=4)
            dots = Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (1, 2.5)))
            drawn.setdefault("finite elements", dots)
        for (route, words), marker in zip(SAMPLED.items(), MARKS, strict=True):
            sampled = found.get(route)
            if isinstance(sampled, SampledDensity):
                _points(axes, sampled, colour, x, marker=marker)
                drawn.setdefault(
                    f"{words}, ±2 standard errors",
                    Line2D([], [], color=INK, marker=marker, markersize=3.4, **_HOLLOW),
                )
    axes.set_xlim(min(e[0] for e in ends), max(e[1] for e in ends))
    axes.set_ylim(bottom=0)
    set_labels(axes, observable[0])
    handles, labels = list(drawn.values()), list(drawn)
    if len(curves) > 1:
        colours = [c for _, c in zip(curves, cycle(COLOURS), strict=False)]
        handles = [Line2D([], [], color=c, linewidth=3) for c in colours] + handles
        labels = [curve.label for curve in curves] + labels
    _legend(figure, handles, labels)
    return figure


def solver_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw |finite elements − closed form| and the error that the solver states, log scale."""
    figure, axes = _new_figure(3.4)
    for curve, colour in zip(curves, cycle(COLOURS), strict=False):
        pair = both_answers(curve, observable, "fem")
        if pair is None:
            continue
        x = np.linspace(*shown_range(curve.densities(observable)), 500)
        fem, estimate = values_on(pair[0], x)
        difference = np.abs(fem - values_on(pair[1], x)[0])
        axes.plot(
            x, _positive(difference), color=colour, linewidth=1.0, label=curve.label or "difference"
        )
        axes.plot(x, _positive(estimate), color=colour, linewidth=1.4, linestyle=(0, (6, 2)))
    axes.set_yscale("log")
    handles, labels = axes.get_legend_handles_labels()
    handles += [
        Line2D([], [], color=INK, linewidth=1),
        Line2D([], [], color=INK, linestyle=(0, (6, 2))),
    ]
    labels += ["|finite elements − reference|", "error the solver states"]
    if len(curves) == 1:
        handles, labels = handles[1:], labels[1:]
    _legend(figure, handles, labels)
    set_labels(axes, observable[0], "difference of $p$")
    return figure


def left_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw simulation − theory for each curve and theory, with the band of chance around zero."""
    shown_curves = [c for c in curves if both_answers(c, observable, "montecarlo")]
    figure = Figure(figsize=(6.6, 0.9 + 1.35 * len(shown_curves)), layout="constrained")
    rows = figure.subplots(len(shown_curves), 1, sharex=True, squeeze=False)[:, 0]
    drawn: dict[str, Line2D] = {}
    for axes, curve in zip(rows, shown_curves, strict=True):
        found = curve.densities(observable)
        sampled = found["montecarlo"]
        assert isinstance(sampled, SampledDensity)
        colour = COLOURS[curves.index(curve) % len(COLOURS)]
        joined = _joined(sampled, 2 * MARKERS)
        x, error = _middles(joined), joined.standard_error
        shown = _within(x, shown_range(found))
        axes.fill_between(
            x[shown], -2 * error[shown], 2 * error[shown], color=INK, alpha=0.16, lw=0
        )
        axes.axhline(0.0, color=INK, linewidth=0.7)
        theories = [r for r in theories_in(found) if not coincides(r, found, curve)]
        for route, dashes in zip(theories, LINES, strict=False):
            theory = found[route]
            if isinstance(theory, Density):
                difference = bin_differences(joined, theory)[shown]
                axes.plot(x[shown], difference, color=colour, linewidth=1.2, linestyle=dashes)
                drawn.setdefault(
                    f"simulation − {THEORIES[route]}",
                    Line2D([], [], color=INK, linewidth=1.2, linestyle=dashes),
                )
        axes.set_title(curve.label)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2))
    drawn["±2 standard errors"] = Line2D([], [], color=INK, alpha=0.16, lw=6)
    _legend(figure, list(drawn.values()), list(drawn))
    figure.supylabel(f"difference of $p({symbol_of(observable[0])})$", fontsize=9.5)
    rows[-1].set_xlabel(words_of(observable[0]))
    return figure


def both_answers(
    curve: CurveOutcome, observable: Observable, other: str
) -> tuple[AnyDensity, Density] | None:
    """Return the answer by elements or simulation, and the best theory to hold against it."""
    found = curve.densities(observable)
    if other == "montecarlo":
        second = next((found[r] for r in theories_in(found)), None)
        first = found.get("montecarlo")
        return (first, second) if first is not None and isinstance(second, Density) else None
    for theory in ("nonintegrable", "integrable"):
        first = found.get(f"{theory}/fem")
        references = (f"{theory}/closed-form", f"{theory}/quadrature")
        second = next((found[r] for r in references if r in found), None)
        if first is not None and isinstance(second, Density):
            return first, second
    return None


_HOLLOW: Mapping[str, Any] = {
    "linestyle": "none",
    "markerfacecolor": "none",
    "markeredgewidth": 0.9,
}


def _points(axes: Axes, sampled: SampledDensity, colour: str, x: Array, *, marker: str) -> None:
    joined = _joined(sampled, MARKERS)
    middle = _middles(joined)
    shown = _within(middle, (float(x[0]), float(x[-1])))
    middle, value, error = middle[shown], joined.values[shown], 2 * joined.standard_error[shown]
    axes.errorbar(
        middle, value, error, color=colour, fmt=marker, markersize=3.4, elinewidth=0.9,
        markerfacecolor="none", markeredgewidth=0.9,
    )  # fmt: skip


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
    return np.where(values > 1e-19, values, np.nan)


def _legend(figure: Figure, handles: list[Any], labels: list[str]) -> None:
    """Words above the picture, in as many columns as its width has room for."""
    columns = 3 if max(map(len, labels)) <= LONGEST_OF_THREE else 2
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, columnspacing=1.6)


def _new_figure(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.6, height), layout="constrained")
    return figure, figure.subplots()
