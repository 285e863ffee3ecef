"""Pictures of joint densities: on common levels, and as a surface."""

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from cases.comparison.run import CurveOutcome
from cases.output.fields import common_grid, values_on
from cases.output.pictures.lines import both_answers
from cases.output.pictures.style import (
    SAMPLED,
    SHOWN,
    THEORIES,
    coincides,
    symbol_of,
    theories_in,
    words_of,
)
from fpk.observable import Observable

DECADES = 1e-3
"""Lowest level of a joint density of energies, relative to the largest."""


def pair_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw a joint density by theory and by simulation, side by side on common levels."""
    found = curve.densities(observable)
    theories = [r for r in theories_in(found) if not coincides(r, found, curve)]
    names = [*theories, *(r for r in SAMPLED if r in found)]
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
        # Below the lowest level nothing is drawn; a logarithm needs a value there all the same.
        shown = np.maximum(values[route], 0.1 * levels[0]) if energies else values[route]
        filled = axes.contourf(*grid, shown.T, levels=levels, norm=norm, cmap="viridis")
        axes.set_title({**THEORIES, **SAMPLED}[route])
        axes.set_xlabel(words_of(observable[0]))
    panels[0].set_ylabel(words_of(observable[1]))
    bar = figure.colorbar(filled, ax=list(panels), shrink=0.9, format="%.2g")
    bar.set_label(f"density $p({symbol_of(observable[0])}, {symbol_of(observable[1])})$")
    return figure


def pair_solver_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw |finite elements − reference| of a joint density beside the stated error, log scale."""
    pair = both_answers(curve, observable, "fem")
    assert pair is not None
    fem, reference = pair
    grid = common_grid({0: fem, 1: reference}, cut=SHOWN)
    mesh = np.meshgrid(*grid, indexing="ij")
    value, stated = values_on(fem, *mesh)
    drawn = {
        "|finite elements − reference|": np.abs(value - values_on(reference, *mesh)[0]),
        "error the solver states": stated,
    }
    top = max(float(v.max()) for v in drawn.values())
    low = max(min(float(np.quantile(v[v > 0], 0.02)) for v in drawn.values()), 1e-7 * top)
    norm, levels = LogNorm(low, top), np.geomspace(low, top, 15)
    figure = Figure(figsize=(7.4, 3.2), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (words, field) in zip(panels, drawn.items(), strict=True):
        shown = np.where(field > low, field, low)  # what is smaller has the lowest colour
        filled = axes.contourf(*grid, shown.T, levels=levels, norm=norm, cmap="magma")
        axes.set_title(words)
        axes.set_xlabel(words_of(observable[0]))
    panels[0].set_ylabel(words_of(observable[1]))
    bar = figure.colorbar(filled, ax=list(panels), shrink=0.9, format="%.0e")
    bar.set_label("difference of $p$")
    return figure
