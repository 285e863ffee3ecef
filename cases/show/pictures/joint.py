"""Pictures of joint densities: panels on common levels, and surfaces as in Fig. 7 of the paper."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.colors import LightSource, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from cases.compare.answers import Answers
from cases.compare.compare import join_bins
from cases.show.fields import common_grid
from cases.show.pictures.lines import walls_of
from cases.show.pictures.style import (
    SHOWN,
    SOLVER_WORDS,
    density_words,
    lines_of,
    samples_of,
    solver_difference,
    words_of,
)
from fpk.answer.density import AnyDensity
from fpk.answer.method import Route
from fpk.answer.names import Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

LOWEST = 1e-3
"""Lowest level of a picture in decades, relative to the largest."""

SHEET = 72
"""Points an axis of a surface, and about as many bins where it is sampled."""

PANEL, HEIGHT, MARGIN = 1.75, 2.1, 0.9
"""Width and height of a panel, and the width of the bar of colours and of all words, in inches."""

ACROSS = 2
"""Panels in a row: a picture is legible on a telephone."""


def joint_pictures(curve: Answers, observable: Observable) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything to be seen of a pair of coordinates."""
    name = observable_name(observable)
    stem = name.replace(",", "_")
    energies = all(c.kind == "H" for c in observable)
    walls = [walls_of([curve], (c,)) for c in observable]
    # A density of energies falls exponentially from its corner: decades, not equal steps.
    figure = joint_figure(curve, observable, decades=energies)
    yield f"density_{stem}", f"Joint density of {name}, on common levels.", figure
    grid = common_grid(_drawn(curve, observable).values(), cut=SHOWN)
    mesh = np.meshgrid(*grid, indexing="ij")
    if (pair := solver_difference(curve, observable, *mesh)) is not None:
        _, stated, differences = pair
        panels = {f"|{words}|": np.abs(values) for words, values in differences.items()}
        panels["errors that both state, added"] = stated
        figure = contour_panels(
            panels, grid, observable, "difference of p", decades=True, walls=walls
        )
        yield f"solver_{stem}", SOLVER_WORDS.format(name), figure
    if not energies:  # they pile up in a corner
        words = f"Joint density of {name} as a surface: theory, and simulation in joined bins."
        yield f"surface_{stem}", words, surface_figure(curve, observable)


def joint_figure(
    curve: Answers, observable: Observable, *, decades: bool, figure: Figure | None = None
) -> Figure:
    """Draw the joint density of ``observable`` by every route drawn, as ``contour_panels`` does."""
    drawn = _drawn(curve, observable)
    grid = common_grid(drawn.values(), cut=LOWEST if decades else SHOWN)
    mesh = np.meshgrid(*grid, indexing="ij")
    return contour_panels(
        {route.name: density(*mesh) for route, density in drawn.items()},
        grid,
        observable,
        density_words(observable),
        decades=decades,
        walls=[walls_of([curve], (c,)) for c in observable],
        figure=figure,
    )


def _drawn(curve: Answers, observable: Observable) -> dict[Route, AnyDensity]:
    return {**lines_of(curve, observable), **samples_of(curve, observable)}


def surface_figure(curve: Answers, observable: Observable) -> Figure:
    """Draw the joint density as surfaces on the same levels: theory and simulation.

    The theory is the exact density where there is one, else an averaged one; one that neglects
    something, the contacts for example, comes last.
    """
    theories = sorted(lines_of(curve, observable).items(), key=lambda a: curve.neglects(a[0]))
    full = [a for a in samples_of(curve, observable).items() if a[0].solves == "full"]
    drawn: dict[Route, AnyDensity] = dict([*theories[:1], *full])
    x, y = np.meshgrid(*common_grid(drawn.values(), cut=SHOWN, count=SHEET), indexing="ij")
    sheets = {
        route.name: (join_bins(d, SHEET) if isinstance(d, SampledDensity) else d)(x, y)
        for route, d in drawn.items()
    }
    top = max(float(values.max()) for values in sheets.values())
    figure = Figure(figsize=(4.4, 3.6 * len(sheets)))
    for place, (words, values) in enumerate(sheets.items(), start=1):
        axes = figure.add_subplot(len(sheets), 1, place, projection="3d", proj_type="ortho")
        assert isinstance(axes, Axes3D)
        axes.view_init(elev=28.0, azim=-58.0)
        axes.set_box_aspect((1.0, 1.0, 0.72), zoom=0.92)  # beyond it labels are cut
        x_words, y_words = map(words_of, observable)
        axes.set(xlabel=x_words, ylabel=y_words, zlabel=density_words(observable))
        axes.set_zlim(0.0, 1.05 * top)
        axes.locator_params(nbins=5)
        sheet = axes.plot_surface(
            x, y, values, cmap="viridis", norm=Normalize(0.0, top), rcount=SHEET, ccount=SHEET,
            lightsource=LightSource(azdeg=225, altdeg=50), linewidth=0, antialiased=False,
        )  # fmt: skip
        sheet.set_rasterized(True)
        axes.set_title(words, y=0.96, loc="left", x=0.05)
    figure.subplots_adjust(left=0.0, right=0.92, bottom=0.04, top=0.98, hspace=0.06)
    return figure


def contour_panels(
    panels: Mapping[str, Array],
    grid: tuple[Array, ...],
    observable: Observable,
    label: str,
    *,
    decades: bool,
    walls: Sequence[Sequence[float]] = ((), ()),
    figure: Figure | None = None,
) -> Figure:
    """Draw each of the ``panels`` (x, y) on common levels, in ``figure`` or a new one.

    ``decades``: levels are in one proportion, down to ``LOWEST`` of the largest value. ``walls``
    are the stops of either coordinate.
    """
    top = max(float(v.max()) for v in panels.values())
    levels = top * (np.geomspace(LOWEST, 1.0, 13) if decades else np.linspace(0.0, 1.0, 13))
    norm = LogNorm(levels[0], top) if decades else Normalize(0.0, top)
    columns = min(ACROSS, len(panels))
    rows = -(-len(panels) // columns)
    size = columns * PANEL + MARGIN, rows * HEIGHT + 0.3
    figure = figure or Figure()
    figure.set_size_inches(*size)
    figure.set_layout_engine("constrained")
    grid_of_axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid_of_axes.ravel()[len(panels) :]:
        axes.remove()
    for axes, (words, values) in zip(grid_of_axes.ravel(), panels.items(), strict=False):
        # Below the lowest level nothing is drawn; a logarithm needs a value there all the same.
        drawn = np.maximum(values, 0.1 * levels[0])
        filled = axes.contourf(*grid, drawn.T, levels=levels, norm=norm, cmap="viridis")
        for line, stops in zip((axes.axvline, axes.axhline), walls, strict=True):
            for stop in stops:
                line(stop, color="white", linewidth=0.8, linestyle=":")
        axes.set(title=words)
    figure.supxlabel(words_of(observable[0]), fontsize=9.5)
    figure.supylabel(words_of(observable[1]), fontsize=9.5)
    drawn_axes = list(grid_of_axes.ravel()[: len(panels)])
    ticks = LogLocator() if decades else MaxNLocator(7)  # round numbers, wherever the levels are
    bar = figure.colorbar(filled, ax=drawn_axes, ticks=ticks, format="%.4g", aspect=22)
    bar.set_label(label)
    return figure
