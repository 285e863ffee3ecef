"""Pictures of joint densities: on common levels, and as a surface."""

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from cases.fields import common_grid, values_on
from cases.pictures.style import SHOWN, THEORIES, coincides, symbol_of, words_of
from cases.run import CurveOutcome
from fpk.observable import Observable

DECADES = 1e-3
"""Lowest level of a joint density of energies, relative to the largest."""


def pair_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw a joint density by theory and by simulation, side by side on common levels."""
    found = curve.densities(observable)
    names = [r for r in (*THEORIES, "montecarlo") if r in found and not coincides(r, found, curve)]
    figure = Figure(figsize=(3.4 * len(names) + 0.6, 3.2), layout="constrained")
    grid = common_grid({r: found[r] for r in names}, cut=SHOWN)
    values = {r: values_on(found[r], *np.meshgrid(*grid, indexing="ij"))[0] for r in names}
    top = max(float(v.max()) for v in values.values())
    energies = all(c.kind == "H" for c in observable)
    # A density of energies falls exponentially from its corner: decades, not equal steps.
    levels = top * np.geomspace(DECADES, 1.0, 13) if energies else np.linspace(0.0, top, 13)
    norm = LogNorm(levels[0], levels[-1]) if energies else Normalize(0.0, top)
    panels = figure.subplots(1, len(names), sharex=True, sharey=True, squeeze=False)[0]
    for axes, route in zip(panels, names, strict=True):
        filled = axes.contourf(*grid, values[route].T, levels=levels, norm=norm, cmap="viridis")
        axes.set_title(THEORIES.get(route, "simulation"))
        axes.set_xlabel(words_of(observable[0]))
    panels[0].set_ylabel(words_of(observable[1]))
    bar = figure.colorbar(filled, ax=list(panels), shrink=0.9, format="%.2g")
    bar.set_label(f"density $p({symbol_of(observable[0])}, {symbol_of(observable[1])})$")
    return figure
