"""Words at points of a diagram: only where they cover neither a point nor other words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox

from fpk.density import Array

OFFSETS = (
    (0, 6, "center", "bottom"),
    (0, -6, "center", "top"),
    (6, 0, "left", "center"),
    (-6, 0, "right", "center"),
    (5, 5, "left", "bottom"),
    (-5, 5, "right", "bottom"),
    (5, -5, "left", "top"),
    (-5, -5, "right", "top"),
)
"""Places around a point that are tried in this order, in points."""
MARKER = 3.0
"""Half the side of a marker in points: what words must not cover."""
SAMPLES = 24
"""Points of a line between two markers that words must not cover either."""


@dataclass(frozen=True)
class Label:
    """Words for the point (x, y) of data; those first in a list are placed first."""

    words: str
    x: float
    y: float
    colour: str


def place(
    axes: Axes,
    labels: Sequence[Label],
    lines: Sequence[tuple[Array, Array]],
    *,
    size: float = 6.5,
) -> int:
    """Write those ``labels`` that find a free place on ``axes``; return how many did.

    ``lines`` are the curves drawn, which stay free, as do words already there. Limits and layout
    must be final.
    """
    figure = axes.figure
    canvas = FigureCanvasAgg(figure.get_figure(root=True))
    renderer: Any = canvas.get_renderer()  # type: ignore[no-untyped-call]
    scale = figure.dpi / 72.0
    taken = [_around(xy, scale) for x, y in lines for xy in axes.transData.transform(_along(x, y))]
    taken += [text.get_window_extent(renderer) for text in axes.texts]
    frame = axes.get_window_extent(renderer)
    placed = 0
    for label in labels:
        for dx, dy, ha, va in OFFSETS:
            text = axes.annotate(
                label.words, (label.x, label.y), xytext=(dx, dy), textcoords="offset points",
                ha=ha, va=va, fontsize=size, color=label.colour, annotation_clip=False,
            )  # fmt: skip
            box = text.get_window_extent(renderer).padded(scale)
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 + 8.0 * scale
            inside = inside and frame.y0 <= box.y0 and box.y1 <= frame.y1
            if inside and not any(box.overlaps(other) for other in taken):
                taken.append(box)
                placed += 1
                break
            text.remove()
    return placed


def decades(errors: Sequence[float], every: float) -> list[int]:
    """Return the indices of the ends, then of points a factor 10^``every`` apart, in that order."""
    if not errors:
        return []
    chosen = [len(errors) - 1, 0] if len(errors) > 1 else [0]
    logs = np.log10(np.maximum(np.asarray(errors, float), 1e-300))
    for k in range(1, len(errors) - 1):
        if all(abs(logs[k] - logs[j]) >= every for j in chosen):
            chosen.append(k)
    return chosen


def _around(xy: Array, scale: float) -> Bbox:
    half = 0.5 * MARKER * scale
    return Bbox([[xy[0] - half, xy[1] - half], [xy[0] + half, xy[1] + half]])


def _along(x: Array, y: Array) -> Array:
    """Points of a curve that is straight between its markers on logarithmic axes, (n, 2)."""
    u, v = np.log(x), np.log(y)
    at = np.arange(u.size)
    fine = np.linspace(0.0, max(u.size - 1, 0), max(u.size - 1, 0) * SAMPLES + 1)
    return np.exp(np.stack([np.interp(fine, at, u), np.interp(fine, at, v)], axis=1))
