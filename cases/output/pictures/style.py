"""What all pictures share: ink, colours, words for axes and theories."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from cases.comparison.run import CurveOutcome
from cases.output.fields import common_grid, values_on
from fpk.density import AnyDensity
from fpk.observable import Coordinate

INK = "#1a1b1e"
"""Colour of text and axes; the report replaces it by that of the page's text."""

COLOURS = ("#2878b5", "#d1603d", "#2a9d6f", "#9a6fc0", "#c08a1e", "#5b8def", "#a8577e")
"""Told apart by colour-blind readers, and legible on white and on black."""

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

THEORIES = {
    "exact": "exact, Eq. (7)",
    "linear": "Gaussian, exact without contact",
    "nonintegrable/closed-form": "averaging, Eq. (11)",
    "nonintegrable/fem": "averaging, FPK of (24)",
    "nonintegrable/quadrature": "averaging, Eq. (11)",
    "integrable/closed-form": "averaging, Eq. (34)",
    "integrable/fem": "averaging, FPK (19)",
    "integrable/quadrature": "averaging, Eq. (11)",
}
"""Deterministic routes in words; of one theory's solvers the first is drawn."""

SAMPLED = {
    "montecarlo": "simulation",
    "nonintegrable/simulation": "simulation of (24)",
    "integrable/simulation": "simulation of (17)",
}
"""Sampled routes in words: of the full system, and of the averaged equations."""

LINES: Any = ("-", (0, (6, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)))


def theories_in(found: Mapping[str, AnyDensity]) -> list[str]:
    """Return the route by which each theory in ``found`` is drawn, the exact ones first."""
    routes: dict[str, str] = {}
    for route in THEORIES:
        if route in found:
            routes.setdefault(route.split("/")[0], route)
    return list(routes.values())


def coincides(route: str, found: Mapping[str, AnyDensity], curve: CurveOutcome) -> bool:
    """Return whether the averaged theory is the exact one, and need not be drawn beside it."""
    return (
        route.startswith("nonintegrable") and "exact" in found and curve.regime.incompatible is None
    )


def shown_range(found: Mapping[str, AnyDensity]) -> tuple[float, float]:
    """Where any of the densities exceeds ``SHOWN`` of its largest value."""
    x = common_grid(found)[0]
    counts = np.zeros(x.size, dtype=bool)
    for density in found.values():
        value = values_on(density, x)[0]
        counts |= value > SHOWN * value.max()
    inside = np.flatnonzero(counts)
    return float(x[max(inside[0] - 1, 0)]), float(x[min(inside[-1] + 1, x.size - 1)])


def set_labels(axes: Axes, coordinate: Coordinate, y: str | None = None) -> None:
    """Label both axes of a picture over one coordinate."""
    axes.set_xlabel(words_of(coordinate))
    axes.set_ylabel(y or f"density $p({symbol_of(coordinate)})$")


def symbol_of(coordinate: Coordinate) -> str:
    """Return the coordinate as mathtext without its dollars."""
    return (
        coordinate.kind
        if coordinate.index is None
        else f"{coordinate.kind}_{{{coordinate.index + 1}}}"
    )


def words_of(coordinate: Coordinate) -> str:
    """Return the coordinate in words with its symbol."""
    words = {"q": "displacement", "p": "momentum", "H": "energy"}[coordinate.kind]
    modal = "modal " if coordinate.kind == "H" and coordinate.index is not None else ""
    return f"{modal}{words} ${symbol_of(coordinate)}$"


def cycle(colours: tuple[str, ...]) -> Iterator[str]:
    """Yield the colours again and again."""
    while True:
        yield from colours
