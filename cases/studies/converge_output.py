"""A convergence study as tables, panels of a picture, and rows."""

from pathlib import Path
from typing import Any

import numpy as np

from cases.studies.converge import ConvergenceStudy, Studied
from cases.studies.ladders import COLUMNS, Ladder
from cases.studies.picture import Curve, Panel, study_figure
from cases.studies.tables import Table, markdown_text, rows_dataset, write_study
from cases.studies.weak_fit import WeakOrder
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


def study_tables(study: ConvergenceStudy) -> list[Table]:
    """Return errors and orders of every ladder, the functionals, the steps and the samples."""
    tables = []
    for studied in study.equations:
        tables += [_errors(studied), _orders(studied), _grid(studied)]
        if studied.dimension == 1:
            tables.append(_in_degree(studied, study.without_contact))
    if study.schemes:
        tables.append(_steps(study.schemes))
    if study.samples:
        tables.append(_samples(study))
    if study.refusals:
        rows = tuple(study.refusals.items())
        tables.append(Table("Routes that do not apply", ("route", "reason"), rows))
    return tables


def _errors(studied: Studied) -> Table:
    return Table(
        f"{studied.equation}, p({studied.observable}): errors",
        ("family", "level", "unknowns", *COLUMNS, "its L1 estimate"),
        [
            (ladder.name, v.setting, v.unknowns, *(v.errors[key] for key in COLUMNS), v.estimate)
            for ladder in studied.ladders
            for v in ladder.levels
        ],
        (
            f"Against: {studied.reference}, itself within {studied.reference_error:.1e} in L1.",
            f"{studied.ladders[-1].name}: {studied.by_tolerance}",
        ),
    )


def _orders(studied: Studied) -> Table:
    rows = [
        (
            ladder.name,
            key,
            " ".join(f"{o:.2f}" for o in v.orders),
            f"{v.order:.2f} ± {v.spread:.2f}" if v.order == v.order else None,
            None if v.theory is None else f"{v.theory:g}",
            v.kind,
        )
        for ladder in studied.ladders
        for key, v in ladder.verdicts.items()
    ]
    return Table(
        f"{studied.equation}: observed orders",
        ("family", "error", "consecutive levels", "last three", "theory", "verdict"),
        rows,
        (ORDER_WORDS, *(TWO_ENERGIES if studied.dimension == 2 else ())),
    )


def _grid(studied: Studied) -> Table:
    rows = [
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
        for ladder in studied.ladders
        for key, g in ladder.grid.items()
    ]
    head = ("family", "functional", "Richardson", "observed", "used", "factor", "GCI", "true error")
    title = f"{studied.equation}: Richardson and grid convergence index (GCI)"
    return Table(title, (*head, "verdict"), rows, (GCI_WORDS,))


def _with_and_without(studied: Studied, without: Ladder | None) -> list[tuple[str, Ladder]]:
    """The ladder in p of the system as it is, and of that without contacts where it has any."""
    own = [("with contact" if without else "no contact", studied.in_degree)]
    return own + ([("contacts taken away", without)] if without else [])


def _in_degree(studied: Studied, without: Ladder | None) -> Table:
    """Errors by degree on a fixed mesh, with contact and without: nats of error a degree."""
    rows = [
        (words, level.setting, level.unknowns, level.error, rate)
        for words, ladder in _with_and_without(studied, without)
        for level, rate in zip(ladder.levels, rates(ladder), strict=True)
    ]
    head = ("system", "degree", "unknowns", "L1", "nats a degree")
    return Table(f"{studied.equation}: exponential convergence in p", head, rows, (DEGREE_WORDS,))


def rates(ladder: Ladder) -> list[str]:
    """Return the nats of error that a degree took off, by level; a dash where none is known."""
    orders = [f"{o:.2f}" for o in ladder.verdicts["L1"].orders]
    return ["–", *orders, *["–"] * (len(ladder.levels) - 1 - len(orders))]


def _steps(schemes: tuple[WeakOrder, ...]) -> Table:
    rows = [
        (s.scheme, f"{v.dt:.4g}", f"{v.value:.6f}", v.error, error, bar, v.sampled)
        for s in schemes
        for v, error, bar in zip(s.levels, s.errors, s.error_bars, strict=True)
    ]
    head = ("scheme", "dt", schemes[0].observable, "one s.e.", "|error|", "its s.e.")
    remarks = tuple(_order_words(s) for s in schemes)
    return Table("Simulation: weak order in the step", (*head, "paths x time"), rows, remarks)


def _order_words(s: WeakOrder) -> str:
    if s.verdict == "unstable":
        return f"{s.scheme}: no step is stable and cheap enough to study."
    low, high = s.order_error
    base = "closed form" if s.known else "intercept of the regression"
    ratios = ", ".join(f"{o:.2f} ± {e:.2f}" for o, e in s.ratios) or "none resolved"
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


def _samples(study: ConvergenceStudy) -> Table:
    slope = study.samples
    assert slope is not None
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
    panels = [_ladder_panel(s) for s in study.equations]
    panels += [_degree_panel(s, study.without_contact) for s in study.equations if s.dimension == 1]
    return [*panels, _step_panel(study.schemes)] if study.schemes else panels


def _ladder_panel(studied: Studied) -> Panel:
    curves = []
    for ladder in studied.ladders:
        N = np.array([level.unknowns for level in ladder.levels], dtype=float)
        e = np.array([level.error for level in ladder.levels])
        label, dashed = ladder.name, None
        if ladder.degree:
            label = f"{ladder.name}: order {ladder.verdicts['L1'].order:.2f}"
            power = (ladder.degree + 1.0) / ladder.dimension
            dashed = N[-3:], 0.5 * e[-1] * (N[-3:] / N[-1]) ** -power
        curves.append(Curve(ladder.name, N, e, label, dashed=dashed))
    return _error_panel(studied, "dashed: order of theory", "unknowns $N$", curves)


def _degree_panel(studied: Studied, without: Ladder | None) -> Panel:
    """Log-lin: exponential convergence is a straight line."""
    curves = []
    for words, ladder in _with_and_without(studied, without):
        label = f"{words}: $e^{{-{ladder.verdicts['L1'].order:.1f} p}}$"
        p, e = [-np.log(v.size) for v in ladder.levels], [v.error for v in ladder.levels]
        curves.append(Curve(words, p, e, label))
    x = "degree $p$ on a fixed mesh"
    return _error_panel(studied, "exponential in $p$", x, curves, logarithmic=False)


def _error_panel(studied: Studied, words: str, x: str, curves: list[Curve], **how: Any) -> Panel:
    return Panel(
        f"{studied.equation}; {words}",
        x,
        f"$L_1$ error of p({studied.observable})",
        curves,
        floor=studied.reference_error + 1e-15,
        limits=LIMITS_OF_AXIS,
        **how,
    )


def _step_panel(schemes: tuple[WeakOrder, ...]) -> Panel:
    curves = []
    for s in schemes:
        label, dashed = f"{s.scheme}: no usable step", None
        if s.levels:
            low, high = s.order_error
            order = f"order {s.order:.1f} ± {0.5 * (high - low):.1f}"
            words = s.verdict if s.beyond or s.verdict == "not resolved" else order
            label = f"{s.scheme}: {words} (theory {s.theory})"
            fit = np.geomspace(s.levels[0].dt, s.levels[-1].dt, 30)
            dashed = fit, abs(s.slope) * fit**s.theory
        dt = [level.dt for level in s.levels]
        curves.append(Curve(s.scheme, dt, s.errors, label, s.error_bars, False, dashed,
                            joined=False))  # fmt: skip
    of = schemes[0].observable
    title = "full system (6), simulation; lines: theory"
    return Panel(title, "step $dt$, in the scene's unit of time", f"step error of {of}", curves)


def write_convergence(study: ConvergenceStudy, folder: Path) -> list[Path]:
    """Write ``converge.md``, ``converge.nc`` and ``converge.svg``; return their paths."""
    title = f"Convergence: {study.scene.title}"
    return write_study(
        "converge",
        folder,
        study.scene,
        title=title,
        page=markdown_text(title, study_tables(study)),
        data=rows_dataset(level=_level_rows(study), step=_step_rows(study)),
        figure=study_figure(study_panels(study)),
    )


def _level_rows(study: ConvergenceStudy) -> list[dict[str, Any]]:
    return [
        {
            "equation": studied.equation,
            "family": ladder.name,
            "level_name": level.setting,
            "unknowns": level.unknowns,
            **{f"error_{key.replace(' ', '_').replace('²', '2')}": e
               for key, e in level.errors.items()},
            "estimate_L1": level.estimate,
        }
        for studied in study.equations
        for ladder in studied.ladders
        for level in ladder.levels
    ]  # fmt: skip


def _step_rows(study: ConvergenceStudy) -> list[dict[str, Any]]:
    keys = ("dt", "value", "error", "sampled")
    return [
        {"scheme": s.scheme, **{f"step_{key}": getattr(level, key) for key in keys}}
        for s in study.schemes
        for level in s.levels
    ]
