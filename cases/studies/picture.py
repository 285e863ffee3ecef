"""The picture of every study: errors on a logarithmic axis over whatever was varied."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from math import ceil
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cases.output.pictures.style import COLOURS, INK, STYLE
from cases.studies.sweep.grid import Axis
from fpk.arrays import Array

MARKERS = "osD^vXPh"
DASHES: Any = (0, (4, 2))
HALO: Any = {"boxstyle": "square,pad=0.1", "fc": "#f4f4f4", "ec": "none", "alpha": 0.85}
"""Box behind words that a curve may cross."""
ROUND_OFF = 1e-16
"""Where an error of zero is drawn: a rounding error of one."""
LEGEND_COLUMNS, LEGEND_ROW = 2, 0.2
"""Columns of a legend, and the height of one of its rows in inches."""
ALONE = 6.6
"""Width of a single panel in inches: that of its legend, too."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors ``y`` over ``x`` with their name in the legend.

    ``bar`` is how far chance may have moved each; ``dashed`` are the two coordinates of a line of
    theory. ``style``: "-" or "none" for points that are joined or not, ":" for points computed by a
    law, not measured.
    """

    name: str
    x: Sequence[float] | Array
    y: Sequence[float] | Array
    bar: Array | None = None
    dashed: tuple[Array, Array] | None = None
    style: str = "-"


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one axis. ``floor``: below it nothing is resolved; ``marks``: levels by words."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    floor: float | None = None
    marks: Sequence[tuple[float, str]] = ()
    logarithmic: bool = True
    limits: tuple[float, float] | None = None
    y_logarithmic: bool = True


def study_figure(panels: Sequence[Panel], *, width: float = 4.3) -> Figure:
    """Draw the panels, two in a row; the legend of each stands below it, where no curve passes."""
    columns = min(2, len(panels)) or 1
    rows = ceil(len(panels) / columns) or 1
    entries = max((len(panel.curves) for panel in panels), default=0)
    height = 3.0 + LEGEND_ROW * ceil(entries / LEGEND_COLUMNS)
    with mpl.rc_context({**STYLE, "font.size": 8.5, "axes.titlesize": 8.5}):
        size = width * columns if columns > 1 else ALONE, height * rows
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(panels) :]:
            axes.remove()
        for axes, panel in zip(grid, panels, strict=False):
            _draw(axes, panel)
    return figure


def curves_over(axis: Axis, names: Sequence[str], values: Any, errors: Any) -> list[Curve]:
    """Return a curve for each of ``names`` with its row of ``values``, unless all are NaN."""
    rows = zip(names, values, errors, strict=True)
    return [Curve(name, axis.values, y, bar) for name, y, bar in rows if np.isfinite(y).any()]


def heat(axes: Axes, x: Axis, y: Axis, field: Any, **palette: Any) -> Any:
    """Draw ``field`` (x, y) as cells around the values of two axes; NaN leaves its cell empty."""
    shown = np.ma.masked_invalid(field).T
    cells = axes.pcolormesh(_edges(x), _edges(y), shown, rasterized=True, **palette)
    scales = ["log" if axis.logarithmic else "linear" for axis in (x, y)]
    axes.set(xlabel=x.label, xscale=scales[0], yscale=scales[1])
    axes.set(xlim=(x.values[0], x.values[-1]), ylim=(y.values[0], y.values[-1]))
    return cells


def _edges(axis: Axis) -> Array:
    """Cell edges halfway between the values, on the axis' own scale."""
    u = np.log(axis.values) if axis.logarithmic else axis.values
    middles = 0.5 * (u[1:] + u[:-1])
    edges = np.concatenate([[2.0 * u[0] - middles[0]], middles, [2.0 * u[-1] - middles[-1]]])
    return np.exp(edges) if axis.logarithmic else edges


def _draw(axes: Axes, panel: Panel) -> None:
    axes.set(title=panel.title, xlabel=panel.x, ylabel=panel.y)
    axes.set(xscale="log" if panel.logarithmic else "linear")
    axes.set_yscale("log" if panel.y_logarithmic else "linear")
    if panel.limits is not None:
        axes.set_ylim(panel.limits)
    for curve, colour, marker in zip(panel.curves, cycle(COLOURS), cycle(MARKERS), strict=False):
        y, bars = np.asarray(curve.y), None if curve.bar is None else [curve.bar, curve.bar]
        if panel.y_logarithmic:
            y = np.maximum(y, ROUND_OFF)
            bars = bars and [np.minimum(bars[0], 0.9 * y), bars[1]]
        axes.errorbar(
            curve.x, y, bars, color=colour, marker=marker, markersize=3.6, lw=1.2, elinewidth=0.8,
            ls=curve.style, mfc="none" if curve.style == ":" else colour, label=curve.name,
        )  # fmt: skip
        if curve.dashed is not None:
            axes.plot(*curve.dashed, color=colour, lw=0.9, ls=DASHES)
    levels = [(level, words, 2, "bottom") for level, words in panel.marks]
    for level, *_ in levels:
        axes.axhline(level, color=INK, lw=0.9, ls=DASHES)
    if panel.floor is not None:
        axes.axhspan(axes.get_ylim()[0], panel.floor, color=INK, alpha=0.08, lw=0)
        levels.append((panel.floor, "floor: error of the reference", -2, "top"))
    for level, words, offset, side in levels:
        axes.annotate(
            words, (0.985, level), xycoords=axes.get_yaxis_transform(), annotation_clip=True,
            xytext=(0, offset), textcoords="offset points", ha="right", va=side, fontsize=6.5,
            bbox=HALO,
        )  # fmt: skip
    if panel.curves:
        axes.legend(
            loc="upper left", bbox_to_anchor=(-0.02, -0.19), ncols=LEGEND_COLUMNS, fontsize=7.0,
            columnspacing=1.2, handlelength=1.8, borderaxespad=0.0,
        )  # fmt: skip
