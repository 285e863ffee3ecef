"""A convergence study as tables and panels of a picture."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cases.scene.units import DIMENSIONS, Units, bracketed
from cases.show.pictures.panel import Curve, Panel
from cases.show.study_page import Page, Table
from cases.study.converge import ROUND_OFF, ConvergenceStudy, Ladder
from cases.study.orders import LIMITS
from cases.study.weak import ORDERS, WeakOrder

GCI_WORDS = (
    f"Safety factor 1.25 where the observed order is within 10 % of theory, else 3. {LIMITS}"
)
ORDER_WORDS = (
    "Orders: in h powers of h; in p nats a degree; by tol nats a unit of √unknowns. Levels within"
    " ten times the floor (reference, end of the mesh) give none. Where the nats do not fall"
    " with the degree the error falls exponentially; above contact energies the coefficients have"
    " half-integer powers of H - H_c, and at high degree the rate on a fixed mesh can drop."
)
STEP_WORDS = (
    f"Order: of the best fit to all steps; order error: from and to one standard error,"
    f" {ORDERS[0]:g} or {ORDERS[-1]:g} where none is known. Orders: of consecutive resolved steps,"
    " each with its error. Chi²: with the order of theory. Limit: the closed form where there is"
    " one, else the intercept of that fit. Short: by how much the standard errors are larger than"
    " wanted, in the time given. Unstable: no step is stable and cheap enough."
)
LIMITS_OF_AXIS = (1e-16, 10.0)
"""Ends of the axis of L1 errors: round-off of one, and more than the largest distance, 2."""


def convergence_page(study: ConvergenceStudy) -> Page:
    """Return what ``fpk converge`` shows and writes."""
    errors, orders, index, samples = (list[dict[str, Any]]() for _ in range(4))
    for x in study.ladders:
        names, finest = {"equation": x.equation, "family": x.name}, x.levels[-1].errors
        for v in x.levels:
            level = {"level": v.settings, "unknowns": v.unknowns, **v.errors}
            errors.append({**names, **level, "estimate": v.estimate})
        orders += [{**names, "error": key, **asdict(of)} for key, of in x.verdicts.items()]
        for key, grid in x.grid.items():
            index.append({**names, "functional": key, "true error": finest[key], **asdict(grid)})
    steps = [
        {"scheme": s.scheme, **asdict(run), "step error": error, "its error": bar}
        for s in study.schemes
        for run, error, bar in zip(s.levels, s.errors, s.error_bars, strict=True)
    ]
    listed = ("levels", "errors", "error_bars")
    weak = [{k: v for k, v in vars(s).items() if k not in listed} for s in study.schemes]
    about = [
        "{equation}: p({observable}) against {reference}, itself within {reference_error:.1e} in"
        " L1. By tolerance: {by_tolerance}".format(**e)
        for e in study.equations
    ]
    slope = of = ""
    if s := study.samples:
        pairs = zip(s.sampled, s.errors, strict=True)
        samples = [{"paths x time": time, "standard error": error} for time, error in pairs]
        of, slope = s.observable, f"slope {s.slope:.3f} ± {s.slope_error:.3f}, theory -0.5"
    refusals = [{"route": route, "reason": why} for route, why in study.refusals.items()]
    units = study.scene.units
    square = units.of(DIMENSIONS["q"], DIMENSIONS["q"])
    time, energy = units.time, units.quantity("energy")
    means = {"value": square, "error": square, "step error": square, "its error": square}
    of_steps = {"dt": time, "sampled": time, **means}
    of_weak = dict.fromkeys(("limit", "limit_error", "wanted"), square)
    of_samples = {"paths x time": time, "standard error": square}
    of_errors = {"mean energy": energy}
    if len(dimensions := {e["dimension"] for e in study.equations}) == 1 and units:
        powers = np.array(DIMENSIONS["H"]) * -dimensions.pop()
        of_errors |= {"L2": units.of(tuple(0.5 * powers)), "max": units.of(tuple(powers))}
        of_errors["integral of p²"] = of_errors["max"]
    tables = [
        Table("errors", "Averaged equations: errors", errors, tuple(about), of_errors),
        Table("orders", "Averaged equations: observed orders", orders, (ORDER_WORDS,)),
        Table("index", "Richardson and grid convergence index (GCI)", index, (GCI_WORDS,)),
        Table("steps", f"Simulation: errors of the step in {of}", steps, units=of_steps),
        Table("weak", "Simulation: weak order in the step", weak, (STEP_WORDS,), of_weak),
        Table(
            "samples",
            f"Simulation: standard error of {of} in samples",
            samples,
            (slope,),
            of_samples,
        ),
        Table("refusals", "Routes that do not apply", refusals),
    ]
    title = f"Convergence: {study.scene.title}"
    return Page("converge", study.scene, title, tables, study_panels(study))


def study_panels(study: ConvergenceStudy) -> list[Panel]:
    """Return L1 against unknowns of every equation, against the degree, and bias against the step.

    Dashed lines have the slope of theory, below the finest levels.
    """
    panels = []
    for e in study.equations:
        name, y = e["equation"], f"L₁ error of p({e['observable']})"
        axis: dict[str, Any] = {"floor": e["reference_error"] + ROUND_OFF, "limits": LIMITS_OF_AXIS}
        curves = [_in_unknowns(ladder) for ladder in e["ladders"] if ladder.equation == name]
        panels.append(Panel(f"{name}; dashed: order of theory", "unknowns N", y, curves, **axis))
        if e["dimension"] == 1:
            curves = []
            for ladder in (x for x in e["ladders"] if x.family == "p"):
                degrees = [-np.log(level.size) for level in ladder.levels]
                label = f"{ladder.equation}: exp(−{ladder.verdicts['L1'].order:.1f} p)"
                curves.append(Curve(label, degrees, [level.error for level in ladder.levels]))
            x, axis["logarithmic"] = "degree p on a fixed mesh", False
            panels.append(Panel("exponential in p", x, y, curves, **axis))
    return [*panels, _step_panel(study.schemes, study.scene.units)] if study.schemes else panels


def _in_unknowns(ladder: Ladder) -> Curve:
    N = np.array([level.unknowns for level in ladder.levels], dtype=float)
    e = np.array([level.error for level in ladder.levels])
    notes = [str(level.settings) for level in ladder.levels]
    if not ladder.degree:
        return Curve(ladder.name, N, e, notes=notes)
    power = (ladder.degree + 1.0) / ladder.dimension
    dashed = N[-3:], 0.5 * e[-1] * (N[-3:] / N[-1]) ** -power
    return Curve(
        f"{ladder.name}: order {ladder.verdicts['L1'].order:.2f}", N, e, dashed=dashed, notes=notes
    )


def _step_panel(schemes: Sequence[WeakOrder], units: Units) -> Panel:
    curves = []
    for s in schemes:
        dt, words = np.array([level.dt for level in s.levels]), f"{s.verdict} (theory {s.theory})"
        if s.verdict in ("as theory", "pre-asymptotic") and not s.beyond:
            words = f"order {s.order:.1f} ± {np.ptp(s.order_error) / 2:.1f} (theory {s.theory})"
        line = (dt, abs(s.slope) * dt**s.theory) if dt.size else None
        label, bar = f"{s.scheme}: {words}", np.array(s.error_bars)
        curves.append(Curve(label, dt, s.errors, bar, dashed=line, style="none"))
    x = f"step dt [{units.time}]" if units else "step dt, in the scene's unit of time"
    square = units.of(DIMENSIONS["q"], DIMENSIONS["q"])
    y = f"step error of {schemes[0].observable}{bracketed(square)}"
    return Panel("full system (6), simulation; lines: theory", x, y, curves)
