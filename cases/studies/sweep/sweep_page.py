"""A sweep as a page: its table, and curves over one axis or heat pictures over two."""

from functools import partial
from math import ceil
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from cases.output.pictures.style import STYLE
from cases.output.words import named
from cases.scene.scene import Scene
from cases.scene.units import bracketed
from cases.studies.page import Page, Table
from cases.studies.picture import Panel, curves_over, heat, study_figure
from cases.studies.sweep.result import Sweep

DECADES = 100.0
"""Ratio of the largest to the smallest value from which an axis is logarithmic."""
COLUMN, ROW = 3.4, 3.0
"""Width and height of a heat picture in inches."""


def sweep_page(result: Sweep, scene: Scene) -> Page:
    """Return what ``fpk sweep`` shows and writes: every value, as a table and as a picture."""
    heads = [a.key + bracketed(a.unit) for a in result.axes]
    labels = dict(zip(result.quantities, result.labels(), strict=True))
    rows = [
        {
            **dict(zip(heads, p.values, strict=True)),
            "quantity": labels[a.quantity],
            "method": a.method,
            "value": a.value,
            "error": a.error,
            "kind": a.error_kind,
            "certified": ("no", "yes")[a.certified] if a.value is not None else "",
        }
        for p in result.points
        for a in p.answers
    ]
    reasons = dict.fromkeys(
        f"{a.quantity} by {a.method}: {a.reason}"
        for p in result.points
        for a in p.answers
        if a.reason
    )
    summary = (
        f"{', '.join(result.quantities)} by {'; '.join(map(named, result.methods))}:"
        f" {len(result.points)} points ({result.reused} from disk)"
    )
    title = "error: an estimate of the numerical error, or one standard error of sampling"
    return Page(
        "result",
        scene,
        f"Sweep of {', '.join(a.key for a in result.axes)}: {scene.title}",
        [Table("points", title, rows, (summary, *reasons))],
        partial(sweep_figure, result),
        summary=summary,
        gridded=result.variables(),
    )


def sweep_figure(result: Sweep) -> Figure:
    """Draw a panel for each quantity, over two axes one for each of its methods."""
    values, errors = result.field("value"), result.field("error")
    if len(result.axes) == 2:
        with mpl.rc_context({**STYLE, "font.size": 8.5, "axes.titlesize": 8.5}):
            return _heats(result, values)
    (axis,), names = result.axes, list(map(named, result.methods))
    panels = [
        Panel(
            quantity.partition(" [")[0],
            axis.label,
            quantity,
            curves_over(axis, names, own, bars),
            logarithmic=axis.logarithmic,
            y_logarithmic=_spans_decades(own),
        )
        for quantity, own, bars in zip(result.labels(), values, errors, strict=True)
    ]
    return study_figure(panels)


def _heats(result: Sweep, values: Any) -> Figure:
    shown = [(i, j) for i, j in np.ndindex(values.shape[:2]) if np.isfinite(values[i, j]).any()]
    (x, y), columns = result.axes, min(max(len(shown), 1), 3)
    rows = max(ceil(len(shown) / columns), 1)
    figure = Figure(figsize=(COLUMN * columns, ROW * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[len(shown) :]:
        axes.remove()
    for axes, (i, j) in zip(grid, shown, strict=False):
        norm = "log" if _spans_decades(values[i, j]) else "linear"
        cells = heat(axes, x, y, values[i, j], cmap="viridis", norm=norm)
        axes.set(title=f"{result.labels()[i]} by {named(result.methods[j])}", ylabel=y.label)
        figure.colorbar(cells, ax=axes)
    return figure


def _spans_decades(values: Any) -> bool:
    given = values[np.isfinite(values)]
    return bool(given.size and given.min() > 0.0 and given.max() > DECADES * given.min())
