"""The work-precision diagram: error against time of every route, a panel for each equation."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator

from cases.output.pictures.style import INK, STYLE
from cases.studies.cost import CostStudy
from cases.studies.labels import Label, decades, place
from cases.studies.names import BY_TOL, BY_TOL_WORDS, QUADRATURE, QUADRATURE_WORDS, elements
from cases.studies.priced import Point, Priced
from cases.studies.sampling_law import FULL
from fpk.density import Array

ROUTES = {
    elements(1): ("#8c8c86", "o", "elements of degree 1, finer meshes"),
    elements(2): ("#c08a1e", "s", "elements of degree 2"),
    elements(4): ("#2a9d6f", "^", "elements of degree 4"),
    elements(8): ("#2878b5", "D", "elements of degree 8"),
    BY_TOL[1]: ("#d1603d", "v", BY_TOL_WORDS[1]),
    BY_TOL[2]: ("#8c1d18", "h", BY_TOL_WORDS[2]),
    QUADRATURE: ("#9a6fc0", "P", QUADRATURE_WORDS),
    "simulation of (24)": ("#a8577e", "X", "simulation of (24), more paths"),
    "exact_flow, N": ("#5b8def", "o", "own scheme, chosen step, more samples"),
    "exact_flow, (dt, N)": ("#1f4e9c", "o", "own scheme, best step and samples"),
    "baoab, (dt, N)": ("#6aa84f", "^", "BAOAB, best step and samples"),
    "euler_maruyama, (dt, N)": ("#5a4632", "s", "Euler–Maruyama, best step and samples"),
}
"""Colour, marker and words of a route: the same for one and two energies."""
PANELS = {
    "averaged equation (24)": ("averaged equation (24)", "$p(H)$"),
    "averaged equation (17)": ("averaged equation (17)", "$p(H_1, H_2)$"),
}
THEORIES = {"nonintegrable": "Eq. (11)", "integrable": "Eq. (34)"}
HALO: Any = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.85}
"""Behind words that a curve may cross."""
DRAWN = 1e-4
"""Error down to which the law of sampling is drawn, and time up to which: an hour."""
LONGEST = 3600.0
LEAST_ERROR = 2e-16
"""Round-off of one: where the axis of numerical errors ends."""
ROUND_OFF = 2e-15
"""Floor that is drawn at least: a few rounding errors."""
EVERY = 3.0
"""Decades of error between the points of a route that are labelled, its ends apart."""
SIZE = 7.5
UPRIGHT = 5
"""Points of a dashed vertical that labels keep clear of: ``place`` takes 24 between two of them."""


def cost_figure(study: CostStudy) -> Figure:
    """Draw numerical errors of the averaged equations, and sampling errors of the full system.

    All panels share the axis of time. Open markers and dotted lines are prices by the law of
    sampling; dashed verticals are the averaging error, which no solver lowers.
    """
    equations = list(dict.fromkeys(route.equation for route in study.routes))
    widths = [1.0 if name == FULL else 1.45 for name in equations] or [1.0]
    with mpl.rc_context({**STYLE, "font.size": 8.5, "axes.titlesize": 8.5}):
        figure = Figure(figsize=(1.0 + 2.1 * sum(widths), 5.0), layout="constrained")
        drawn = figure.subplots(1, len(widths), sharey=True, squeeze=False, width_ratios=widths)[0]
        for axes, name in zip(drawn, equations, strict=False):
            _panel(axes, [r for r in study.routes if r.equation == name], name, study)
        drawn[0].set_ylabel("processor time in seconds, one thread")
        low, high = drawn[0].get_ylim()
        drawn[0].set_ylim(0.5 * low, 2.0 * high)
        _legend(figure, study)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        for axes, name in zip(drawn, equations, strict=False):
            own = [r for r in study.routes if r.equation == name]
            drawn_lines = [_curve(_shown(r)) for r in own if _shown(r)]
            if name == FULL:
                low, high = axes.get_ylim()
                drawn_lines += [
                    (np.full(UPRIGHT, m.distance), np.geomspace(low, high, UPRIGHT))
                    for m in study.models
                ]
            place(axes, _labels(own), drawn_lines)
    return figure


def _panel(axes: Axes, routes: Sequence[Priced], equation: str, study: CostStudy) -> None:
    axes.set(xscale="log", yscale="log")
    for route in routes:
        points = _shown(route)
        if not points:
            continue
        colour, marker, _ = ROUTES.get(route.route, (INK, "o", ""))
        error, seconds = _curve(points)
        modelled = points[0].modelled
        axes.plot(
            error, seconds, color=colour, marker=marker, ls=":" if modelled else "-", lw=1.2,
            markersize=3.8, mfc="white" if modelled else colour,
        )  # fmt: skip
        spread = np.nan_to_num(np.array([p.timing.spread for p in points]))
        axes.vlines(
            error, np.maximum(seconds - spread, 0.3 * seconds), seconds + spread,
            color=colour, lw=0.8,
        )  # fmt: skip
    floor = study.floors.get(equation, 0.0)
    if equation == FULL:
        _full(axes, study, floor)
    else:
        title, density = PANELS.get(equation, (equation, "p"))
        axes.set_title(title)
        axes.set_xlabel(f"numerical error of {density} in $L_1$")
        axes.set_xlim(2.0, LEAST_ERROR)
        axes.axvspan(max(floor, ROUND_OFF), LEAST_ERROR, color=INK, alpha=0.1, lw=0)
        _vertical_words(axes, max(floor, ROUND_OFF), "floor: error of the reference")
    axes.xaxis.set_major_locator(LogLocator(numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(True, which="major", lw=0.3, color=INK, alpha=0.25)


def _full(axes: Axes, study: CostStudy, floor: float) -> None:
    """What is particular to the full system: the averaging errors and the reference's own."""
    axes.set_title(FULL)
    name = study.models[0].observable if study.models else "q_i"
    symbol = f"${name[0]}_{{{name[1:]}}}$" if study.models else "$q_i$"
    axes.set_xlabel(f"error of $p$({symbol}) in $L_1$")
    worst = max((m.distance for m in study.models), default=0.0)
    axes.set_xlim(max(0.4, 3.0 * worst), 0.5 * DRAWN)
    for m in study.models:
        axes.axvline(m.distance, color=INK, lw=0.9, ls=(0, (4, 2)))
        axes.plot(m.distance, m.seconds, "*", color=INK, markersize=8, mfc="white")
        theory = THEORIES.get(m.theory, m.theory)
        _vertical_words(axes, m.distance, f"averaging error of {theory}")
    if study.full_reference == "long simulation":
        axes.axvspan(floor, 0.5 * DRAWN, color=INK, alpha=0.1, lw=0)
        _vertical_words(axes, floor, "error of the reference")


def _vertical_words(axes: Axes, x: float, words: str) -> None:
    axes.annotate(
        words, (x, 0.985), xycoords=axes.get_xaxis_transform(), xytext=(-2, 0),
        textcoords="offset points", rotation=90, ha="right", va="top", fontsize=6.5,
        bbox=HALO,
    )  # fmt: skip


def _shown(route: Priced) -> list[Point]:
    def inside(p: Point) -> bool:
        return p.error >= 0.99 * DRAWN and p.seconds <= LONGEST if p.modelled else p.error > 0.0

    return [p for p in route.points if inside(p)]


def _curve(points: Sequence[Point]) -> tuple[Array, Array]:
    return np.array([p.error for p in points]), np.array([p.seconds for p in points])


def _labels(routes: Sequence[Priced]) -> list[Label]:
    """The finest point of every route first, then its coarsest, then those between."""
    by_rank: dict[int, list[Label]] = {}
    for route in routes:
        points = _shown(route)
        colour = ROUTES.get(route.route, (INK, "", ""))[0]
        for rank, k in enumerate(decades([p.error for p in points], EVERY)):
            p = points[k]
            label = Label(short_setting(p.settings), p.error, p.seconds, colour)
            by_rank.setdefault(rank, []).append(label)
    return [label for rank in sorted(by_rank) for label in by_rank[rank]]


def short_setting(words: str) -> str:
    """Return a setting in short: of a simulation its step, or its paths; 10^−k of a tolerance."""
    parts = words.split(", ")
    short = next((p for p in parts if p.startswith("dt ")), parts[0])
    if "e-" in short and short.startswith("1e-"):
        return f"$10^{{-{int(short[3:])}}}$"
    return short


def _legend(figure: Figure, study: CostStudy) -> None:
    there = {route.route: _shown(route) for route in study.routes}
    handles = [
        Line2D(
            [], [], color=colour, marker=marker, markersize=3.8, lw=1.2,
            ls=":" if there[name][0].modelled else "-",
            mfc="white" if there[name][0].modelled else colour, label=words,
        )
        for name, (colour, marker, words) in ROUTES.items()
        if there.get(name)
    ]  # fmt: skip
    figure.legend(
        handles=handles, loc="outside lower center", fontsize=SIZE, handlelength=2.4, ncols=3,
        title="Words at points: elements (of an axis: n²), tolerance, paths or step. Open markers:"
        " by the law of sampling, not run.",
        title_fontsize=SIZE,
    )  # fmt: skip
