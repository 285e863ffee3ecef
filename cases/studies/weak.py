"""Simulation: the weak order in the step with error bars, and the slope −1/2 in samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, isfinite, sqrt

import numpy as np

from cases.studies.full_system import full_density
from cases.studies.runs import largest_stable, observed_mass, run
from cases.studies.weak_fit import StepLevel, WeakOrder, fit, judged, unstable, wanted_error
from fpk.density import moment
from fpk.method import Progress, silent
from fpk.observable import parse_observable
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.scheme import SCHEMES

LEVELS, FEW_LEVELS = 5, 4
"""Steps of a study; the fewer where they are small, and each takes long."""
RATIO = sqrt(2.0)
"""Ratio of neighbouring steps: five levels then fit between what is stable and what is chosen."""
PILOT = 4.0
"""Relaxation times of a pilot run, beside those of its burn-in."""
SAMPLE_LEVELS = 4
"""Refinements of the study in samples; each quadruples the time, from one relaxation time on."""
SMALLEST, SMALL_STEP = 2.0**-10, 0.25
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


def known_square(system: System) -> float | None:
    """Return E q_i² of the full system where a route that is not sampled gives it."""
    name = f"q{observed_mass(system) + 1}"
    answer = full_density(system, parse_observable(name, system.n))
    return None if answer is None else moment(answer[1], 2)


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
    ratio, or until ``seconds`` of processor time are spent, by which ``short`` then falls short.
    """
    mass, theory = observed_mass(system), SCHEMES[scheme].weak_order
    truth = known_square(system)
    method = MonteCarlo(paths=paths, scheme=scheme, seed=seed, threads=threads)
    patience = SHARE_OF_A_TRIAL * seconds
    first = largest_stable(system, method, smallest=SMALLEST, patience=patience)
    if first is None:
        return unstable(scheme, mass, theory)
    count = LEVELS
    if first < SMALL_STEP:  # only a large bias asks for such steps: it needs few paths to be seen
        method, count = replace(method, paths=LEAST_PATHS), FEW_LEVELS
    factors = [first / RATIO**k for k in range(count)]
    pilot = _levels(system, method, factors, [PILOT] * count)
    progress(1, 2, f"steps of {scheme}")
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
    levels = _levels(system, method, factors, times) if max(times) > PILOT else pilot
    progress(2, 2, f"steps of {scheme}")
    if not all(isfinite(level.value) for level in levels):
        return unstable(scheme, mass, theory)
    short = max(sqrt(PILOT * g / time) for g, time in zip(grown, times, strict=True))
    return judged(scheme, mass, theory, levels, truth, wanted, short)


def _affordable(pilot: Sequence[StepLevel], grown: Sequence[float], seconds: float) -> float:
    """Return the share of the samples ``grown`` that takes ``seconds``: burn-in costs once."""
    total = PILOT + MonteCarlo.burn_in
    once = sum(level.seconds for level in pilot) * MonteCarlo.burn_in / total
    rest = sum(g * level.seconds for g, level in zip(grown, pilot, strict=True)) * PILOT / total
    return min(1.0, max(0.0, seconds - once) / rest)


def _levels(
    system: System, method: MonteCarlo, factors: Sequence[float], times: Sequence[float]
) -> list[StepLevel]:
    # Different seeds: steps of different lengths are independent, as the regression takes them.
    runs = [
        run(
            system,
            replace(
                method,
                step_factor=factor,
                relaxations=time,
                seed=method.seed + 1000 * ceil(time) + k,
            ),
        )
        for k, (factor, time) in enumerate(zip(factors, times, strict=True))
    ]
    return [StepLevel(r.steps.dt, r.value, r.error, r.sampled, r.seconds) for r in runs]


def sample_slope(
    system: System, *, seed: int = 1, paths: int = 8192, threads: int | None = None
) -> SampleSlope:
    """Return how the standard error falls as the simulation is refined, from the chosen step on.

    Each error comes from single paths and is good to 1/√(2·63) of itself at least, as errors from
    64 batches would be: the bar of the slope.
    """
    level = MonteCarlo(paths=paths, seed=seed, threads=threads, relaxations=1.0)
    runs = []
    for k in range(SAMPLE_LEVELS):
        level = level.refined() if k else level
        runs.append(run(system, level))
    x = np.log([r.sampled for r in runs])
    y = np.log([r.error for r in runs])
    x = x - x.mean()
    spread = 1.0 / sqrt(2.0 * 63.0)
    return SampleSlope(
        f"E q{observed_mass(system) + 1}²",
        tuple(r.sampled for r in runs),
        tuple(r.error for r in runs),
        float(x @ y / (x @ x)),
        spread / sqrt(float(x @ x)),
    )
