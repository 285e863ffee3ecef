"""The picture of a map: distance of each theory, and where each is nearer to the full system."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cases.output.pictures.style import COLOURS, INK, STYLE, symbol_of
from cases.studies.picture import DASHES, Curve, Panel, study_figure
from cases.studies.regime_map.build import RegimeMap
from cases.studies.regime_map.grid import Axis
from cases.studies.regime_map.points import THEORIES, UNDECIDED
from fpk.clearance import CLEARANCE_RULE
from fpk.density import Array

PALE = "#d9d9d4"
"""Colour of points at which the difference is within the noise."""
SMALLEST = 1e-4
"""L1 distance at which the colours end: chance moves it by more."""


def regime_figure(result: RegimeMap) -> Figure:
    """Draw a map over one parameter as curves, over two as fields."""
    if len(result.axes) == 2:
        with mpl.rc_context(dict(STYLE)):
            return _fields(result)
    (axis,) = result.axes
    curves = []
    for theory in THEORIES:
        L1, bar = (result.of_theory(key, theory) for key in ("L1", "error"))
        if not np.all(np.isnan(L1)):
            curves.append(Curve(theory, axis.values, L1, bar=bar, banded=True))
    words = _distance_words(result)
    panel = Panel(result.scene.title, axis.words, words, curves, logarithmic=axis.logarithmic)
    return study_figure([panel], width=6.6)


def _fields(result: RegimeMap) -> Figure:
    figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    x, y = result.axes
    edges = _edges(x), _edges(y)
    fields = np.array([result.of_theory("L1", theory) for theory in THEORIES])
    low, high = np.nanmin(fields, initial=0.1), np.nanmax(fields, initial=SMALLEST)
    norm = LogNorm(max(low, SMALLEST), max(high, 2.0 * max(low, SMALLEST)))
    for axes, theory, field in zip(panels, THEORIES, fields, strict=False):
        drawn = axes.pcolormesh(
            *edges, np.ma.masked_invalid(field).T, norm=norm, cmap="viridis_r", rasterized=True
        )
        axes.set_title(theory)
    _winners(panels[2], result, edges)
    for axes in panels:
        axes.set(xlabel=x.words, xscale=x.scale, yscale=y.scale)
        axes.set(xlim=(x.values[0], x.values[-1]), ylim=(y.values[0], y.values[-1]))
        _rule(axes, result)
    panels[0].set_ylabel(y.words)
    bar = figure.colorbar(drawn, ax=list(panels[:2]), location="right", shrink=0.95, pad=0.02)
    bar.set_label(_distance_words(result))
    return figure


def _winners(axes: Axes, result: RegimeMap, edges: tuple[Array, Array]) -> None:
    names, colours = (*THEORIES, UNDECIDED), (COLOURS[0], COLOURS[1], PALE)
    field = result.table(lambda p: names.index(p.winner) if p.winner in names else None)
    axes.pcolormesh(
        *edges, np.ma.masked_invalid(field).T, cmap=ListedColormap(colours), vmin=-0.5, vmax=2.5,
        rasterized=True,
    )  # fmt: skip
    axes.set_title("nearer to the full system")
    handles: list[Any] = [Patch(color=c) for c in colours]
    handles.append(Line2D([], [], color=INK, linestyle=DASHES, linewidth=1.2))
    words = [*THEORIES, "within the noise", f"clearance = {CLEARANCE_RULE:g} rms"]
    axes.figure.legend(handles, words, loc="outside lower center", ncols=4)


def _rule(axes: Axes, result: RegimeMap) -> None:
    """The rule of section 6.3 as a line, where it lies inside the map."""
    x, y = result.axes
    ratio = result.table(lambda p: p.rms_ratio)
    if np.nanmin(ratio, initial=np.inf) < CLEARANCE_RULE < np.nanmax(ratio, initial=-np.inf):
        axes.contour(
            x.values, y.values, ratio.T, levels=[CLEARANCE_RULE], colors=[INK],
            linestyles=[DASHES], linewidths=1.2,
        )  # fmt: skip


def _distance_words(result: RegimeMap) -> str:
    return f"$L_1$ distance of $p({symbol_of(result.observable[0])})$ to the full system"


def _edges(axis: Axis) -> Array:
    """Cell edges halfway between the values, on the axis' own scale."""
    values = np.log(axis.values) if axis.logarithmic else axis.values
    middles = 0.5 * (values[1:] + values[:-1])
    edges = np.concatenate([[2 * values[0] - middles[0]], middles, [2 * values[-1] - middles[-1]]])
    return np.exp(edges) if axis.logarithmic else edges
