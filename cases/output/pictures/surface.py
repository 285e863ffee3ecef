"""A joint density as a surface, by theory and by simulation, as in Fig. 7 of the paper."""

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from cases.comparison.run import CurveOutcome
from cases.output.grids import common_grid, values_on
from cases.output.pictures.style import SHOWN, lines_of, samples_of, symbol_of, words_of
from fpk.density import AnyDensity, Array, SampledDensity
from fpk.observable import Observable
from fpk.route import Route

LINES, SIMULATED = 90, 72
"""Points an axis of the surface; bins an axis at most where it is sampled."""

ELEVATION, AZIMUTH, ASPECT = 28.0, -58.0, (1.0, 1.0, 0.72)
"""From where the surfaces are seen, and the proportions of their box."""

DISTANCE = 0.92
"""Zoom of the box within its panel; beyond it labels of the axes are cut."""


def surface_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw the joint density as surfaces on the same levels: theory and simulation.

    The theory is the exact density where there is one, else an averaged one.
    """
    chosen = _chosen(curve, observable)
    ends = common_grid(chosen.values(), cut=SHOWN)
    sheets = {route: _sheet(density, ends) for route, density in chosen.items()}
    top = max(float(values.max()) for _, values in sheets.values())
    figure = Figure(figsize=(4.3 * len(chosen), 4.0))
    for place, (route, (grid, values)) in enumerate(sheets.items(), start=1):
        axes = figure.add_subplot(1, len(chosen), place, projection="3d")
        assert isinstance(axes, Axes3D)
        _dress(axes, observable, ends, top)
        _draw(axes, grid, values, top)
        axes.set_title(route.words, y=0.96, loc="left", x=0.05)
    figure.subplots_adjust(left=0.0, right=0.96, bottom=0.06, top=0.96, wspace=0.06)
    return figure


def _chosen(curve: CurveOutcome, observable: Observable) -> dict[Route, AnyDensity]:
    densities = curve.densities(observable)
    # A theory that neglects something, the contacts for example, comes last.
    lines = sorted(lines_of(curve, observable), key=curve.neglects)
    full = [r for r in samples_of(curve, observable) if r.solves == "full"]
    return {route: densities[route] for route in [*lines[:1], *full] or list(densities)[:1]}


def _sheet(density: AnyDensity, ends: tuple[Array, ...]) -> tuple[tuple[Array, ...], Array]:
    """Points and values of one surface; a sampled one has its own, joined bins."""
    if not isinstance(density, SampledDensity):
        grid = tuple(np.linspace(e[0], e[-1], LINES) for e in ends)
        return grid, values_on(density, *np.meshgrid(*grid, indexing="ij"))[0]
    bins = density.edges[0].size - 1
    width = (ends[0][-1] - ends[0][0]) / (density.edges[0][1] - density.edges[0][0])
    factors = [f for f in range(1, bins) if all((e.size - 1) % f == 0 for e in density.edges)]
    factor = next((f for f in factors if width / f <= SIMULATED), factors[-1])
    joined = density.coarsened(factor)
    middles = [0.5 * (e[1:] + e[:-1]) for e in joined.edges]
    inside = [(m >= e[0]) & (m <= e[-1]) for m, e in zip(middles, ends, strict=True)]
    grid = tuple(m[i] for m, i in zip(middles, inside, strict=True))
    return grid, joined.values[np.ix_(*inside)]


def _draw(axes: Axes3D, grid: tuple[Array, ...], values: Array, top: float) -> None:
    x, y = np.meshgrid(*grid, indexing="ij")
    light = LightSource(azdeg=225, altdeg=50)
    spans = [float(np.ptp(g)) for g in grid]
    colours = light.shade(
        values.T,
        cmap=colormaps["viridis"],
        norm=Normalize(0.0, top),
        blend_mode="soft",
        vert_exag=0.5 * min(spans) / top,
        dx=spans[0] / values.shape[0],
        dy=spans[1] / values.shape[1],
    ).transpose(1, 0, 2)
    sheet = axes.plot_surface(
        x, y, values, facecolors=colours, rcount=LINES, ccount=LINES,
        linewidth=0, antialiased=False, shade=False,
    )  # fmt: skip
    sheet.set_rasterized(True)


def _dress(axes: Axes3D, observable: Observable, ends: tuple[Array, ...], top: float) -> None:
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)
    axes.set_box_aspect(ASPECT, zoom=DISTANCE)
    axes.set_proj_type("ortho")
    axes.set_xlim(ends[0][0], ends[0][-1])
    axes.set_ylim(ends[1][0], ends[1][-1])
    axes.set_zlim(0.0, 1.05 * top)
    axes.set_xlabel(words_of(observable[0]))
    axes.set_ylabel(words_of(observable[1]))
    axes.set_zlabel(f"density $p({symbol_of(observable[0])}, {symbol_of(observable[1])})$")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5))
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"].update(color=(0.5, 0.5, 0.5, 0.25), linewidth=0.5)
