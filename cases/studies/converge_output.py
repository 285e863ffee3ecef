"""A convergence study as tables, panels of a picture, and rows."""

from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from cases.studies.answer import FUNCTIONALS, NORMS
from cases.studies.converge import ConvergenceStudy
from cases.studies.ladders import Ladder, observed_rates
from cases.studies.levels import Equation
from cases.studies.picture import Curve, Panel, study_figure
from cases.studies.tables import Page, Table, rows_dataset
from cases.studies.weak import ORDERS, WeakOrder
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
STEP_WORDS = (
    "Weak order: that of the best fit to all steps, from and to one standard error;"
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
        tables += _steps(study.schemes)
    if s := study.samples:
        title = f"Simulation: standard error of {s.observable} in samples"
        words = f"slope {s.slope:.3f} ± {s.slope_error:.3f}, theory -0.5"
        rows = list(zip(s.sampled, s.errors, strict=True))
        tables.append(Table(title, "paths x time | one s.e.", rows, (words,)))
    if study.refusals:
        refusals = list(study.refusals.items())
        tables.append(Table("Routes that do not apply", "route | reason", refusals))
    return tables


def _equation_tables(equation: Equation, ladders: Sequence[Ladder]) -> list[Table]:
    name, floor = equation.name, equation.reference.l1_error
    errors = [
        (ladder.name, v.settings, v.unknowns, *v.errors.values(), v.estimate)
        for ladder in ladders
        for v in ladder.levels
    ]
    orders = [(x.name, key, *astuple(v)) for x in ladders for key, v in x.verdicts.items()]
    index = [
        (x.name, key, x.levels[-1].errors[key], f"{g.value:.10g}", *astuple(g)[1:])
        for x in ladders
        for key, g in x.grid.items()
    ]
    norms = " | ".join((*NORMS, *FUNCTIONALS))
    against = f"Against: {equation.reference_words}, itself within {floor:.1e} in L1."
    return [
        Table(
            f"{name}, p({observable_name(equation.observable)}): errors",
            f"family | level | unknowns | {norms} | its L1 estimate",
            errors,
            (against, f"{ladders[-1].name}: {equation.by_tolerance[0].words}"),
        ),
        Table(
            f"{name}: observed orders",
            "family | error | consecutive levels | last three | ± | theory | verdict",
            orders,
            (ORDER_WORDS, *(TWO_ENERGIES if equation.dimension == 2 else ())),
        ),
        Table(
            f"{name}: Richardson and grid convergence index (GCI)",
            "family | functional | true error | Richardson | observed | used | factor | GCI"
            " | verdict",
            index,
            (GCI_WORDS,),
        ),
    ]


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
    head = "system | degree | unknowns | L1 | nats a degree"
    return Table(f"{equation.name}: exponential convergence in p", head, rows, (DEGREE_WORDS,))


def _steps(schemes: Sequence[WeakOrder]) -> list[Table]:
    levels = [
        (s.scheme, v.dt, f"{v.value:.6f}", v.error, error, bar, v.sampled)
        for s in schemes
        for v, error, bar in zip(s.levels, s.errors, s.error_bars, strict=True)
    ]
    orders = []
    for s in schemes:
        ratios = tuple(f"{o:.2f} ± {e:.2f}" for o, e in s.orders)
        limit = f"{s.limit:.6f} ± {s.limit_error:.1e}" if s.levels else None
        order = (s.scheme, s.theory, s.order, s.order_error, s.verdict, ratios)
        orders.append((*order, s.chi2, s.freedom, limit, s.wanted, s.short))
    head = "scheme | theory | weak order | from, to | verdict | consecutive ratios | chi² | freedom"
    of = schemes[0].observable
    return [
        Table(
            "Simulation: errors of the step",
            f"scheme | dt | {of} | one s.e. | step error | its s.e. | paths x time",
            levels,
        ),
        Table(
            "Simulation: weak order in the step",
            f"{head} | limit | s.e. wanted | short by a factor",
            orders,
            (STEP_WORDS,),
        ),
    ]


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
    curves = [
        Curve(
            words,
            [-np.log(v.size) for v in ladder.levels],
            [v.error for v in ladder.levels],
            f"{words}: $e^{{-{ladder.verdicts['L1'].order:.1f} p}}$",
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
        label = f"{s.scheme}: {words}"
        curves.append(Curve(s.scheme, dt, s.errors, label, s.error_bars, dashed=line, style="none"))
    y = f"step error of {schemes[0].observable}"
    x = "step $dt$, in the scene's unit of time"
    return Panel("full system (6), simulation; lines: theory", x, y, curves)


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
