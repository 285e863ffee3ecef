"""A map as a page: its table, and the distance of each theory with the nearer one as a picture."""

from collections import Counter
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cases.output.pictures.style import COLOURS, INK, STYLE, symbol_of
from cases.studies.page import Page, Table
from cases.studies.picture import DASHES, Curve, Panel, study_figure
from cases.studies.regime_map.grid import KEYS
from cases.studies.regime_map.map import RegimeMap
from cases.studies.regime_map.points import NEITHER, THEORIES, UNDECIDED
from fpk.clearance import CLEARANCE_RULE
from fpk.observable import observable_name

PALE = "#d9d9d4"
"""Colour of points at which the difference is within the noise."""
SMALLEST = 1e-4
"""L1 distance at which the colours end: chance moves it by more."""


def map_page(result: RegimeMap) -> Page:
    """Return what ``fpk regime`` shows and writes: every point, and how often each is nearer."""
    rows = [
        {
            **dict(zip((a.key for a in result.axes), p.values, strict=True)),
            **{f"L1 {t}": p.L1.get(t) for t in THEORIES},
            **{f"error {t}": p.error.get(t) for t in THEORIES},
            "winner": p.winner,
            "reference": p.reference,
            "rms_ratio": p.rms_ratio,
        }
        for p in result.points
    ]
    counts = Counter(p.winner for p in result.points)
    names = [name for name in (*THEORIES, UNDECIDED, NEITHER) if counts[name]]
    summary = (
        f"p({observable_name(result.observable)}), {len(result.points)} points"
        f" ({result.reused} from disk), nearer to the full system: "
        + ", ".join(f"{name} {counts[name]}" for name in names)
    )
    title = "L1 distance to the full system, rms_ratio the clearance over the rms without contact"
    return Page(
        "regime",
        result.scene,
        f"Map of regimes: {result.scene.title}",
        [Table("points", title, rows, (summary,))],
        partial(regime_figure, result),
        summary=summary,
        gridded={
            str(key): (tuple(map(str, v.dims)), v.values, v.attrs)
            for key, v in result.dataset().variables.items()
        },
    )


def regime_figure(result: RegimeMap) -> Figure:
    """Draw a map over one parameter as curves, over two as fields."""
    data = result.dataset()
    words = f"L₁ distance of p({symbol_of(result.observable[0])}) to the full system"
    if len(result.axes) == 2:
        with mpl.rc_context(dict(STYLE)):
            return _fields(result, data, words)
    (axis,), curves = result.axes, []
    for theory in THEORIES:
        own = data.sel(theory=theory)
        if own["L1"].notnull().any():
            curves.append(Curve(theory, axis.values, own["L1"].values, bar=own["error"].values))
    title, x = result.scene.title, KEYS[axis.key]
    panel = Panel(title, x, words, curves, logarithmic=axis.logarithmic)
    return study_figure([panel], width=6.6)


def _fields(result: RegimeMap, data: xr.Dataset, words: str) -> Figure:
    low = max(np.nanmin(data["L1"], initial=0.1), SMALLEST)
    distances: dict[str, Any] = {
        "norm": LogNorm(low, max(np.nanmax(data["L1"], initial=SMALLEST), 2.0 * low)),
        "cmap": "viridis_r",
    }
    names, colours = (*THEORIES, UNDECIDED), (COLOURS[0], COLOURS[1], PALE)
    index = data["rms_ratio"] * np.nan
    for k, name in enumerate(names):
        index = index.where(data["winner"] != name, k)
    flat = ListedColormap(colours)
    fields: list[tuple[str, xr.DataArray, dict[str, Any]]] = [
        *((theory, data["L1"].sel(theory=theory), distances) for theory in THEORIES),
        ("nearer to the full system", index, {"vmin": -0.5, "vmax": 2.5, "cmap": flat}),
    ]
    figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    (x, y), ratio = result.axes, data["rms_ratio"]
    for axes, (title, field, palette) in zip(panels, fields, strict=True):
        field.plot.pcolormesh(
            ax=axes, x=x.key, y=y.key, xscale=x.scale, yscale=y.scale, add_colorbar=False,
            add_labels=False, rasterized=True, **palette,
        )  # fmt: skip
        if ratio.min() < CLEARANCE_RULE < ratio.max():  # the rule of section 6.3 as a line
            ratio.plot.contour(
                ax=axes, x=x.key, y=y.key, levels=[CLEARANCE_RULE], colors=[INK],
                linestyles=[DASHES], linewidths=1.2, add_labels=False,
            )  # fmt: skip
        axes.set(title=title, xlabel=KEYS[x.key], xlim=(x.values[0], x.values[-1]))
        axes.set(ylim=(y.values[0], y.values[-1]))
    panels[0].set_ylabel(KEYS[y.key])
    shades = ScalarMappable(**distances)
    bar = figure.colorbar(shades, ax=list(panels[:2]), location="right", shrink=0.95, pad=0.02)
    bar.set_label(words)
    rule = Line2D([], [], color=INK, linestyle=DASHES, linewidth=1.2)
    handles: list[Any] = [*(Patch(color=colour) for colour in colours), rule]
    legend = [*THEORIES, "within the noise", f"clearance = {CLEARANCE_RULE:g} rms"]
    figure.legend(handles, legend, loc="outside lower center", ncols=4)
    return figure
