"""A map as a page: its table, and the distance of each theory with the nearer one as a picture."""

from collections import Counter
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cases.output.pictures.style import COLOURS, INK, STYLE, symbol_of
from cases.output.variables import Variables
from cases.output.words import named
from cases.scene.units import bracketed
from cases.studies.page import Page, Table
from cases.studies.picture import DASHES, Panel, curves_over, heat, study_figure
from cases.studies.regime_map.map import RegimeMap
from cases.studies.regime_map.points import NEITHER, THEORIES, UNDECIDED
from cases.studies.sweep.grid import Axis
from fpk.arrays import Array
from fpk.clearance import CLEARANCE_RULE
from fpk.observable import observable_name

PALE = "#d9d9d4"
"""Colour of points at which the difference is within the errors."""
SMALLEST = 1e-4
"""L1 distance at which the colours end: chance moves it by more."""


def map_page(result: RegimeMap) -> Page:
    """Return what ``fpk regime`` shows and writes: every point, and how often each is nearer."""
    heads = [a.key + bracketed(a.unit) for a in result.sweep.axes]
    rows = [
        {
            **dict(zip(heads, p.values, strict=True)),
            **{f"L1 {named(t)}": p.L1.get(t) for t in THEORIES},
            **{f"error {named(t)}": p.error.get(t) for t in THEORIES},
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
        f" ({result.sweep.reused} from disk), nearer to the full system: "
        + ", ".join(f"{named(name)} {counts[name]}" for name in names)
    )
    title = "L1 distance to the full system, rms_ratio the clearance over the rms without contact"
    fields = map_variables(result)
    return Page(
        "regime",
        result.scene,
        f"Map of regimes: {result.scene.title}",
        [Table("points", title, rows, (summary,))],
        partial(regime_figure, result, fields),
        summary=summary,
        gridded=fields,
    )


def map_variables(result: RegimeMap) -> Variables:
    """Return ``L1`` and ``error`` (theory, parameters); by parameters what else is known."""
    swept, name = result.sweep, observable_name(result.observable)
    keys = tuple(axis.dimension for axis in swept.axes)

    def field(key: str, kind: type) -> Any:
        shape = [axis.values.size for axis in swept.axes]
        return np.array([getattr(p, key) for p in result.points], dtype=kind).reshape(shape)

    distance = f"L1 distance of p({name}) to the full system"
    moved = "how far chance and the solvers may have moved L1"
    ratio = "smallest clearance over rms displacement without contact"
    return {
        "theory": (("theory",), np.array(THEORIES), {}),
        **swept.coordinates(),
        "L1": (("theory", *keys), swept.field("value")[0], {"long_name": distance}),
        "error": (("theory", *keys), swept.field("error")[0], {"long_name": moved}),
        "rms_ratio": (keys, field("rms_ratio", float), {"long_name": ratio}),
        **{key: (keys, field(key, str), {}) for key in ("winner", "reference")},
    }


def regime_figure(result: RegimeMap, fields: Variables) -> Figure:
    """Draw a map over one parameter as curves, over two as fields."""
    L1, error, ratio, winner = (fields[key][1] for key in ("L1", "error", "rms_ratio", "winner"))
    words = f"L₁ distance of p({symbol_of(result.observable[0])}) to the full system"
    if len(result.sweep.axes) == 2:
        with mpl.rc_context(dict(STYLE)):
            return _fields(*result.sweep.axes, L1, ratio, winner, words)
    (axis,) = result.sweep.axes
    curves = curves_over(axis, [named(t) for t in THEORIES], L1, error)
    title, x = result.scene.title, axis.label
    return study_figure([Panel(title, x, words, curves, logarithmic=axis.logarithmic)])


def _fields(x: Axis, y: Axis, L1: Array, ratio: Array, winner: Any, words: str) -> Figure:
    low = max(np.nanmin(L1, initial=0.1), SMALLEST)
    norm = LogNorm(low, max(np.nanmax(L1, initial=SMALLEST), 2.0 * low))
    distances: dict[str, Any] = {"norm": norm, "cmap": "viridis_r"}
    index = np.select([winner == name for name in (*THEORIES, UNDECIDED)], [0.0, 1.0, 2.0], np.nan)
    colours = (COLOURS[0], COLOURS[1], PALE)
    nearer: dict[str, Any] = {"vmin": -0.5, "vmax": 2.5, "cmap": ListedColormap(colours)}
    figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    titles, palettes = (
        (*map(named, THEORIES), "nearer to the full system"),
        (distances, distances, nearer),
    )
    for axes, title, field, palette in zip(panels, titles, (*L1, index), palettes, strict=True):
        heat(axes, x, y, field, **palette)
        axes.set_title(title)
        if np.nanmin(ratio, initial=np.inf) < CLEARANCE_RULE < np.nanmax(ratio, initial=-np.inf):
            axes.contour(
                x.values, y.values, ratio.T, levels=[CLEARANCE_RULE], colors=[INK],
                linestyles=[DASHES], linewidths=1.2,
            )  # fmt: skip
    panels[0].set_ylabel(y.label)
    shades = ScalarMappable(**distances)
    bar = figure.colorbar(shades, ax=list(panels[:2]), location="right", shrink=0.95, pad=0.02)
    bar.set_label(words)
    rule = Line2D([], [], color=INK, linestyle=DASHES, linewidth=1.2)
    handles: list[Any] = [*(Patch(color=colour) for colour in colours), rule]
    legend = [*map(named, THEORIES), "within the errors", f"clearance = {CLEARANCE_RULE:g} rms"]
    figure.legend(handles, legend, loc="outside lower center", ncols=4)
    return figure
