"""Drawings by matplotlib of what ``pictures/panel.py`` describes."""

from collections.abc import Sequence
from math import ceil
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator

from cases.show.pictures.panel import Curve, Field, Panel
from cases.show.pictures.style import DASHES, INK, STYLE
from cases.show.variables import Axis
from fpk.numeric.arrays import Array

HALO: Any = {"boxstyle": "square,pad=0.1", "fc": "#f4f4f4", "ec": "none", "alpha": 0.85}
"""Box behind words that a curve may cross."""

ACROSS = 4.4
"""Width of a picture with one column of axes, in inches: legible on a telephone."""

LEFT, RIGHT, FOOT, GAP, LEGEND_ROW = 0.66, 0.12, 0.5, 0.34, 0.19
"""Margins beside and below the axes, the gap between two for a title, and the height of a row of
the legend, in inches. Fixed: to measure all words first draws every picture twice."""

CONTOURS = 13
"""Number of contour levels of a joint density, the lowest and the largest value included."""


def column_figure(
    panels: Sequence[Panel], height: float, *, figure: Figure | None = None
) -> Figure:
    """Draw the panels below each other over one x axis, ``height`` inches each.

    One legend stands above all; a lone panel has no title. ``figure``, if given, is drawn into and
    resized, else a new figure.
    """
    figure = figure or Figure()
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    legend: dict[str, Artist] = {}
    for axes, panel in zip(grid, panels, strict=True):
        own = draw_curves(axes, panel, ink=len(panels) > 1)
        legend = own | legend
        axes.set_xlabel("")
        if len(panels) > 1:
            axes.set(title="", ylabel="")
            axes.set_title(panel.title, loc="right")  # at the left the axis has its power of ten
            axes.locator_params(axis="y", nbins=4)
        else:
            axes.set_title("")
    grid[-1].set_xlabel(panels[-1].x)
    if len(panels) > 1:
        figure.supylabel(panels[0].y, fontsize=STYLE["font.size"], x=0.005, ha="left")
    # A letter is about 0.55 of the size of the font wide, a line beside its words half an inch.
    letters = (36.0 * ACROSS - 36.0) / (0.55 * STYLE["legend.fontsize"])
    columns = 2 if max(map(len, legend), default=0) <= letters else 1
    head = LEGEND_ROW * ceil(len(legend) / columns) + (GAP if len(panels) > 1 else 0.16)
    total = head + len(panels) * height + (len(panels) - 1) * GAP + FOOT
    figure.set_size_inches(ACROSS, total)
    figure.subplots_adjust(
        LEFT / ACROSS,
        FOOT / total,
        1.0 - RIGHT / ACROSS,
        1.0 - head / total,
        hspace=GAP / height,
    )
    figure.legend(list(legend.values()), list(legend), loc="upper left", ncols=columns)
    return figure


def study_figure(panels: Sequence[Panel | Field]) -> Figure:
    """Draw the panels in a new figure, two in a row, the legend of each below it."""
    columns = min(2, len(panels)) or 1
    rows = ceil(len(panels) / columns) or 1
    entries = max((len(panel.curves) for panel in panels if isinstance(panel, Panel)), default=0)
    width, height = 5.2 * columns if columns > 1 else 6.6, 3.0 + 0.2 * ceil(entries / 2)
    small: Any = {"font.size": 8.5, "axes.titlesize": 8.5, "legend.fontsize": 7.0}
    spaces: Any = {
        "legend.columnspacing": 1.2,
        "legend.handlelength": 1.8,
        "legend.borderaxespad": 0.0,
    }
    with mpl.rc_context({**STYLE, **small, **spaces}):
        figure = Figure(figsize=(width, height * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(panels) :]:
            axes.remove()
        for axes, panel in zip(grid, panels, strict=False):
            if isinstance(panel, Panel):
                handles = draw_curves(axes, panel)
            else:
                handles, drawn = draw_map(axes, panel)
                if not panel.categories:
                    figure.colorbar(drawn, ax=axes)
                    continue
            if handles:
                place: Any = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.19), "ncols": 2}
                axes.legend(list(handles.values()), list(handles), **place)
    return figure


def contour_figure(fields: Sequence[Field], label: str, *, figure: Figure | None = None) -> Figure:
    """Draw contours of the fields, two in a row, with one bar of colours that ``label`` names.

    All fields must have the limits, scale and axes of the first. ``figure`` None: a new figure.
    """
    columns = min(2, len(fields))
    rows = ceil(len(fields) / columns)
    figure = figure or Figure()
    figure.set_size_inches(1.75 * columns + 0.9, 2.1 * rows + 0.3)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in grid[len(fields) :]:
        axes.remove()
    for axes, field in zip(grid, fields, strict=False):
        _, drawn = draw_map(axes, field, contours=True)
        axes.set(xlabel="", ylabel="", title=field.brief or field.title)
    figure.supxlabel(fields[0].x.label, fontsize=STYLE["font.size"])
    figure.supylabel(fields[0].y.label, fontsize=STYLE["font.size"])
    ticks = LogLocator() if fields[0].logarithmic else MaxNLocator(7)  # round numbers at any levels
    own = list(grid[: len(fields)])
    bar = figure.colorbar(drawn, ax=own, ticks=ticks, format="%.4g", aspect=22)
    bar.set_label(label)
    return figure


def draw_curves(axes: Axes, panel: Panel, *, ink: bool = False) -> dict[str, Artist]:
    """Draw a panel into ``axes``, curves only if ``shown``; return legend handles by their words.

    ``ink``: the legend has names in the colour of text, as always if there are several groups.
    """
    axes.set(title=panel.title, xlabel=panel.x, ylabel=panel.y)
    axes.set_xscale("log" if panel.logarithmic else "linear")
    if panel.y_logarithmic:
        axes.set_yscale("log", nonpositive="clip")
    else:
        axes.ticklabel_format(axis="y", scilimits=(-3, 3))
    groups: dict[str, Artist] = {}
    names: dict[str, Artist] = {}
    several = len(panel.groups) > 1
    for curve, colour, marker, y in panel.styled():
        if not curve.shown:
            continue
        drawn = _line_style(curve, marker)
        if curve.bar is not None and curve.bars:
            reach = curve.bars * np.asarray(curve.bar)
            if curve.band:
                low, high, alpha = y - reach, y + reach, 0.25 if marker else 0.16
                axes.fill_between(curve.x, low, high, color=colour, alpha=alpha, linewidth=0)
            if marker:  # one path for all bars: errorbar makes the file half as long again
                ends = np.column_stack([y - reach, y + reach, np.full(len(y), np.nan)])
                axes.plot(np.repeat(curve.x, 3), ends.ravel(), color=colour, lw=0.9, zorder=1.9)
        # Points of samples lie below the lines, which they would hide.
        axes.plot(curve.x, y, color=colour, zorder=1.9 if curve.style == "none" else 2.0, **drawn)
        if curve.dashed is not None:
            axes.plot(*curve.dashed, color=colour, lw=0.9, ls=dash_pattern("--"))
        if several:
            handle = Line2D([], [], color=colour, linewidth=3, marker=marker or None, markersize=5)
            if marker or curve.group not in groups:
                groups[curve.group] = handle
            drawn = drawn if not marker or curve.style != "none" else {**drawn, "marker": "o"}
        of_band = curve.band and not marker and curve.style == "none"
        own: Any = {"alpha": 0.16, "linewidth": 6} if of_band else drawn
        handle = Line2D([], [], color=INK if several or ink else colour, **own)
        names.setdefault(curve.legend, handle)
    _finish(axes, panel)
    return groups | names


def _line_style(curve: Curve, marker: str) -> dict[str, Any]:
    """Arguments of ``Axes.plot`` for a curve; markers are filled only on a solid line."""
    own: dict[str, Any] = {"linestyle": "none"}
    if curve.style != "none":
        own = {"linestyle": dash_pattern(curve.style), "linewidth": 1.2 if marker else 1.6}
    if marker:
        own |= {"marker": marker, "markersize": 3.6, "markeredgewidth": 0.9}
        if curve.style != "-":
            own["markerfacecolor"] = "none"
    return own


def dash_pattern(style: str) -> Any:
    """Return the dashes of ``style``, a key of ``DASHES``, as a ``linestyle`` of matplotlib."""
    return (0, [float(v) / 2.0 for v in DASHES[style].split()]) if DASHES[style] else "-"


def _finish(axes: Axes, panel: Panel) -> None:
    """Set the ends of ``axes``, mark levels and stops, and shade the side beyond a stop."""
    x = panel.shared_x()
    marked = any(curve.style != "none" and marker for curve, _, marker, _ in panel.styled())
    if x.size > 1 and not marked:
        axes.set_xlim(x[0], x[-1])
    elif x.size > 1 and x[0] == 0.0:
        axes.set_xlim(left=0.0)
    if panel.limits is not None:
        axes.set_ylim(panel.limits)
    elif panel.y_logarithmic and panel.lowest:
        shown = [y for curve, _, _, y in panel.styled() if curve.shown and len(y)]
        top = max((float(np.nanmax(y)) for y in shown), default=1.0)
        axes.set_ylim(panel.lowest * top, 2.0 * top)
    elif panel.zero:
        axes.set_ylim(bottom=0.0)
    ends = axes.get_xlim()
    for stop in panel.stops:
        axes.axvline(stop, color=INK, linewidth=0.8, alpha=0.5)
    for interval in panel.shaded():
        axes.axvspan(*np.clip(interval, *ends), color=INK, alpha=0.07, linewidth=0)
    axes.set_xlim(ends)
    for level in panel.levels():
        y, below = level["y"], level["fill"]
        if below:
            axes.axhspan(axes.get_ylim()[0], y, color=INK, alpha=0.08, lw=0)
        else:
            axes.axhline(y, color=INK, lw=0.9, ls=dash_pattern("--"))
        place: Any = {"xycoords": axes.get_yaxis_transform(), "annotation_clip": True}
        place |= {"xytext": (0, -2 if below else 2), "textcoords": "offset points", "ha": "right"}
        place["va"] = "top" if below else "bottom"
        axes.annotate(level["words"], (0.985, y), fontsize=6.5, bbox=HALO, **place)


def draw_map(axes: Axes, field: Field, *, contours: bool = False) -> tuple[dict[str, Artist], Any]:
    """Draw a field into ``axes`` as cells around its points, or as filled ``contours``.

    Return the handles of a legend by their words, and the artist whose colours a bar shows.
    """
    low, high = field.limits or (np.nanmin(field.values), np.nanmax(field.values))
    palette: dict[str, Any] = {"cmap": "viridis", "norm": Normalize(low, high)}
    if field.logarithmic:
        low = field.lowest * high or low
        palette = {"cmap": "viridis", "norm": LogNorm(low, high)}
    if field.categories:
        words, colours = zip(*field.categories, strict=True)
        palette = {"vmin": -0.5, "vmax": len(words) - 0.5, "cmap": ListedColormap(colours)}
    x, y = field.x, field.y
    scales = ["log" if axis.logarithmic else "linear" for axis in (x, y)]
    axes.set(title=field.title, xlabel=x.label, ylabel=y.label, xscale=scales[0], yscale=scales[1])
    if contours:
        space = np.geomspace if field.logarithmic else np.linspace
        # Below the lowest level nothing is drawn; a logarithm needs a value there all the same.
        values = np.maximum(field.values, 0.1 * low) if field.logarithmic else field.values
        levels = space(low, high, CONTOURS)
        drawn: Any = axes.contourf(x.values, y.values, values.T, levels=levels, **palette)
    else:
        shown = np.ma.masked_invalid(field.values).T
        drawn = axes.pcolormesh(_edges(x), _edges(y), shown, rasterized=True, **palette)
    for line, stops in zip((axes.axvline, axes.axhline), field.stops, strict=True):
        for stop in stops:
            line(stop, color="white", linewidth=0.8, linestyle=":")
    handles: dict[str, Artist] = {name: Patch(color=c) for name, c in field.categories}
    if field.split is not None and 0 < np.count_nonzero(field.split) < field.split.size:
        style: Any = {"linestyles": [dash_pattern("--")], "linewidths": 1.2}
        split = field.split.T.astype(float)
        axes.contour(x.values, y.values, split, levels=[0.5], colors=[INK], **style)
        handles[field.border] = Line2D([], [], color=INK, linestyle=dash_pattern("--"), lw=1.2)
    return handles, drawn


def _edges(axis: Axis) -> Array:
    """Cell edges (points + 1,) halfway between the values, of logarithms on a logarithmic axis."""
    u = np.log(axis.values) if axis.logarithmic else axis.values
    middles = 0.5 * (u[1:] + u[:-1])
    edges = np.concatenate([[2.0 * u[0] - middles[0]], middles, [2.0 * u[-1] - middles[-1]]])
    return np.exp(edges) if axis.logarithmic else edges
