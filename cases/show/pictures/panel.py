"""The picture of every study: curves of errors over whatever was varied, and heat pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from math import ceil
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cases.show.page import MARKS, rounded
from cases.show.pictures.lines import CURVE_MARKS
from cases.show.pictures.style import COLOURS, INK, STYLE
from cases.show.records import Record
from cases.show.variables import Axis
from cases.show.words import named
from fpk.numeric.arrays import Array

DASHES: Any = (0, (4, 2))
HALO: Any = {"boxstyle": "square,pad=0.1", "fc": "#f4f4f4", "ec": "none", "alpha": 0.85}
"""Box behind words that a curve may cross."""
ROUND_OFF = 1e-16
"""Where an error of zero is drawn: a rounding error of one."""
LEGEND_COLUMNS, LEGEND_ROW = 2, 0.2
"""Columns of a legend, and the height of one of its rows in inches."""
WIDTH, ALONE = 5.2, 6.6
"""Width of one of several panels in inches, and of a single one: that of its legend, too."""
DECADES = 100.0
"""Ratio of the largest to the smallest value from which an axis is logarithmic."""
FLOOR_WORDS = "floor: error of the reference"


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors ``y`` over ``x`` with their name in the legend.

    ``bar`` is how far chance may have moved each; ``dashed`` are the two coordinates of a line of
    theory. ``style``: "-" or "none" for points that are joined or not, ":" for points computed by a
    law, not measured. ``notes`` say in a page what is known of each point.
    """

    name: str
    x: Sequence[float] | Array
    y: Sequence[float] | Array
    bar: Array | None = None
    dashed: tuple[Array, Array] | None = None
    style: str = "-"
    notes: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one axis. ``floor``: below it nothing is resolved; ``marks``: levels by words.

    ``by_x``: a reader of the page asks for all curves at one x, else for a point of a curve.
    """

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    floor: float | None = None
    marks: Sequence[tuple[float, str]] = ()
    logarithmic: bool = True
    limits: tuple[float, float] | None = None
    y_logarithmic: bool = True
    by_x: bool = False


@dataclass(frozen=True, eq=False)
class Field:
    """A heat picture of ``values`` (x, y), NaN where there is none, with their ``errors``.

    Values run between ``limits``. Of ``categories``, words and colours, they are the numbers.
    ``split`` (x, y) is True on one side of a border that is drawn, which ``border`` names.
    """

    title: str
    x: Axis
    y: Axis
    values: Array
    errors: Array | None = None
    logarithmic: bool = False
    limits: tuple[float, float] | None = None
    palette: str = "viridis"
    categories: tuple[tuple[str, str], ...] = ()
    split: Any = None
    border: str = ""


def spans_decades(values: Any) -> bool:
    """Whether an axis of the values should be logarithmic: their ratio exceeds ``DECADES``."""
    given = values[np.isfinite(values)]
    return bool(given.size and given.min() > 0.0 and given.max() > DECADES * given.min())


def study_figure(panels: Sequence[Panel | Field]) -> Figure:
    """Draw the panels, two in a row; the legend of each stands below it, where no curve passes."""
    columns = min(2, len(panels)) or 1
    rows = ceil(len(panels) / columns) or 1
    entries = max((len(panel.curves) for panel in panels if isinstance(panel, Panel)), default=0)
    height = 3.0 + LEGEND_ROW * ceil(entries / LEGEND_COLUMNS)
    with mpl.rc_context({**STYLE, "font.size": 8.5, "axes.titlesize": 8.5}):
        size = WIDTH * columns if columns > 1 else ALONE, height * rows
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(panels) :]:
            axes.remove()
        for axes, panel in zip(grid, panels, strict=False):
            if isinstance(panel, Panel):
                _draw(axes, panel)
            else:
                _heat(figure, axes, panel)
    return figure


def curves_over(axis: Axis, names: Sequence[str], values: Any, errors: Any) -> list[Curve]:
    """Return a curve for each of ``names`` with its row of ``values``, unless all are NaN."""
    rows = zip(names, values, errors, strict=True)
    return [Curve(name, axis.values, y, bar) for name, y, bar in rows if np.isfinite(y).any()]


def _heat(figure: Figure, axes: Axes, field: Field) -> None:
    """Draw cells around the values of two axes; NaN leaves its cell empty."""
    low, high = field.limits or (None, None)
    palette: dict[str, Any] = {"cmap": field.palette, "vmin": low, "vmax": high}
    if field.logarithmic:
        palette = {"cmap": field.palette, "norm": LogNorm(low, high)}
    if field.categories:
        words, colours = zip(*field.categories, strict=True)
        palette = {"vmin": -0.5, "vmax": len(words) - 0.5, "cmap": ListedColormap(colours)}
    x, y = field.x, field.y
    shown = np.ma.masked_invalid(field.values).T
    cells = axes.pcolormesh(_edges(x), _edges(y), shown, rasterized=True, **palette)
    scales = ["log" if axis.logarithmic else "linear" for axis in (x, y)]
    axes.set(title=field.title, xlabel=x.label, ylabel=y.label, xscale=scales[0], yscale=scales[1])
    handles: list[Any] = [Patch(color=colour, label=name) for name, colour in field.categories]
    if field.split is not None and 0 < np.count_nonzero(field.split) < field.split.size:
        borders: Any = {"colors": [INK], "linestyles": [DASHES], "linewidths": 1.2}
        axes.contour(x.values, y.values, field.split.T.astype(float), levels=[0.5], **borders)
        handles.append(Line2D([], [], color=INK, linestyle=DASHES, lw=1.2, label=field.border))
    if not field.categories:
        figure.colorbar(cells, ax=axes)
    elif handles:
        below: Any = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.19), "fontsize": 7.0}
        axes.legend(handles=handles, ncols=LEGEND_COLUMNS, **below)


def live_plots(panels: Sequence[Panel | Field], still: str) -> list[Record]:
    """Return the plots of the script of a page; ``still`` is the figure in whose place they are."""
    fields = [panel for panel in panels if isinstance(panel, Field)]
    plots = [_live_curves(panel) for panel in panels if isinstance(panel, Panel)]
    plots += [_live_map(fields)] if fields else []
    return [{"id": f"{still}_{k}", "still": [still], **plot} for k, plot in enumerate(plots)]


def _live_curves(panel: Panel) -> Record:
    levels: list[Record] = [{"y": level, "words": words} for level, words in panel.marks]
    if panel.floor is not None:
        levels.append({"y": panel.floor, "words": FLOOR_WORDS, "fill": True})
    xs = [np.asarray(curve.x, dtype=float) for curve in panel.curves]
    shared = panel.by_x and all(np.array_equal(x, xs[0]) for x in xs)
    series = []
    for curve, colour, mark in zip(panel.curves, cycle(COLOURS), cycle(MARKS), strict=False):
        y = np.asarray(curve.y, dtype=float)
        own: Record = {
            "curve": "", "name": named(curve.name), "shown": True, "colour": colour, "marks": mark,
            "x": None if shared else curve.x, "notes": curve.notes, "guide": curve.dashed,
            **rounded(y=np.maximum(y, ROUND_OFF) if panel.y_logarithmic else y, error=curve.bar),
        }  # fmt: skip
        if curve.bar is not None:
            own["bars"] = 1
        if curve.style != "none":
            own["dash"] = "1 3" if curve.style == ":" else ""
        series.append(own)
    return {
        "title": panel.title,
        "xlabel": panel.x,
        "ylabel": panel.y,
        "xlog": panel.logarithmic,
        "scales": [panel.y_logarithmic],
        "yends": panel.limits,
        "levels": levels,
        "x": xs[0] if shared and xs else None,
        "series": series,
    }


def _live_map(fields: Sequence[Field]) -> Record:
    x, y = fields[0].x, fields[0].y
    split = fields[0].split
    own = []
    for field in fields:
        given = field.values[np.isfinite(field.values)]
        low, high = field.limits or ((given.min(), given.max()) if given.size else (0.0, 1.0))
        error = None if field.errors is None else field.errors.ravel()
        numbers = rounded(z=field.values.ravel(), error=error)
        words, colours = zip(*field.categories, strict=True) if field.categories else ((), ())
        one: Record = {"name": field.title, "shown": True, "log": field.logarithmic, **numbers}
        one |= {
            "low": low,
            "high": high if high > low else low + (abs(low) or 1.0),
            "floor": max(low, 0.0),
        }
        own.append({**one, **({"names": words, "colours": colours} if words else {})})
    return {
        "x": x.values,
        "y": y.values,
        "xlog": x.logarithmic,
        "ylog": y.logarithmic,
        "xlabel": x.label,
        "ylabel": y.label,
        "split": None if split is None else split.astype(int).ravel(),
        "border": fields[0].border,
        "fields": own,
    }


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
    for curve, colour, marker in zip(
        panel.curves, cycle(COLOURS), cycle(CURVE_MARKS), strict=False
    ):
        y, bars = np.asarray(curve.y), None if curve.bar is None else [curve.bar, curve.bar]
        if panel.y_logarithmic:
            y = np.maximum(y, ROUND_OFF)
            bars = bars and [np.minimum(bars[0], 0.9 * y), bars[1]]
        axes.errorbar(
            curve.x, y, bars, color=colour, marker=marker, markersize=3.6, lw=1.2, elinewidth=0.8,
            ls=curve.style, mfc="none" if curve.style == ":" else colour, label=named(curve.name),
        )  # fmt: skip
        if curve.dashed is not None:
            axes.plot(*curve.dashed, color=colour, lw=0.9, ls=DASHES)
    levels = [(level, words, 2, "bottom") for level, words in panel.marks]
    for level, *_ in levels:
        axes.axhline(level, color=INK, lw=0.9, ls=DASHES)
    if panel.floor is not None:
        axes.axhspan(axes.get_ylim()[0], panel.floor, color=INK, alpha=0.08, lw=0)
        levels.append((panel.floor, FLOOR_WORDS, -2, "top"))
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
