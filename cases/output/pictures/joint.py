"""Pictures of joint densities: panels on common levels, and surfaces as in Fig. 7 of the paper."""

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import LightSource, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from cases.comparison.compare import joined
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
from fpk.density import AnyDensity, Array, SampledDensity
from fpk.observable import Observable

LOWEST = 1e-3
"""Lowest level of a picture in decades, relative to the largest."""

SHEET = 72
"""Points an axis of a surface, and bins an axis, about, where it is sampled."""


def pair_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw a joint density by every route that is drawn, side by side on common levels."""
    densities = curve.densities(observable)
    routes = [*lines_of(curve, observable), *samples_of(curve, observable)]
    grid = common_grid([densities[r] for r in routes], cut=SHOWN)
    mesh = np.meshgrid(*grid, indexing="ij")
    panels = {r.words: values_on(densities[r], *mesh)[0] for r in routes}
    # A density of energies falls exponentially from its corner: decades, not equal steps.
    decades = all(c.kind == "H" for c in observable)
    return _panels(panels, grid, observable, _density(observable), decades=decades)


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
    return _panels(panels, grid, observable, "difference of $p$", decades=True)


def surface_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw the joint density as surfaces on the same levels: theory and simulation.

    The theory is the exact density where there is one, else an averaged one; one that neglects
    something, the contacts for example, comes last.
    """
    densities = curve.densities(observable)
    lines = sorted(lines_of(curve, observable), key=curve.neglects)
    full = [r for r in samples_of(curve, observable) if r.solves == "full"]
    routes = [*lines[:1], *full] or list(densities)[:1]
    ends = common_grid([densities[r] for r in routes], cut=SHOWN)
    sheets = {route.words: _sheet(densities[route], ends) for route in routes}
    top = max(float(values.max()) for *_, values in sheets.values())
    figure = Figure(figsize=(4.3 * len(routes), 4.0))
    for place, (words, (x, y, values)) in enumerate(sheets.items(), start=1):
        axes = figure.add_subplot(1, len(routes), place, projection="3d", proj_type="ortho")
        assert isinstance(axes, Axes3D)
        axes.view_init(elev=28.0, azim=-58.0)
        axes.set_box_aspect((1.0, 1.0, 0.72), zoom=0.92)  # beyond it labels are cut
        axes.set_zlim(0.0, 1.05 * top)
        axes.set_xlabel(words_of(observable[0]))
        axes.set_ylabel(words_of(observable[1]))
        axes.set_zlabel(_density(observable))
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(MaxNLocator(5))
            axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        sheet = axes.plot_surface(
            x, y, values, cmap="viridis", norm=Normalize(0.0, top), rcount=SHEET, ccount=SHEET,
            lightsource=LightSource(azdeg=225, altdeg=50), linewidth=0, antialiased=False,
        )  # fmt: skip
        sheet.set_rasterized(True)
        axes.set_title(words, y=0.96, loc="left", x=0.05)
    figure.subplots_adjust(left=0.0, right=0.96, bottom=0.06, top=0.96, wspace=0.06)
    return figure


def _sheet(density: AnyDensity, ends: tuple[Array, ...]) -> tuple[Array, Array, Array]:
    """Points and values of one surface; a sampled one has its own, joined bins."""
    if not isinstance(density, SampledDensity):
        x, y = np.meshgrid(*(np.linspace(e[0], e[-1], SHEET) for e in ends), indexing="ij")
        return x, y, values_on(density, x, y)[0]
    few = joined(density, SHEET)
    middles = [0.5 * (e[1:] + e[:-1]) for e in few.edges]
    inside = [(m >= e[0]) & (m <= e[-1]) for m, e in zip(middles, ends, strict=True)]
    x, y = np.meshgrid(*(m[i] for m, i in zip(middles, inside, strict=True)), indexing="ij")
    return x, y, few.values[np.ix_(*inside)]


def _panels(
    panels: Mapping[str, Array],
    grid: tuple[Array, ...],
    observable: Observable,
    label: str,
    *,
    decades: bool,
) -> Figure:
    top = max(float(v.max()) for v in panels.values())
    levels = top * (np.geomspace(LOWEST, 1.0, 13) if decades else np.linspace(0.0, 1.0, 13))
    norm = LogNorm(levels[0], top) if decades else Normalize(0.0, top)
    figure = Figure(figsize=(3.4 * len(panels) + 0.6, 3.2), layout="constrained")
    row = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (words, values) in zip(row, panels.items(), strict=True):
        # Below the lowest level nothing is drawn; a logarithm needs a value there all the same.
        drawn = np.maximum(values, 0.1 * levels[0])
        filled = axes.contourf(*grid, drawn.T, levels=levels, norm=norm, cmap="viridis")
        axes.set_title(words)
        axes.set_xlabel(words_of(observable[0]))
    row[0].set_ylabel(words_of(observable[1]))
    figure.colorbar(filled, ax=list(row), shrink=0.9, format="%.2g").set_label(label)
    return figure


def _density(observable: Observable) -> str:
    return f"density $p({', '.join(map(symbol_of, observable))})$"
