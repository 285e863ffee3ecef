"""The work-precision diagram: error against time of every route, on one pair of axes."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from cases.pictures.style import INK, STYLE
from cases.study.cost import CostStudy
from cases.study.priced import Priced
from cases.study.sampled import FULL

COLOURS = {
    "FE p = 1": "#8c8c86",
    "FE p = 2": "#c08a1e",
    "FE p = 4": "#2a9d6f",
    "FE p = 8": "#2878b5",
    "FE hp": "#d1603d",
    "quadrature (11)": "#9a6fc0",
    "simulation of (24)": "#a8577e",
    "exact_flow, N": "#5b8def",
    "exact_flow, (dt, N)": "#1f4e9c",
    "baoab, (dt, N)": "#6aa84f",
    "euler_maruyama, (dt, N)": "#5a4632",
}
"""One colour a route, the same for one and two energies."""
MARKS = {"averaged equation (24)": ("o", "-"), "averaged equation (17)": ("s", (0, (4, 1.5)))}
DRAWN = 1e-3
"""Error down to which the law of sampling is drawn."""
LEAST_ERROR = 1e-15
HALO: Any = {"boxstyle": "square,pad=0.05", "fc": "white", "ec": "none", "alpha": 0.7}
"""Behind words that stand on lines."""


def cost_figure(study: CostStudy) -> Figure:
    """Draw the diagram; circles and squares are one and two energies, triangles the full system."""
    with mpl.rc_context(dict(STYLE)):
        figure = Figure(figsize=(9.2, 5.8), layout="constrained")
        axes = figure.subplots()
        for route in study.routes:
            _draw(axes, route)
        _floors(axes, study)
        for k, m in enumerate(study.models):
            axes.plot(m.distance, m.seconds, "*", color=INK, markersize=9, mfc="none", ls="")
            axes.annotate(
                f"{m.theory} theory for (6)",
                (m.distance, m.seconds),
                xytext=(7, -12 - 9 * k),
                textcoords="offset points",
                fontsize=6.5,
                bbox=HALO,
            )
        axes.set(xscale="log", yscale="log")
        axes.set_xlabel("$L_1$ error of the route's own equation (stars: averaging error)")
        axes.set_ylabel("wall time in seconds, one thread")
        axes.set_xlim(1.5, LEAST_ERROR)
        axes.set_ylim(0.4 * axes.get_ylim()[0], None)
        axes.xaxis.set_major_locator(LogLocator(numticks=20))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.grid(True, which="major", lw=0.3, color=INK, alpha=0.25)
        figure.legend(loc="outside right upper", fontsize=7.5, handlelength=2.6)
    return figure


def _draw(axes: Axes, route: Priced) -> None:
    points = [p for p in route.points if p.error >= (DRAWN if p.modelled else LEAST_ERROR)]
    if not points:
        return
    marker, line = MARKS.get(route.equation, ("^", (0, (1, 1)) if points[0].modelled else "-"))
    colour = COLOURS.get(route.route, INK)
    error = np.array([p.error for p in points])
    seconds = np.array([p.seconds for p in points])
    hollow = route.equation == "averaged equation (17)" or points[0].modelled
    axes.plot(
        error,
        seconds,
        color=colour,
        marker=marker,
        ls=line,
        lw=1.2,
        markersize=4,
        mfc="white" if hollow else colour,
        label=_label(route),
    )
    spread = np.array(
        [p.timing.spread if p.timing.spread == p.timing.spread else 0 for p in points]
    )
    axes.vlines(
        error, np.maximum(seconds - spread, 0.3 * seconds), seconds + spread, color=colour, lw=0.8
    )
    for k, p in enumerate(points):
        if k in _labelled(len(points)):
            axes.annotate(
                _setting(p.settings),
                (p.error, p.seconds),
                xytext=(2, 4),
                textcoords="offset points",
                fontsize=6.0,
                color=colour,
                bbox=HALO,
            )


def _labelled(count: int) -> set[int]:
    """The finest point and the one half-way up to it: more would overlap."""
    return {count - 1, (count - 1) // 2}


def _setting(words: str) -> str:
    """The setting in short: paths and time of a simulation leave only its step, or its paths."""
    parts = words.split(", ")
    return next((p for p in parts if p.startswith("dt ")), parts[0])


def _label(route: Priced) -> str:
    """The route and its equation, once."""
    words, equation = route.route.replace("_", " "), _short(route.equation)
    return words if equation in words else f"{words}, {equation}"


def _short(equation: str) -> str:
    return {FULL: "(6)"}.get(equation, equation.removeprefix("averaged equation "))


def _floors(axes: Axes, study: CostStudy) -> None:
    """The error of each reference: of the closed forms as a band, of a long simulation a line."""
    for equation, floor in study.floors.items():
        if equation == FULL:
            if study.full_reference == "long simulation":
                axes.axvline(floor, color=INK, lw=0.8, ls=(0, (1, 2)))
                axes.text(
                    floor, 0.01, " reference of (6)", fontsize=6.5, va="bottom", ha="left",
                    transform=axes.get_xaxis_transform(),
                )  # fmt: skip
            continue
        axes.axvspan(max(floor, LEAST_ERROR), LEAST_ERROR, color=INK, alpha=0.06, lw=0)
        top = 0.985 if equation in list(MARKS)[:1] else 0.8
        axes.text(
            max(floor, 3e-15), top, f"floor {_short(equation)} ", fontsize=6.5, va="top",
            ha="right", transform=axes.get_xaxis_transform(), rotation=90,
        )  # fmt: skip
