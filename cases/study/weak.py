"""Simulation: the weak order in the step with error bars, and the slope −1/2 in samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, isfinite, sqrt
from time import perf_counter
from typing import Literal

import numpy as np

from averaging.exact import Exact
from averaging.gaussian import Linear
from fpk.density import Array, moment
from fpk.errors import InvalidInput
from fpk.method import Method, Progress, silent
from fpk.observable import parse_observable
from fpk.orders import observed_orders, order_errors
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.scheme import SCHEMES

LEVELS = 5
RATIO = sqrt(2.0)
"""Ratio of neighbouring steps: five levels then fit between what is stable and what is chosen."""
PILOT = 4.0
"""Relaxation times of a pilot run, beside the 10 of its burn-in."""
RESOLVED = 8.0
"""Bias of the second largest step in standard errors that a study asks for."""
LEAST_ORDER_SIGNAL = 2.0
"""Standard errors below which an error is none, and orders that rest on it are not given."""
SAMPLE_LADDER = (1.0, 4.0, 16.0, 64.0)
SLOWEST, SMALL_STEP = 2.0**-10, 0.25
"""Smallest step that a scheme is tried with, and one that counts as small, in chosen ones."""
SHARE_OF_A_TRIAL = 0.2
"""Share of the time that a trial of one step may take; a scheme that needs longer is left."""

Verdict = Literal["as theory", "pre-asymptotic", "not resolved", "unstable"]


@dataclass(frozen=True)
class StepLevel:
    """E q² at one step with its standard error, and the sampled time it took (paths x time)."""

    dt: float
    value: float
    error: float
    sampled: float
    seconds: float


@dataclass(frozen=True)
class WeakOrder:
    """How E q_i² of one scheme depends on the step, from all steps in one regression.

    ``limit`` ± ``limit_error`` is the value at dt → 0: of the closed form where there is one, else
    the intercept of ``limit + slope dtʳ`` with r that of theory. ``order`` ± ``order_error`` is the
    r of the best fit, where its profile rises by one unit of χ²; ``chi2`` that of the fit of theory
    with ``freedom`` degrees. ``wanted`` is the standard error that was asked for, derived from the
    bias that a pilot found, and ``short`` says by what factor the sample fell short of it.
    """

    scheme: str
    observable: str
    theory: int
    levels: tuple[StepLevel, ...]
    limit: float
    limit_error: float
    known: bool
    slope: float
    slope_error: float
    order: float
    order_error: tuple[float, float]
    chi2: float
    freedom: int
    wanted: float
    short: float
    verdict: Verdict

    @property
    def errors(self) -> list[float]:
        """|E q²(dt) − limit| of each level."""
        return [abs(level.value - self.limit) for level in self.levels]

    @property
    def error_bars(self) -> list[float]:
        """One standard error of each of ``errors``."""
        return [float(np.hypot(level.error, self.limit_error)) for level in self.levels]

    @property
    def ratios(self) -> list[tuple[float, float]]:
        """Order and its standard error from consecutive levels; of resolved ones only."""
        e, bars = self.errors, self.error_bars
        steps = [level.dt for level in self.levels]
        pairs = zip(observed_orders(steps, e), order_errors(steps, e, bars), strict=True)
        kept = [a > LEAST_ORDER_SIGNAL * b for a, b in zip(e, bars, strict=True)]
        both = zip(pairs, kept, kept[1:], strict=False)
        return [(float(o), float(s)) for (o, s), a, b in both if a and b]


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

    N is derived: a pilot gives bias and standard error, and the sample grows as the square of their
    ratio until the bias at the second largest step is ``RESOLVED`` standard errors, or the time is
    spent, which ``short`` then tells.
    """
    mass, theory = observed_mass(system), SCHEMES[scheme].weak_order
    truth = known_square(system, mass)
    method = MonteCarlo(paths=paths, scheme=scheme, seed=seed, threads=threads)
    first = _largest_stable(system, replace(method, paths=LEAST_PATHS), mass, seconds)
    if first is None:
        return _unstable(scheme, mass, theory)
    if first < SMALL_STEP:  # only a large bias asks for such steps: it needs few paths to be seen
        method = replace(method, paths=LEAST_PATHS)
    factors = [first / RATIO**k for k in range(LEVELS)]
    pilot = _levels(system, method, mass, factors, [PILOT] * LEVELS)
    progress(1, 3, f"steps of {scheme}")
    _, slope, _, slope_error = _fit(pilot, theory, truth)
    # A bias that the pilot does not resolve counts as what it may be: two of its standard errors.
    bias = max(abs(slope), 2.0 * slope_error) * pilot[1].dt ** theory
    wanted = bias / RESOLVED
    grown = [max(1.0, (level.error / wanted) ** 2) for level in pilot]
    cost = sum(g * level.seconds for g, level in zip(grown, pilot, strict=True))
    share = min(1.0, seconds / cost)
    times = [PILOT * max(1.0, g * share) for g in grown]
    levels = _levels(system, method, mass, factors, times)
    progress(3, 3, f"steps of {scheme}")
    return _judged(scheme, mass, theory, levels, truth, wanted, 1.0 / sqrt(share))


def sample_slope(
    system: System, *, seed: int = 1, paths: int = 8192, threads: int | None = None
) -> SampleSlope:
    """Return how the standard error falls with the sampled time at the chosen step.

    Each error comes from 64 batches and is good to 1/√(2·63) of itself, the bar of the slope.
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
    start = perf_counter()
    run = replace(method, step_factor=factor, relaxations=relaxations)
    found = run.solve(system, []).settings
    name = f"E q{mass + 1}²"
    return StepLevel(
        dt=float(found["dt"]),
        value=float(found[name]),
        error=float(found[f"standard error of {name}"]),
        sampled=float(found["time"]) * float(found["paths"]),
        seconds=perf_counter() - start,
    )


def _largest_stable(system: System, method: MonteCarlo, mass: int, seconds: float) -> float | None:
    """The largest step of a descending ladder, in units of the chosen, that loses no trajectory."""
    factor = 4.0
    while factor > SLOWEST:
        try:
            found = _run(system, method, mass, factor, 0.1 * PILOT)
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


def _fit(
    levels: Sequence[StepLevel], order: float, truth: float | None
) -> tuple[float, float, float, float]:
    """Weighted least squares of value = limit + slope dtʳ: limit, slope and their errors."""
    x = np.array([level.dt**order for level in levels])
    y = np.array([level.value for level in levels])
    w = 1.0 / np.array([level.error for level in levels])
    if truth is not None:
        information = float(np.sum((w * x) ** 2))
        slope = float(np.sum(w * w * x * (y - truth))) / information
        return truth, slope, 0.0, 1.0 / sqrt(information)
    A = np.stack([w, w * x], axis=1)
    covariance = np.linalg.inv(A.T @ A)
    limit, slope = covariance @ A.T @ (w * y)
    return float(limit), float(slope), sqrt(covariance[0, 0]), sqrt(covariance[1, 1])


def _chi2(levels: Sequence[StepLevel], order: float, truth: float | None) -> float:
    limit, slope, _, _ = _fit(levels, order, truth)
    z = [(level.value - limit - slope * level.dt**order) / level.error for level in levels]
    return float(np.sum(np.square(z)))


def _judged(
    scheme: str,
    mass: int,
    theory: int,
    levels: Sequence[StepLevel],
    truth: float | None,
    wanted: float,
    short: float,
) -> WeakOrder:
    limit, slope, limit_error, slope_error = _fit(levels, theory, truth)
    orders: Array = np.linspace(0.25, 10.0, 391)
    profile = np.array([_chi2(levels, r, truth) for r in orders])
    best = int(profile.argmin())
    inside = orders[profile <= profile[best] + 1.0]
    if abs(slope) < 3.0 * slope_error:
        verdict: Verdict = "not resolved"
    else:  # two standard errors of the profile: χ² may rise by 4
        near = _chi2(levels, theory, truth) <= profile[best] + 4.0
        verdict = "as theory" if near else "pre-asymptotic"
    return WeakOrder(
        scheme=scheme,
        observable=f"E q{mass + 1}²",
        theory=theory,
        levels=tuple(levels),
        limit=limit,
        limit_error=limit_error,
        known=truth is not None,
        slope=slope,
        slope_error=slope_error,
        order=float(orders[best]),
        order_error=(float(inside[0]), float(inside[-1])),
        chi2=_chi2(levels, theory, truth),
        freedom=len(levels) - (1 if truth is not None else 2),
        wanted=wanted,
        short=short,
        verdict=verdict,
    )


def _unstable(scheme: str, mass: int, theory: int) -> WeakOrder:
    nan = float("nan")
    return WeakOrder(
        scheme, f"E q{mass + 1}²", theory, (), nan, nan, False, nan, nan, nan, (nan, nan), nan, 0,
        nan, nan, "unstable",
    )  # fmt: skip
