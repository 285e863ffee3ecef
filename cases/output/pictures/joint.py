"""Pictures of joint densities on common levels: the routes, and the difference of two solvers."""

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from cases.comparison.run import CurveOutcome
from cases.output.grids import common_grid, values_on
from cases.output.pictures.style import (
    SHOWN,
    lines_of,
    samples_of,
    symbol_of,
    two_solvers,
    words_of,
)
from fpk.density import Array
from fpk.observable import Observable

DECADES = 1e-3
"""Lowest level of a joint density of energies, relative to the largest."""

LEAST_DIFFERENCE = 1e-7
"""Lowest level of a difference of solvers, relative to its largest."""


def pair_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw a joint density by every route that is drawn, side by side on common levels."""
    densities = curve.densities(observable)
    routes = [*lines_of(curve, observable), *samples_of(curve, observable)]
    grid = common_grid([densities[r] for r in routes], cut=SHOWN)
    mesh = np.meshgrid(*grid, indexing="ij")
    panels = {r.words: values_on(densities[r], *mesh)[0] for r in routes}
    top = max(float(v.max()) for v in panels.values())
    # A density of energies falls exponentially from its corner: decades, not equal steps.
    energies = all(c.kind == "H" for c in observable)
    levels = top * np.geomspace(DECADES, 1.0, 13) if energies else np.linspace(0.0, top, 13)
    norm = LogNorm(levels[0], levels[-1]) if energies else Normalize(0.0, top)
    label = f"density $p({symbol_of(observable[0])}, {symbol_of(observable[1])})$"
    # Below the lowest level nothing is drawn; a logarithm needs a value there all the same.
    floor = 0.1 * levels[0] if energies else 0.0
    panels = {words: np.maximum(v, floor) for words, v in panels.items()}
    return _panels(panels, grid, observable, levels, norm=norm, label=label, cmap="viridis")


def pair_solver_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw the difference of two solvers of a joint density beside the errors that both state."""
    (a, first), (b, second) = two_solvers(curve, observable)
    grid = common_grid([first, second], cut=SHOWN)
    mesh = np.meshgrid(*grid, indexing="ij")
    (value, stated), (other, also_stated) = (values_on(d, *mesh) for d in (first, second))
    panels = {
        f"|{a.solver} − {b.solver}|": np.abs(value - other),
        "errors that both state, added": stated + also_stated,
    }
    top = max(float(v.max()) for v in panels.values())
    least = min(float(np.quantile(v[v > 0], 0.02)) for v in panels.values() if np.any(v > 0))
    low = max(least, LEAST_DIFFERENCE * top)
    levels, norm = np.geomspace(low, top, 15), LogNorm(low, top)
    panels = {words: np.maximum(v, low) for words, v in panels.items()}
    label = "difference of $p$"
    return _panels(panels, grid, observable, levels, norm=norm, label=label, cmap="magma")


def _panels(
    panels: dict[str, Array],
    grid: tuple[Array, ...],
    observable: Observable,
    levels: Array,
    *,
    norm: Normalize,
    label: str,
    cmap: str,
) -> Figure:
    figure = Figure(figsize=(3.4 * len(panels) + 0.6, 3.2), layout="constrained")
    row = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (words, values) in zip(row, panels.items(), strict=True):
        filled = axes.contourf(*grid, values.T, levels=levels, norm=norm, cmap=cmap)
        axes.set_title(words)
        axes.set_xlabel(words_of(observable[0]))
    row[0].set_ylabel(words_of(observable[1]))
    bar = figure.colorbar(filled, ax=list(row), shrink=0.9, format="%.2g")
    bar.set_label(label)
    return figure
