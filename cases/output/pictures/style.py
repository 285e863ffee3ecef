"""Style of all pictures: ink, colours, which routes are drawn, words for axes."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from cases.comparison.run import CurveOutcome
from cases.output.grids import common_grid, values_on
from fpk.density import AnyDensity, Density, SampledDensity
from fpk.observable import Coordinate, Observable
from fpk.route import Route

INK = "#1a1b1e"
"""Colour of text and axes; the report replaces it by that of the page's text."""

COLOURS = ("#2878b5", "#d1603d", "#2a9d6f", "#9a6fc0", "#c08a1e", "#5b8def", "#a8577e")
"""Colours of curves: distinct for colour-blind readers, and legible on white and on black."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "mathtext.fontset": "dejavusans",
    "axes.facecolor": "none",
    "axes.formatter.use_mathtext": True,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "svg.fonttype": "path",
}

SHOWN = 1e-3
"""Share of the largest value below which a linear axis shows nothing."""

LINES: Any = ("-", (0, (6, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)))
"""Dashes of the lines of one curve, by its routes."""

MARKS = {"full": "o", "averaged": "s"}
"""Markers of samples, by what the route solves."""


def lines_of(curve: CurveOutcome, observable: Observable) -> list[Route]:
    """Return the routes drawn as lines: an exact one, and of each averaged method its first.

    An averaged method that is exact itself is not drawn beside the exact density.
    """
    deterministic = [r for r in curve.densities(observable) if not r.sampled]
    exact = [r for r in deterministic if r.solves == "full"][:1]
    averaged: dict[str, Route] = {}
    for route in deterministic:
        if route.solves == "averaged" and not (exact and curve.is_exact(route)):
            averaged.setdefault(route.method, route)
    return [*exact, *averaged.values()]


def samples_of(curve: CurveOutcome, observable: Observable) -> dict[Route, SampledDensity]:
    """Return the histograms of one observable by route."""
    densities = curve.densities(observable).items()
    return {r: d for r, d in densities if isinstance(d, SampledDensity)}


def simulation_of(curve: CurveOutcome, observable: Observable) -> SampledDensity | None:
    """Return the histogram of the full system, None where it was not simulated."""
    sampled = samples_of(curve, observable).items()
    return next((d for r, d in sampled if r.solves == "full"), None)


def two_solvers(curve: CurveOutcome, observable: Observable) -> list[tuple[Route, Density]]:
    """Return two deterministic answers to the same averaged equation, empty where there are none.

    The one that states the larger error comes first.
    """
    answers: dict[str, list[tuple[Route, Density]]] = {}
    for route, density in curve.densities(observable).items():
        if route.solves == "averaged" and isinstance(density, Density):
            answers.setdefault(route.method, []).append((route, density))
    pair = next((pair[:2] for pair in answers.values() if len(pair) > 1), [])
    return sorted(pair, key=lambda answer: -answer[1].l1_error)


def shown_range(densities: Iterable[AnyDensity]) -> tuple[float, float]:
    """Where any of the densities exceeds ``SHOWN`` of its largest value."""
    densities = list(densities)
    x = common_grid(densities)[0]
    counts = np.zeros(x.size, dtype=bool)
    for density in densities:
        value = values_on(density, x)[0]
        counts |= value > SHOWN * value.max()
    inside = np.flatnonzero(counts)
    return float(x[max(inside[0] - 1, 0)]), float(x[min(inside[-1] + 1, x.size - 1)])


def symbol_of(coordinate: Coordinate) -> str:
    """Return the coordinate as mathtext without its dollars."""
    index = "" if coordinate.index is None else f"_{{{coordinate.index + 1}}}"
    return f"{coordinate.kind}{index}"


def words_of(coordinate: Coordinate) -> str:
    """Return the coordinate in words with its symbol."""
    words = {"q": "displacement", "p": "momentum", "H": "energy"}[coordinate.kind]
    modal = "modal " if coordinate.kind == "H" and coordinate.index is not None else ""
    return f"{modal}{words} ${symbol_of(coordinate)}$"
