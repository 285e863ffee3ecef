"""A convergence study as tables and panels of a picture."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cases.studies.converge import ConvergenceStudy
from cases.studies.ladders import Ladder
from cases.studies.levels import Equation
from cases.studies.orders import LIMITS
from cases.studies.page import Page, Table
from cases.studies.picture import Curve, Panel, study_figure
from cases.studies.weak import ORDERS, WeakOrder
from fpk.observable import observable_name

GCI_WORDS = (
    "GCI: safety factor 1.25 where the observed order is within 10 % of theory, else 3. " + LIMITS
)
ORDER_WORDS = (
    "In h: powers of h. In p: nats a degree. By tol: nats a unit of √unknowns. Levels within ten"
    " times the floor (error of the reference, end of the mesh) give no order.",
    "In p: where the nats do not fall with the degree the error falls exponentially. The contact"
    " energies are nodes of the mesh, but above them the coefficients have half-integer powers of"
    " H - H_c: with contact a slower rate can take over at high degree, which hp elements, graded"
    " there, do without.",
)
TWO_ENERGIES = (
    "Mean energy of (17): with constant damping the drift is linear in the energies, which are test"
    " functions themselves, so that elements of any degree have E H right, and only the end of the"
    " mesh is seen: at the floor.",
    "Largest error of degree 1 of (17): it stands at H1 = H2 = 0, where b vanishes as the radial"
    " part of a Laplacian in the plane does, and theory there is h² |ln h|: observed orders near 2"
    " only as 1/|ln h|, which no affordable mesh ends (Eriksson and Thomée, Math. Comp. 42, 1984,"
    " 345).",
)
"""Why two of the orders of (17) differ, and may differ, from the column of theory."""
STEP_WORDS = (
    "Order: that of the best fit to all steps, from and to one standard error;"
    f" {ORDERS[0]:g} or {ORDERS[-1]:g} there: none is known. Unstable: no step is stable and cheap"
    " enough. Chi² with the order of theory. Limit: the closed form where there is one, else the"
    " intercept of the regression; where a fit fails (pre-asymptotic) the step errors rest on that."
    " Short: by how much the standard errors are larger than wanted, in the time given."
)
LIMITS_OF_AXIS = (1e-16, 10.0)
"""Ends of the axis of L1 errors: round-off of one, and more than the largest distance, 2."""


def convergence_page(study: ConvergenceStudy) -> Page:
    """Return what ``fpk converge`` shows and writes."""
    return Page(
        "converge",
        study.scene,
        f"Convergence: {study.scene.title}",
        study_tables(study),
        lambda: study_figure(study_panels(study)),
    )


def study_tables(study: ConvergenceStudy) -> list[Table]:
    """Return errors and orders of every ladder, the functionals, the steps and the samples."""
    ladders = [
        ({"equation": name, "family": ladder.name}, ladder) for name, ladder in study.ladders
    ]
    errors = [
        {**of, "level": v.settings, "unknowns": v.unknowns, **v.errors, "estimate": v.estimate}
        for of, ladder in ladders
        for v in ladder.levels
    ]
    orders = [
        {**of, "error": key, **asdict(verdict)}
        for of, ladder in ladders
        for key, verdict in ladder.verdicts.items()
    ]
    index = [
        {**of, "functional": key, "true error": ladder.levels[-1].errors[key], **asdict(grid)}
        for of, ladder in ladders
        for key, grid in ladder.grid.items()
    ]
    steps = [
        {
            "scheme": s.scheme,
            "dt": v.dt,
            "mean": v.value,
            "standard error": v.error,
            "step error": error,
            "its standard error": bar,
            "paths x time": v.sampled,
        }
        for s in study.schemes
        for v, error, bar in zip(s.levels, s.errors, s.error_bars, strict=True)
    ]
    weak = [
        {
            "scheme": s.scheme,
            "theory": s.theory,
            "order": s.order,
            "from, to": s.order_error,
            "verdict": s.verdict,
            "consecutive ratios": tuple(f"{o:.2f} ± {e:.2f}" for o, e in s.orders),
            "chi²": s.chi2,
            "freedom": s.freedom,
            "limit": s.limit,
            "its standard error": s.limit_error,
            "wanted": s.wanted,
            "short": s.short,
        }
        for s in study.schemes
    ]
    about = [
        f"{e.name}: p({observable_name(e.observable)}) against {e.reference_words}, itself within"
        f" {e.reference.l1_error:.1e} in L1. By tolerance: {e.words}"
        for e, _ in study.equations
    ]
    plane = any(e.dimension == 2 for e, _ in study.equations)
    samples: list[dict[str, Any]] = []
    slope = ""
    if s := study.samples:
        columns = zip(s.sampled, s.errors, strict=True)
        samples = [{"paths x time": t, f"standard error of {s.observable}": e} for t, e in columns]
        slope = f"slope {s.slope:.3f} ± {s.slope_error:.3f}, theory -0.5"
    refusals = [{"route": route, "reason": why} for route, why in study.refusals.items()]
    index_title = "Richardson and grid convergence index (GCI)"
    words = (*ORDER_WORDS, *(TWO_ENERGIES if plane else ()))
    return [
        Table("errors", "Averaged equations: errors", errors, tuple(about)),
        Table("orders", "Averaged equations: observed orders", orders, words),
        Table("index", f"Averaged equations: {index_title}", index, (GCI_WORDS,)),
        Table("steps", "Simulation: errors of the step", steps),
        Table("weak", "Simulation: weak order in the step", weak, (STEP_WORDS,)),
        Table("samples", "Simulation: standard error in samples", samples, (slope,)),
        Table("refusals", "Routes that do not apply", refusals),
    ]


def study_panels(study: ConvergenceStudy) -> list[Panel]:
    """Return L1 against unknowns of every equation, against the degree, and bias against the step.

    Dashed lines have the slope of theory, below the finest levels.
    """
    panels = [_ladder_panel(*own) for own in study.equations]
    for equation, ladders in study.equations:
        if equation.dimension == 1:
            (own,) = (ladder for ladder in ladders if ladder.first.family == "p")
            pair = {"no contact": own}
            if study.without_contact:
                pair = {"with contact": own, "contacts taken away": study.without_contact}
            panels.append(_degree_panel(equation, pair))
    return [*panels, _step_panel(study.schemes)] if study.schemes else panels


def _ladder_panel(equation: Equation, ladders: Sequence[Ladder]) -> Panel:
    curves = []
    for ladder in ladders:
        N = np.array([level.unknowns for level in ladder.levels], dtype=float)
        e = np.array([level.error for level in ladder.levels])
        label, dashed = ladder.name, None
        if ladder.degree:
            label = f"{ladder.name}: order {ladder.verdicts['L1'].order:.2f}"
            power = (ladder.degree + 1.0) / equation.dimension
            dashed = N[-3:], 0.5 * e[-1] * (N[-3:] / N[-1]) ** -power
        curves.append(Curve(label, N, e, dashed=dashed))
    return _error_panel(equation, "dashed: order of theory", "unknowns $N$", curves)


def _degree_panel(equation: Equation, ladders: dict[str, Ladder]) -> Panel:
    """Log-lin: exponential convergence is a straight line."""
    curves = [
        Curve(
            f"{words}: $e^{{-{ladder.verdicts['L1'].order:.1f} p}}$",
            [-np.log(v.size) for v in ladder.levels],
            [v.error for v in ladder.levels],
        )
        for words, ladder in ladders.items()
    ]
    x = "degree $p$ on a fixed mesh"
    return _error_panel(equation, "exponential in $p$", x, curves, logarithmic=False)


def _error_panel(
    equation: Equation, words: str, x: str, curves: list[Curve], *, logarithmic: bool = True
) -> Panel:
    y = f"$L_1$ error of p({observable_name(equation.observable)})"
    floor, title = equation.reference.l1_error + 1e-15, f"{equation.name}; {words}"
    return Panel(title, x, y, curves, floor, logarithmic=logarithmic, limits=LIMITS_OF_AXIS)


def _step_panel(schemes: Sequence[WeakOrder]) -> Panel:
    curves = []
    for s in schemes:
        dt, line = np.array([level.dt for level in s.levels]), None
        words = f"{s.verdict} (theory {s.theory})"
        if s.verdict in ("as theory", "pre-asymptotic") and not s.beyond:
            words = f"order {s.order:.1f} ± {np.ptp(s.order_error) / 2:.1f} (theory {s.theory})"
        if dt.size:
            line = dt, abs(s.slope) * dt**s.theory
        label, bar = f"{s.scheme}: {words}", np.array(s.error_bars)
        curves.append(Curve(label, dt, s.errors, bar, dashed=line, style="none"))
    y = f"step error of {schemes[0].observable}"
    x = "step $dt$, in the scene's unit of time"
    return Panel("full system (6), simulation; lines: theory", x, y, curves)
