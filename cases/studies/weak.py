"""Simulation: the weak order in the step with error bars, and the slope −1/2 in samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, isfinite, nan, sqrt
from time import process_time

import numpy as np

from averaging.exact import Exact
from averaging.gaussian import Linear
from cases.studies.sampling_law import BURN_IN
from cases.studies.weak_fit import StepLevel, WeakOrder, fit, judged, unstable, wanted_error
from fpk.density import moment
from fpk.errors import InvalidInput
from fpk.method import Method, Progress, silent
from fpk.observable import parse_observable
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.report import Report
from sim.scheme import SCHEMES

LEVELS, FEW_LEVELS = 5, 4
"""Steps of a study; the fewer where they are small, and each takes long."""
RATIO = sqrt(2.0)
"""Ratio of neighbouring steps: five levels then fit between what is stable and what is chosen."""
PILOT = 4.0
"""Relaxation times of a pilot run, beside the 10 of its burn-in."""
SAMPLE_LADDER = (1.0, 4.0, 16.0, 64.0)
SLOWEST, SMALL_STEP = 2.0**-10, 0.25
"""Smallest step that a scheme is tried with, and one that counts as small, in chosen ones."""
SHARE_OF_A_TRIAL = 0.2
"""Share of the time that a trial of one step may take; a scheme that needs longer is left."""


@dataclass(frozen=True)
class SampleSlope:
    """Standard error of E q_i² against the sampled time: the slope, −1/2 in theory."""

    observable: str
    sampled: tuple[float, ...]
    errors: tuple[float, ...]
    slope: float
    slope_error: float


def observed_mass(system: System) -> int:
    """Return the mass (from 0) whose E q² is studied: the first that touches, else the last."""
    return system.contact_masses[0] if system.contact_masses else system.n - 1


def known_square(system: System, mass: int) -> float | None:
    """Return E q_i² of the full system where a closed form gives it."""
    observable = parse_observable(f"q{mass + 1}", system.n)
    exact_routes: tuple[Method, ...] = (Exact(), Linear())
    for method in exact_routes:
        if method.refusal(system, observable) is None:
            (density,) = method.solve(system, [observable]).densities
            return moment(density, 2)
    return None


def weak_order(
    system: System,
    scheme: str,
    *,
    seconds: float,
    seed: int = 1,
    paths: int = 8192,
    threads: int | None = None,
    progress: Progress = silent,
) -> WeakOrder:
    """Return the weak order of ``scheme``, spending about ``seconds`` on its five steps.

    N is derived: a pilot gives bias and standard errors, from them follows what error every level
    may have for the order to be known to ``ORDER_ERROR``, and the sample grows as the square of the
    ratio, or until ``seconds`` of processor time are spent, which ``short`` then tells.
    """
    mass, theory = observed_mass(system), SCHEMES[scheme].weak_order
    truth = known_square(system, mass)
    method = MonteCarlo(paths=paths, scheme=scheme, seed=seed, threads=threads)
    first = _largest_stable(system, replace(method, paths=LEAST_PATHS), mass, seconds)
    if first is None:
        return unstable(scheme, mass, theory)
    levels_wanted = LEVELS
    if first < SMALL_STEP:  # only a large bias asks for such steps: it needs few paths to be seen
        method = replace(method, paths=LEAST_PATHS)
        levels_wanted = FEW_LEVELS
    factors = [first / RATIO**k for k in range(levels_wanted)]
    pilot = _levels(system, method, mass, factors, [PILOT] * levels_wanted)
    progress(1, 3, f"steps of {scheme}")
    if not all(isfinite(level.value) for level in pilot):
        return unstable(scheme, mass, theory)
    _, slope, _, slope_error = fit(pilot, theory, truth)
    # A bias that the pilot does not resolve counts as what it may be: two of its standard errors.
    bias = max(abs(slope), 2.0 * slope_error) * pilot[0].dt ** theory
    wanted = wanted_error(pilot, theory, bias, known=truth is not None)
    grown = [max(1.0, (level.error / wanted) ** 2) for level in pilot]
    share = _affordable(pilot, grown, seconds)
    times = [PILOT * max(1.0, g * share) for g in grown]
    # Where burn-in alone takes all the time the pilot is all that there is.
    levels = _levels(system, method, mass, factors, times) if max(times) > PILOT else pilot
    progress(3, 3, f"steps of {scheme}")
    if not all(isfinite(level.value) for level in levels):
        return unstable(scheme, mass, theory)
    short = max(sqrt(PILOT * g / time) for g, time in zip(grown, times, strict=True))
    return judged(scheme, mass, theory, levels, truth, wanted, short)


def _affordable(pilot: Sequence[StepLevel], grown: Sequence[float], seconds: float) -> float:
    """Return the share of the samples ``grown`` that takes ``seconds``: burn-in costs once."""
    total = PILOT + BURN_IN
    once = sum(level.seconds for level in pilot) * BURN_IN / total
    rest = sum(g * level.seconds for g, level in zip(grown, pilot, strict=True)) * PILOT / total
    return min(1.0, max(0.0, seconds - once) / rest)


def sample_slope(
    system: System, *, seed: int = 1, paths: int = 8192, threads: int | None = None
) -> SampleSlope:
    """Return how the standard error falls with the sampled time at the chosen step.

    Each error comes from single paths and is good to 1/√(2·63) of itself at least, as errors from
    64 batches would be: the bar of the slope.
    """
    mass = observed_mass(system)
    method = MonteCarlo(paths=paths, seed=seed, threads=threads)
    levels = [_run(system, method, mass, 1.0, relaxations) for relaxations in SAMPLE_LADDER]
    x = np.log([level.sampled for level in levels])
    y = np.log([level.error for level in levels])
    x = x - x.mean()
    spread = 1.0 / sqrt(2.0 * 63.0)
    return SampleSlope(
        f"E q{mass + 1}²",
        tuple(level.sampled for level in levels),
        tuple(level.error for level in levels),
        float(x @ y / (x @ x)),
        spread / sqrt(float(x @ x)),
    )


def _run(
    system: System, method: MonteCarlo, mass: int, factor: float, relaxations: float
) -> StepLevel:
    start = process_time()
    run = replace(method, step_factor=factor, relaxations=relaxations)
    report = run.solve(system, []).report
    assert isinstance(report, Report)
    steps, known = report.steps, bool(report.moments)
    return StepLevel(
        dt=steps.dt,
        # Not there where trajectories were lost: nothing is known of the mean then.
        value=report.moments[mass].mean if known else nan,
        error=report.moments[mass].error if known else nan,
        sampled=steps.time * steps.paths,
        seconds=process_time() - start,
    )


def _largest_stable(system: System, method: MonteCarlo, mass: int, seconds: float) -> float | None:
    """The largest step of a descending ladder, in units of the chosen, that loses no trajectory."""
    factor = 4.0
    trial = replace(method, burn_in=1.0)
    while factor > SLOWEST:
        try:
            found = _run(system, trial, mass, factor, 0.1 * PILOT)
        except InvalidInput:  # at or above the limit that the scheme itself refuses
            factor /= RATIO
            continue
        if isfinite(found.value):
            return factor
        if factor < SMALL_STEP and found.seconds > SHARE_OF_A_TRIAL * seconds:
            return None
        factor /= 2.0
    return None


def _levels(
    system: System,
    method: MonteCarlo,
    mass: int,
    factors: Sequence[float],
    times: Sequence[float],
) -> list[StepLevel]:
    # Different seeds: steps of different lengths are independent, as the regression takes them.
    found = []
    for k, (factor, time) in enumerate(zip(factors, times, strict=True)):
        own = replace(method, seed=method.seed + 1000 * ceil(time) + k)
        found.append(_run(system, own, mass, factor, time))
    return found
