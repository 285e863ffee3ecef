"""A convergence study as tables, panels of a picture, and rows."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cases.studies.converge import ConvergenceStudy
from cases.studies.ladders import COLUMNS, Ladder, observed_rates
from cases.studies.levels import Equation
from cases.studies.picture import Curve, Panel, study_figure
from cases.studies.tables import Page, Table, rows_dataset
from cases.studies.weak import SampleSlope, WeakOrder
from fpk.observable import observable_name
from fpk.orders import LIMITS

GCI_WORDS = (
    "GCI: safety factor 1.25 where the observed order is within 10 % of theory, else 3. " + LIMITS
)
ORDER_WORDS = (
    "In h: powers of h. In p: nats a degree. By tol: nats a unit of √unknowns. Levels within ten"
    " times the floor (error of the reference, end of the mesh) give no order."
)
TWO_ENERGIES = (
    "Mean energy: with constant damping the drift is linear in the energies, which are test"
    " functions themselves, so that elements of any degree have E H right, and only the end of the"
    " mesh is seen: at the floor.",
    "Largest error of degree 1: it stands at H1 = H2 = 0, where b vanishes as the radial part of a"
    " Laplacian in the plane does, and theory there is h² |ln h|: observed orders near 2 only as"
    " 1/|ln h|, which no affordable mesh ends (Eriksson and Thomée, Math. Comp. 42, 1984, 345).",
)
"""Why two of the orders of (17) differ, and may differ, from the column of theory."""
DEGREE_WORDS = (
    "Nats: -ln of the ratio of neighbouring errors. Where they do not fall with the degree the"
    " error falls exponentially; a dash stands at the floor. The contact energies are nodes of the"
    " mesh, but above them the coefficients have half-integer powers of H - H_c: with contact a"
    " slower rate can take over at high degree, which hp elements, graded there, do without."
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
        lambda: rows_dataset(level=_level_rows(study), step=_step_rows(study)),
        lambda: study_figure(study_panels(study)),
    )


def study_tables(study: ConvergenceStudy) -> list[Table]:
    """Return errors and orders of every ladder, the functionals, the steps and the samples."""
    tables = []
    for equation, ladders in study.equations:
        tables += _equation_tables(equation, ladders)
        if equation.dimension == 1:
            tables.append(_in_degree(equation, _with_and_without(ladders, study.without_contact)))
    if study.schemes:
        tables.append(_steps(study.schemes))
    if study.samples:
        tables.append(_samples(study.samples))
    if study.refusals:
        rows = tuple(study.refusals.items())
        tables.append(Table("Routes that do not apply", ("route", "reason"), rows))
    return tables


def _equation_tables(equation: Equation, ladders: Sequence[Ladder]) -> list[Table]:
    errors = [
        (ladder.name, v.settings, v.unknowns, *(v.errors[key] for key in COLUMNS), v.estimate)
        for ladder in ladders
        for v in ladder.levels
    ]
    orders = [
        (
            ladder.name,
            key,
            " ".join(f"{o:.2f}" for o in v.orders),
            f"{v.order:.2f} ± {v.spread:.2f}" if v.order == v.order else None,
            None if v.theory is None else f"{v.theory:g}",
            v.kind,
        )
        for ladder in ladders
        for key, v in ladder.verdicts.items()
    ]
    index = [
        (
            ladder.name,
            key,
            f"{g.value:.10g}",
            f"{g.observed:.2f}" if g.observed == g.observed else None,
            f"{g.used:.2f}",
            f"{g.safety:g}",
            g.index,
            ladder.levels[-1].errors[key],
            g.kind,
        )
        for ladder in ladders
        for key, g in ladder.grid.items()
    ]
    name, reference = equation.name, equation.reference
    return [
        Table(
            f"{name}, p({observable_name(equation.observable)}): errors",
            ("family", "level", "unknowns", *COLUMNS, "its L1 estimate"),
            errors,
            (
                f"Against: {equation.reference_words}, itself within {reference.l1_error:.1e} in"
                " L1.",
                f"{ladders[-1].name}: {equation.by_tolerance[0].words}",
            ),
        ),
        Table(
            f"{name}: observed orders",
            ("family", "error", "consecutive levels", "last three", "theory", "verdict"),
            orders,
            (ORDER_WORDS, *(TWO_ENERGIES if equation.dimension == 2 else ())),
        ),
        Table(
            f"{name}: Richardson and grid convergence index (GCI)",
            ("family", "functional", "Richardson", "observed", "used", "factor", "GCI",
             "true error", "verdict"),
            index,
            (GCI_WORDS,),
        ),
    ]  # fmt: skip


def _with_and_without(ladders: Sequence[Ladder], without: Ladder | None) -> dict[str, Ladder]:
    """The ladder in p of the system as it is, and of that without contacts where it has any."""
    own = next(ladder for ladder in ladders if ladder.first.family == "p")
    if without is None:
        return {"no contact": own}
    return {"with contact": own, "contacts taken away": without}


def _in_degree(equation: Equation, ladders: dict[str, Ladder]) -> Table:
    """Errors by degree on a fixed mesh, with contact and without: nats of error a degree."""
    rows = [
        (words, level.settings, level.unknowns, level.error, rate)
        for words, ladder in ladders.items()
        for level, rate in zip(ladder.levels, observed_rates(ladder), strict=True)
    ]
    head = ("system", "degree", "unknowns", "L1", "nats a degree")
    return Table(f"{equation.name}: exponential convergence in p", head, rows, (DEGREE_WORDS,))


def _steps(schemes: Sequence[WeakOrder]) -> Table:
    rows = [
        (s.scheme, f"{v.dt:.4g}", f"{v.value:.6f}", v.error, error, bar, v.sampled)
        for s in schemes
        for v, error, bar in zip(s.levels, s.errors, s.error_bars, strict=True)
    ]
    head = ("scheme", "dt", schemes[0].observable, "one s.e.", "step error", "its s.e.")
    remarks = tuple(_order_words(s) for s in schemes)
    return Table("Simulation: weak order in the step", (*head, "paths x time"), rows, remarks)


def _order_words(s: WeakOrder) -> str:
    if s.verdict == "unstable":
        return f"{s.scheme}: no step is stable and cheap enough to study."
    low, high = s.order_error
    base = "closed form" if s.known else "intercept of the regression"
    ratios = ", ".join(f"{o:.2f} ± {e:.2f}" for o, e in s.orders) or "none resolved"
    order = (
        f"no weak order: the best fit is at the end of those tried, {low:.2f} to {high:.2f}"
        if s.beyond
        else f"weak order {s.order:.2f} ({low:.2f} to {high:.2f}, one s.e.)"
    )
    words = (
        f"{s.scheme}: {order}, theory"
        f" {s.theory}: {s.verdict}; consecutive ratios: {ratios}; chi² {s.chi2:.1f} of {s.freedom}"
        f" with the order of theory; limit {s.limit:.6f} ± {s.limit_error:.1e} ({base}); standard"
        f" error wanted {s.wanted:.1e}"
    )
    if s.verdict == "pre-asymptotic" and not s.known:
        words += "; the errors above are from that intercept, which rests on a fit that fails"
    short = f", short of it by a factor {s.short:.1f} in the time given."
    return words + (short if s.short > 1.05 else ".")


def _samples(slope: SampleSlope) -> Table:
    words = f"slope {slope.slope:.3f} ± {slope.slope_error:.3f}, theory -0.5"
    return Table(
        f"Simulation: standard error of {slope.observable} in samples",
        ("paths x time", "one s.e."),
        [(f"{n:.2e}", e) for n, e in zip(slope.sampled, slope.errors, strict=True)],
        (words,),
    )


def study_panels(study: ConvergenceStudy) -> list[Panel]:
    """Return L1 against unknowns of every equation, against the degree, and bias against the step.

    Dashed lines have the slope of theory, below the finest levels.
    """
    panels = [_ladder_panel(*own) for own in study.equations]
    panels += [
        _degree_panel(equation, _with_and_without(ladders, study.without_contact))
        for equation, ladders in study.equations
        if equation.dimension == 1
    ]
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
        curves.append(Curve(ladder.name, N, e, label, dashed=dashed))
    return _error_panel(equation, "dashed: order of theory", "unknowns $N$", curves)


def _degree_panel(equation: Equation, ladders: dict[str, Ladder]) -> Panel:
    """Log-lin: exponential convergence is a straight line."""
    curves = []
    for words, ladder in ladders.items():
        label = f"{words}: $e^{{-{ladder.verdicts['L1'].order:.1f} p}}$"
        p, e = [-np.log(v.size) for v in ladder.levels], [v.error for v in ladder.levels]
        curves.append(Curve(words, p, e, label))
    x = "degree $p$ on a fixed mesh"
    return _error_panel(equation, "exponential in $p$", x, curves, logarithmic=False)


def _error_panel(equation: Equation, words: str, x: str, curves: list[Curve], **how: Any) -> Panel:
    return Panel(
        f"{equation.name}; {words}",
        x,
        f"$L_1$ error of p({observable_name(equation.observable)})",
        curves,
        floor=equation.reference.l1_error + 1e-15,
        limits=LIMITS_OF_AXIS,
        **how,
    )


def _step_panel(schemes: Sequence[WeakOrder]) -> Panel:
    curves = []
    for s in schemes:
        label, dashed = f"{s.scheme}: no usable step", None
        dt = [level.dt for level in s.levels]
        if dt:
            low, high = s.order_error
            order = f"order {s.order:.1f} ± {0.5 * (high - low):.1f}"
            words = s.verdict if s.beyond or s.verdict == "not resolved" else order
            label = f"{s.scheme}: {words} (theory {s.theory})"
            steps = np.geomspace(dt[0], dt[-1], 30)
            dashed = steps, abs(s.slope) * steps**s.theory
        curves.append(
            Curve(s.scheme, dt, s.errors, label, s.error_bars, dashed=dashed, joined=False)
        )
    title = "full system (6), simulation; lines: theory"
    y = f"step error of {schemes[0].observable}"
    return Panel(title, "step $dt$, in the scene's unit of time", y, curves)


def _level_rows(study: ConvergenceStudy) -> list[dict[str, Any]]:
    return [
        {
            "equation": equation.name,
            "family": ladder.name,
            "level_name": level.settings,
            "unknowns": level.unknowns,
            **{f"error_{key.replace(' ', '_').replace('²', '2')}": e
               for key, e in level.errors.items()},
            "estimate_L1": level.estimate,
        }
        for equation, ladders in study.equations
        for ladder in ladders
        for level in ladder.levels
    ]  # fmt: skip


def _step_rows(study: ConvergenceStudy) -> list[dict[str, Any]]:
    keys = ("dt", "value", "error", "sampled")
    return [
        {"scheme": s.scheme, **{f"step_{key}": getattr(level, key) for key in keys}}
        for s in study.schemes
        for level in s.levels
    ]
