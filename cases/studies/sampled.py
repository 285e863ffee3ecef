"""What sampling costs: the full system by every scheme, and the averaged equation (24)."""

from dataclasses import replace
from functools import partial
from math import inf, isfinite, sqrt

import numpy as np

from cases.comparison.averaged import AveragedSimulation
from cases.comparison.compare import chance_l1
from cases.studies.equations import Equation
from cases.studies.full_system import PATHS, FullReference
from cases.studies.law import ERRORS, Law
from cases.studies.levels import Level
from cases.studies.prices import NotTimed, Priced
from cases.studies.runs import Run, coarse, largest_stable, run
from cases.studies.timing import Timing, peak_memory, timed_first
from fpk.certificate import Measured
from fpk.density import Array, SampledDensity, certified_density, l1_distance
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.scheme import SCHEMES

FULL = "full system (6)"
RELAXATIONS, LEVELS = 4.0, 3
"""Sampled relaxation times of the first run at the chosen step, and runs, each a refinement."""
SMALLEST, PATIENCE = 2.0**-8, 2.0
"""Smallest step tried, in chosen ones, and seconds of a trial beyond which no smaller one is."""
HALVINGS = 2
"""Times that the step is halved where a scheme is not yet where its order says."""
FEWEST, AVERAGED_LEVELS, LONG = 256, 3, 5.0
"""Paths of the first simulation of (24), refinements at most, and the seconds that end them."""


def full_routes(
    system: System,
    observable: Observable,
    reference: FullReference,
    *,
    seed: int,
    progress: Progress = silent,
) -> tuple[list[Priced | NotTimed], list[Law]]:
    """Measure the schemes, and return their points: refined at the chosen step, and in (dt, N).

    A baseline without a step at which its law holds is named and not timed: it is no failure.
    """
    results: list[Priced | NotTimed] = []
    laws: list[Law] = []
    name = observable_name(observable)
    axis = f"sampling and step error: expected L1 of p({name}) of the full system"
    for k, scheme in enumerate(sorted(SCHEMES, key=lambda s: -SCHEMES[s].weak_order)):
        progress(k, len(SCHEMES), f"cost of {FULL}")
        method = MonteCarlo(paths=PATHS, scheme=scheme, seed=seed, threads=1)
        baseline = scheme != MonteCarlo.scheme
        law = _law_at_some_step(system, observable, method, reference)
        if isinstance(law, NotTimed):
            results.append(replace(law, baseline=baseline))
            continue
        laws.append(law)
        if not baseline:
            results.append(_refined(system, observable, method, law, reference, axis))
        points = tuple(law.point(error) for error in ERRORS)
        results.append(Priced(f"{scheme}, (dt, N)", FULL, axis, points, sampled=True))
    progress(len(SCHEMES), len(SCHEMES), f"cost of {FULL}")
    return results, laws


def _law_at_some_step(
    system: System, observable: Observable, method: MonteCarlo, reference: FullReference
) -> Law | NotTimed:
    """Return the law from the largest step at which it holds: at most ``HALVINGS`` halvings."""
    factor = largest_stable(system, method, smallest=SMALLEST, patience=PATIENCE)
    if factor is None:
        words = f"no usable step: none down to {SMALLEST:g} of the chosen one is stable and cheap"
        return NotTimed(method.scheme, FULL, reason=words)
    law = _law(system, observable, method, factor, reference)
    for k in range(HALVINGS):  # next to its limit of stability a scheme has no order yet
        if isinstance(law, Law):
            break
        law = _law(system, observable, method, factor * 0.5 ** (k + 1), reference)
    return law


def _measured(
    system: System, observable: Observable, method: MonteCarlo, reference: FullReference
) -> tuple[Run, SampledDensity, float]:
    """Run ``method``; return the run, its density and the distance to the reference."""
    measured = run(system, method, [observable])
    assert measured.density is not None
    return measured, measured.density, l1_distance(measured.density, reference.density)


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
    order = SCHEMES[method.scheme].weak_order
    few = replace(method, relaxations=4.0 * RELAXATIONS)
    if factor < 0.25:
        few = replace(method, paths=LEAST_PATHS, relaxations=RELAXATIONS)
    measure = partial(_measured, system, observable, reference=reference)
    first, biased, distance = measure(replace(few, step_factor=factor))
    noise = float(np.hypot(chance_l1(biased)[0], reference.error))
    resolved = distance > 2.0 * noise
    bias = sqrt(distance**2 - noise**2) if resolved else 2.0 * noise
    usual_run, usual, true = measure(replace(few, step_factor=min(0.7 * factor, 1.0)))
    mean, quantile = chance_l1(usual)
    at, largest = usual_run.steps, first.steps.dt
    # The bias itself is known to the noise of the run that it was read from.
    left = (bias + noise) * (at.dt / largest) ** order
    allowed = quantile + left + 2.0 * reference.error
    if not true <= allowed:
        words = f"differs from the {reference.words} by more than chance and its order explain"
        return NotTimed(method.scheme, FULL, f"dt {at.dt:.3g}", true, allowed, words)
    return Law(
        scheme=method.scheme,
        noise=mean * sqrt(usual_run.sampled),
        bias=bias / largest**order,
        bias_resolved=resolved,
        order=order,
        step=usual_run.seconds * at.dt / (at.paths * (at.time + at.burn_in)),
        largest=largest,
        relaxation=at.relaxation_time,
    )


def _refined(
    system: System,
    observable: Observable,
    method: MonteCarlo,
    law: Law,
    reference: FullReference,
    axis: str,
) -> Priced | NotTimed:
    """Points of the method and its refinements; each must agree with the reference by chance."""
    route, points = method.route.label, []
    level = replace(method, relaxations=RELAXATIONS)
    for k in range(LEVELS):
        level = level.refined() if k else level
        measured, density, true = _measured(system, observable, level, reference)
        mean, quantile = chance_l1(density)
        at = measured.steps
        bias = law.bias * at.dt**law.order
        # Twice the reference's error: its mean is what chance makes of it, not the worst case.
        allowed = quantile + bias + 2.0 * reference.error
        settings = f"{at.paths} paths, time {at.time:.3g}, dt {at.dt:.3g}"
        if not true <= allowed:
            words = f"differs from the {reference.words} by more than chance and step explain"
            return NotTimed(route, FULL, settings, true, allowed, words)
        again = partial(run, system, level, [observable])
        _, second = timed_first(again)
        both = 0.5 * (measured.seconds + second), 0.5 * abs(measured.seconds - second)
        memory = peak_memory(again) if second < 1.0 else float("nan")
        timing = Timing(*both, 2, 0.0, 0.0, memory)
        points.append(Level(settings, {"L1": mean + bias}, mean + bias, timing))
    return Priced(route, FULL, axis, tuple(points), sampled=True)


def averaged_route(
    system: System, equation: Equation, *, seed: int, progress: Progress = silent
) -> Priced | NotTimed:
    """Return the simulation of (24) and its refinements, each run once after one that compiles."""
    reference = equation.reference
    density = certified_density(
        equation.observable,
        reference.panels,
        reference.density,
        _nothing,
        measured=Measured(reference.l1_error, 0.0, 0.0, 0.0, 0.0),
        tol=inf,
    )
    level = AveragedSimulation("nonintegrable", seed=seed, threads=1, paths=FEWEST)
    route, points = level.route.label, []
    _, compiling = timed_first(partial(level.solve, system, [equation.observable]))
    for k in range(AVERAGED_LEVELS):
        progress(k, AVERAGED_LEVELS, route)
        level = level.refined() if k else level
        result, seconds = timed_first(partial(level.solve, system, [equation.observable]))
        (answer,) = result.densities
        assert isinstance(answer, SampledDensity)
        sampled = coarse(answer)
        true = l1_distance(sampled, density)
        mean, quantile = chance_l1(sampled)
        allowed = quantile + reference.l1_error
        settings = f"{level.paths} paths, step {level.step:g}"
        if not (isfinite(true) and true <= allowed):
            words = f"differs from the {equation.reference_words} by more than chance explains"
            return NotTimed(route, equation.name, settings, true, allowed, words)
        timing = Timing(seconds, first=max(0.0, compiling - seconds) if k == 0 else 0.0)
        points.append(Level(settings, {"L1": mean}, mean, timing))
        if seconds > LONG:
            break
    axis = "sampling error: expected L1 of p(H), within chance of the reference"
    return Priced(route, equation.name, axis, tuple(points), sampled=True)


def _nothing(*energies: Array) -> Array:
    return 0.0 * energies[0]
