"""The picture of a convergence study: errors in h, in p and by tol, and in the step."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from cases.output.pictures.style import COLOURS, INK, STYLE
from cases.studies.converge import ConvergenceStudy, Studied
from cases.studies.ladders import Ladder
from cases.studies.names import BY_TOL_WORDS
from cases.studies.weak_fit import WeakOrder

HALO: Any = {"boxstyle": "square,pad=0.1", "fc": "#f4f4f4", "ec": "none", "alpha": 0.85}
"""Behind words that a curve may cross."""
MARKERS = "osD^v"
SYMBOLS = {"H": "H", "H1,H2": "H_1, H_2"}
SMALL = 7.0
SCHEMES = {
    "exact_flow": "own scheme (exact flow)",
    "baoab": "BAOAB",
    "euler_maruyama": "Euler–Maruyama",
}


def study_figure(study: ConvergenceStudy) -> Figure:
    """Draw L1 against unknowns for every equation, against the degree, and bias against the step.

    Dashed lines have the slope of theory, through the finest level.
    """
    in_degree = next((s for s in study.equations if s.theory == "nonintegrable"), None)
    panels = len(study.equations) + bool(study.schemes) + bool(in_degree)
    columns = 1 if panels < 2 else 2
    rows = max(1, -(-panels // columns))
    with mpl.rc_context({**STYLE, "font.size": 8.5, "axes.titlesize": 8.5}):
        figure = Figure(figsize=(4.3 * columns, 3.5 * rows), layout="constrained")
        drawn = list(figure.subplots(rows, columns, squeeze=False).ravel())
        for axes in drawn[panels:]:
            axes.remove()
        rest = iter(drawn)
        for studied in study.equations:
            _draw_ladders(next(rest), studied)
        if in_degree is not None:
            _draw_degrees(next(rest), in_degree, study.without_contact)
        if study.schemes:
            _draw_schemes(next(rest), study.schemes)
    return figure


def _draw_ladders(axes: Axes, studied: Studied) -> None:
    for ladder, colour, marker in zip(studied.ladders, COLOURS, MARKERS, strict=False):
        N = np.array([level.unknowns for level in ladder.levels], dtype=float)
        e = np.array([level.errors["L1"] for level in ladder.levels])
        words = _label(ladder)
        axes.plot(N, e, color=colour, marker=marker, markersize=3.6, lw=1.2, label=words)
        if ladder.degree:
            slope = N[-3:] / N[-1]
            theory = 0.5 * e[-1] * slope ** (-(ladder.degree + 1.0) / ladder.dimension)
            axes.plot(N[-3:], theory, color=colour, lw=0.8, ls=(0, (4, 2)))
    axes.set(xscale="log", yscale="log", xlabel="unknowns $N$")
    axes.set_title(f"{studied.equation}; dashed: order of theory")
    _error_axis(axes, studied)
    _legend(axes)


def _draw_degrees(axes: Axes, studied: Studied, without: Ladder | None) -> None:
    """Log-lin: exponential convergence is a straight line."""
    own = next(ladder for ladder in studied.ladders if ladder.family == "p")
    pairs = [("with contact" if without else "no contact", own)]
    pairs += [("contacts taken away", without)] if without else []
    for (words, ladder), colour, marker in zip(pairs, COLOURS, MARKERS, strict=False):
        p = [float(level.label.removeprefix("p = ")) for level in ladder.levels]
        e = [level.errors["L1"] for level in ladder.levels]
        rate = ladder.verdicts["L1"].order
        label = f"{words}: $e^{{-{rate:.1f} p}}$"
        axes.plot(p, e, color=colour, marker=marker, markersize=3.6, lw=1.2, label=label)
    axes.set(yscale="log", xlabel="degree $p$ on a fixed mesh")
    axes.set_title(f"{studied.equation}: exponential in $p$")
    _error_axis(axes, studied)
    _legend(axes)


def _error_axis(axes: Axes, studied: Studied) -> None:
    floor = studied.reference_error + 1e-15
    axes.axhspan(1e-16, floor, color=INK, alpha=0.08, lw=0)
    axes.annotate(
        "floor: error of the reference", (0.985, floor), xycoords=axes.get_yaxis_transform(),
        xytext=(0, -2), textcoords="offset points", ha="right", va="top", fontsize=6.5,
        bbox=HALO,
    )  # fmt: skip
    axes.set_ylabel(f"$L_1$ error of $p({SYMBOLS[studied.observable]})$")
    axes.set_ylim(1e-16, 10.0)


def _label(ladder: Ladder) -> str:
    order = ladder.verdicts["L1"].order
    if ladder.degree:
        return f"degree {ladder.degree}, finer: order {order:.2f}"
    return "higher degree, same mesh" if ladder.family == "p" else BY_TOL_WORDS[ladder.dimension]


def _draw_schemes(axes: Axes, schemes: tuple[WeakOrder, ...]) -> None:
    for s, colour, marker in zip(schemes, COLOURS, MARKERS, strict=False):
        name = SCHEMES.get(s.scheme, s.scheme)
        if not s.levels:
            axes.plot([], [], ls="", label=f"{name}: no usable step")
            continue
        dt = np.array([level.dt for level in s.levels])
        e, bar = np.array(s.errors), np.array(s.error_bars)
        low, high = s.order_error
        found = f"order {s.order:.1f} ± {0.5 * (high - low):.1f}"
        told = s.verdict if s.beyond or s.verdict == "not resolved" else found
        axes.errorbar(
            dt, e, [np.minimum(bar, 0.9 * e), bar], color=colour, marker=marker, markersize=3.6,
            ls="", capsize=2, lw=1.0,
        )  # fmt: skip
        fit = np.geomspace(dt.min(), dt.max(), 30)
        label = f"{name}: {told} (theory {s.theory})"
        style = "-" if s.verdict == "as theory" else ":"
        bias = abs(s.slope) * fit**s.theory
        axes.plot(fit, bias, color=colour, lw=1.0, ls=style, label=label)
    axes.set(xscale="log", yscale="log", xlabel="step $dt$, in the scene's unit of time")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(f"step error of ${_square(schemes[0].observable)}$, one s.e.")
    axes.set_title("full system (6), simulation; lines: theory, dotted if not seen")
    _legend(axes, 1)


def _legend(axes: Axes, columns: int = 2) -> None:
    """Below the panel: no curve passes there."""
    place = (-0.02, -0.19)
    axes.legend(
        loc="upper left", bbox_to_anchor=place, ncols=columns, fontsize=SMALL, columnspacing=1.2,
        handlelength=1.8, borderaxespad=0.0,
    )  # fmt: skip


def _square(name: str) -> str:
    return f"E\\,q_{{{name.removeprefix('E q').removesuffix('²')}}}^2"
