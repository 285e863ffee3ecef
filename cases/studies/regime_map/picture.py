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
from cases.studies.regime_map.build import RegimeMap
from cases.studies.regime_map.grid import Axis
from cases.studies.regime_map.points import THEORIES, UNDECIDED
from fpk.clearance import CLEARANCE_RULE
from fpk.density import Array

WORDS = {"nonintegrable": "averaging, Eq. (11)", "integrable": "averaging, Eq. (34)"}
LETTERS = {"contact.stiffness": "contact stiffness $B$", "contact.clearance": "clearance $δ$"}
PALE = "#d9d9d4"


def regime_figure(found: RegimeMap) -> Figure:
    """Draw a map over one parameter as curves, over two as fields."""
    with mpl.rc_context(dict(STYLE)):
        return _curves(found) if len(found.axes) == 1 else _fields(found)


def _curves(found: RegimeMap) -> Figure:
    figure = Figure(figsize=(6.6, 3.8), layout="constrained")
    axes = figure.subplots()
    (axis,) = found.axes
    for theory, colour in zip(THEORIES, COLOURS, strict=False):
        L1, error = _of(found, "L1", theory), _of(found, "error", theory)
        if np.all(np.isnan(L1)):
            continue
        axes.fill_between(
            axis.values, np.maximum(L1 - error, 1e-6), L1 + error, color=colour, alpha=0.25, lw=0
        )
        axes.plot(axis.values, L1, color=colour, marker="o", markersize=3.4, label=WORDS[theory])
    axes.set_yscale("log")
    _scale(axes, axis, "x")
    axes.set_ylabel(f"$L_1$ distance of $p({symbol_of(found.observable[0])})$ to the full system")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def _fields(found: RegimeMap) -> Figure:
    figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    x, y = found.axes
    fields = [_of(found, "L1", theory) for theory in THEORIES]
    known = np.concatenate([f[np.isfinite(f) & (f > 0)] for f in fields] or [np.ones(1)])
    floor, top = (float(known.min()), float(known.max())) if known.size else (0.1, 1.0)
    norm = LogNorm(max(floor, 1e-4), max(top, 2 * max(floor, 1e-4)))
    edges = _edges(x), _edges(y)
    for axes, theory, field in zip(panels, THEORIES, fields, strict=False):
        drawn = axes.pcolormesh(
            *edges, np.ma.masked_invalid(field).T, norm=norm, cmap="viridis_r", rasterized=True
        )
        axes.set_title(WORDS[theory])
    _winners(panels[2], found, edges)
    for axes in panels:
        _scale(axes, x, "x")
        _rule(axes, found)
    for axes in panels[1:]:
        axes.set_ylabel("")
    _scale(panels[0], y, "y")
    bar = figure.colorbar(drawn, ax=list(panels[:2]), location="right", shrink=0.95, pad=0.02)
    bar.set_label(f"$L_1$ distance of $p({symbol_of(found.observable[0])})$ to the full system")
    return figure


def _winners(axes: Axes, found: RegimeMap, edges: tuple[Array, Array]) -> None:
    names = (*THEORIES, UNDECIDED)
    colours = (COLOURS[0], COLOURS[1], PALE)
    index = [names.index(p.winner) if p.winner in names else np.nan for p in found.points]
    field = np.ma.masked_invalid(np.reshape(np.array(index, dtype=float), found.shape))
    axes.pcolormesh(
        *edges, field.T, cmap=ListedColormap(colours), vmin=-0.5, vmax=2.5, rasterized=True
    )
    axes.set_title("nearer to the full system")
    handles: list[Any] = [Patch(color=c) for c in colours]
    handles.append(Line2D([], [], color=INK, linestyle=(0, (4, 2)), linewidth=1.2))
    rule = f"clearance = {CLEARANCE_RULE:g} rms"
    axes.figure.legend(
        handles,
        [WORDS["nonintegrable"], WORDS["integrable"], "within the noise", rule],
        loc="outside lower center",
        ncols=4,
    )


def _rule(axes: Axes, found: RegimeMap) -> None:
    """The rule of section 6.3 as a line, where it lies inside the map."""
    x, y = found.axes
    axes.set_xlim(x.values[0], x.values[-1])
    axes.set_ylim(y.values[0], y.values[-1])
    ratio = np.array([np.nan if p.rms_ratio is None else p.rms_ratio for p in found.points])
    if np.nanmin(ratio, initial=np.inf) < CLEARANCE_RULE < np.nanmax(ratio, initial=-np.inf):
        axes.contour(
            x.values,
            y.values,
            ratio.reshape(found.shape).T,
            levels=[CLEARANCE_RULE],
            colors=[INK],
            linestyles=[(0, (4, 2))],
            linewidths=1.2,
        )


def _of(found: RegimeMap, key: str, theory: str) -> Array:
    values = [getattr(p, key).get(theory, np.nan) for p in found.points]
    return np.reshape(np.array(values, dtype=float), found.shape)


def _edges(axis: Axis) -> Array:
    """Cell edges halfway between the values, on the axis' own scale."""
    values = np.log(axis.values) if axis.logarithmic else axis.values
    middles = 0.5 * (values[1:] + values[:-1])
    edges = np.concatenate([[2 * values[0] - middles[0]], middles, [2 * values[-1] - middles[-1]]])
    return np.exp(edges) if axis.logarithmic else edges


def _scale(axes: Axes, axis: Axis, which: str) -> None:
    axes.set(**{f"{which}label": LETTERS[axis.key]})
    if axis.logarithmic:
        axes.set(**{f"{which}scale": "log"})
