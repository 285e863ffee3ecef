"""What sampling the full system costs, by every scheme: checked first, then timed."""

from dataclasses import replace
from functools import partial
from math import sqrt

import numpy as np

from cases.comparison.compare import chance_l1
from cases.studies.full_system import PATHS, FullReference, coarse, sampled_distance
from cases.studies.priced import NotTimed, Point, Priced
from cases.studies.sampling_law import ERRORS, FULL, Law
from cases.studies.timing import Timing, peak_memory, timed_first
from fpk.density import SampledDensity
from fpk.errors import InvalidInput
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.report import Report
from sim.scheme import SCHEMES

OWN = "exact_flow"
"""The scheme of the program; the others are baselines."""
RELAXATIONS = (4.0, 16.0, 64.0)
"""Sampled relaxation times of the runs at the chosen step."""
TRIAL = 0.25
"""Relaxation times of a trial run that finds the largest stable step."""
SLOWEST = 2.0**-8
SMALLER = 2
"""Times that the step is halved where a scheme is not yet where its order says."""
LONG_TRIAL = 2.0
"""Seconds of a trial at a quarter of the chosen step beyond which no smaller one is tried."""


def full_routes(
    system: System,
    observable: Observable,
    reference: FullReference,
    *,
    seed: int,
    progress: Progress = silent,
) -> tuple[list[Priced], list[NotTimed], list[Law]]:
    """Measure the schemes, and return their points: in N at the chosen step, and in (dt, N).

    A baseline without a step at which its law holds is named and not timed: it is no failure.
    """
    good: list[Priced] = []
    bad: list[NotTimed] = []
    laws: list[Law] = []
    name = observable_name(observable)
    axis = f"sampling and step error: expected L1 of p({name}) of the full system"
    for k, scheme in enumerate(sorted(SCHEMES, key=lambda s: -SCHEMES[s].weak_order)):
        progress(k, len(SCHEMES), f"cost of {FULL}")
        method = MonteCarlo(paths=PATHS, scheme=scheme, seed=seed, threads=1)
        law = _law_at_some_step(system, observable, method, reference)
        if isinstance(law, NotTimed):
            bad.append(replace(law, baseline=scheme != OWN))
            continue
        laws.append(law)
        if scheme == OWN:
            found = _in_samples(system, observable, method, law, reference)
            if isinstance(found, NotTimed):
                bad.append(found)
            else:
                good.append(replace(found, axis=axis))
        points = tuple(law.point(error) for error in ERRORS)
        good.append(Priced(f"{scheme}, (dt, N)", FULL, axis, points))
    progress(len(SCHEMES), len(SCHEMES), f"cost of {FULL}")
    return good, bad, laws


def _law_at_some_step(
    system: System, observable: Observable, method: MonteCarlo, reference: FullReference
) -> Law | NotTimed:
    """Return the law from the largest step at which it holds: at most ``SMALLER`` halvings."""
    factor = _largest_stable(system, observable, method)
    if factor is None:
        nan = float("nan")
        words = f"no usable step: none down to {SLOWEST:g} of the chosen one is stable and cheap"
        return NotTimed(method.scheme, FULL, "", nan, nan, words)
    law = _law(system, observable, method, factor, reference)
    for _ in range(SMALLER):  # next to its limit of stability a scheme has no order yet
        if isinstance(law, Law):
            break
        factor *= 0.5
        law = _law(system, observable, method, factor, reference)
    return law


def _run(
    system: System, observable: Observable, method: MonteCarlo
) -> tuple[SampledDensity, Report, float]:
    """Return the density, what the run says of itself, and its processor time in seconds."""
    result, seconds = timed_first(lambda: method.solve(system, [observable]))
    (found,) = result.densities
    assert isinstance(found, SampledDensity)
    assert isinstance(result.report, Report)
    return coarse(found), result.report, seconds


def _largest_stable(system: System, observable: Observable, method: MonteCarlo) -> float | None:
    factor = 4.0
    trial = replace(method, paths=LEAST_PATHS, relaxations=TRIAL, burn_in=1.0)
    while factor > SLOWEST:
        try:
            found, report, seconds = _run(system, observable, replace(trial, step_factor=factor))
            if np.all(np.isfinite(found.values)) and not report.lost:
                return factor
            if seconds > LONG_TRIAL and factor < 0.25:
                return None
        except (InvalidInput, ValueError):  # the limit of the scheme, or no range for a histogram
            pass
        factor /= sqrt(2.0) if factor > 0.5 else 2.0
    return None


def _law(
    system: System,
    observable: Observable,
    method: MonteCarlo,
    factor: float,
    reference: FullReference,
) -> Law | NotTimed:
    """Bias from the largest stable step, noise and speed at 0.7 of it or at the chosen one.

    The second run must be where the law says: what is wrong at any step alike is no bias of a step.
    """
    scheme = SCHEMES[method.scheme]
    few = replace(method, relaxations=RELAXATIONS[1])
    if factor < 0.25:
        few = replace(method, paths=LEAST_PATHS, relaxations=RELAXATIONS[0])
    biased, report, _ = _run(system, observable, replace(few, step_factor=factor))
    largest = report.steps.dt
    distance = sampled_distance(biased, reference.shares(biased.edges[0]))
    noise = float(np.hypot(chance_l1(biased)[0], reference.error))
    resolved = distance > 2.0 * noise
    bias = sqrt(distance**2 - noise**2) if resolved else 2.0 * noise
    usual, report, seconds = _run(
        system, observable, replace(few, step_factor=min(0.7 * factor, 1.0))
    )
    at = report.steps
    true = sampled_distance(usual, reference.shares(usual.edges[0]))
    # The bias itself is known to the noise of the run that it was read from.
    left = (bias + noise) * (at.dt / largest) ** scheme.weak_order
    allowed = chance_l1(usual)[1] + left + 2.0 * reference.error
    if not true <= allowed:
        words = f"differs from the {reference.words} by more than chance and its order explain"
        return NotTimed(scheme.name, FULL, f"dt {at.dt:.3g}", true, allowed, words)
    return Law(
        scheme=method.scheme,
        noise=chance_l1(usual)[0] * sqrt(at.paths * at.time),
        bias=bias / largest**scheme.weak_order,
        bias_resolved=resolved,
        order=scheme.weak_order,
        step=seconds * at.dt / (at.paths * (at.time + at.burn_in)),
        largest=largest,
        relaxation=at.relaxation_time,
    )


def _in_samples(
    system: System,
    observable: Observable,
    method: MonteCarlo,
    law: Law,
    reference: FullReference,
) -> Priced | NotTimed:
    """Points in N at the chosen step; each must agree with the reference within chance."""
    route, points = f"{OWN}, N", []
    for relaxations in RELAXATIONS:
        own = replace(method, relaxations=relaxations)
        found, report, first = _run(system, observable, own)
        at = report.steps
        true = sampled_distance(found, reference.shares(found.edges[0]))
        mean, quantile = chance_l1(found)
        bias = law.bias * at.dt**law.order
        # Twice the reference's error: its mean says what chance makes of it, not the worst case.
        allowed = quantile + bias + 2.0 * reference.error
        settings = f"{at.paths} paths, time {at.time:.3g}, dt {at.dt:.3g}"
        if not true <= allowed:
            words = f"differs from the {reference.words} by more than chance and step explain"
            return NotTimed(route, FULL, settings, true, allowed, words)
        again = partial(_run, system, observable, own)
        _, second = timed_first(again)
        timing = Timing(
            seconds=0.5 * (first + second),
            spread=0.5 * abs(first - second),
            repeats=2,
            first=0.0,
            coefficients=0.0,
            memory=peak_memory(again) if second < 1.0 else float("nan"),
        )
        points.append(Point(settings, mean + bias, mean + bias, timing))
    return Priced(route, FULL, "", tuple(points))
