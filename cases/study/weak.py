"""Simulation: the weak order in the step with error bars, and the slope −1/2 in samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, nan, sqrt
from typing import Any, Literal

import numpy as np

from cases.study.orders import observed_orders
from cases.study.simulation import (
    SMALL_STEP,
    Run,
    full_density,
    largest_stable,
    observed,
    run,
    squared,
)
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.settings import LEAST_PATHS
from sim.step.schemes import SCHEMES

LEVELS, FEW_LEVELS = 5, 4
"""Number of steps of a study; the second where they are small, as each then takes long."""
RATIO = sqrt(2.0)
"""Ratio of neighbouring steps: five levels then fit between what is stable and what is chosen."""
PILOT = 4.0
"""Relaxation times of a pilot run, beside those of its burn-in."""
SAMPLE_LEVELS = 4
"""Refinements of the study in samples; each quadruples the time, from one relaxation time on."""
SHARE_OF_A_TRIAL = 0.2
"""Share of the time that a trial of one step may take; a scheme that needs longer is left."""
MIN_ORDER_SIGNAL = 2.0
"""Standard errors an error must exceed for an order to be given from it."""
ORDER_ERROR = 0.25
"""One standard error of the order that a study asks for."""
UNRESOLVED = 0.5
"""Error of the order above which it is not judged: neighbouring orders are not distinguished."""
ORDERS = np.linspace(0.25, 10.0, 391)
"""Orders r at which χ² is evaluated."""
KNOWN = 1e-6
"""Standard error given to a known limit, relative to the smallest of the levels: negligible."""


@dataclass(frozen=True)
class WeakOrder:
    """How E q_i² of one scheme depends on the step, from all steps in one regression.

    ``limit`` is the value at dt → 0, of the closed form where there is one (``known``), else of the
    fit ``limit + slope dtʳ`` with r that of theory, whose χ² with ``freedom`` degrees is ``chi2``.
    ``order`` is the r of the best fit; between the two of ``order_error`` χ² has risen by less than
    one. ``errors`` |E q²(dt) − limit| of each level have the standard errors ``error_bars``, and
    ``orders`` are those of consecutive resolved errors, each with its standard error. ``wanted`` is
    the standard error of the levels that gives the order to ``ORDER_ERROR``, and ``short`` the
    factor by which theirs is larger, at least 1.
    """

    scheme: str
    observable: str
    theory: int
    levels: tuple[Run, ...] = ()
    limit: float = nan
    limit_error: float = nan
    known: bool = False
    slope: float = nan
    slope_error: float = nan
    order: float = nan
    order_error: tuple[float, float] = (nan, nan)
    chi2: float = nan
    freedom: int = 0
    errors: tuple[float, ...] = ()
    error_bars: tuple[float, ...] = ()
    orders: tuple[tuple[float, float], ...] = ()
    wanted: float = nan
    short: float = nan
    verdict: Literal["as theory", "pre-asymptotic", "not resolved", "unstable"] = "unstable"

    @property
    def beyond(self) -> bool:
        """Whether the best fit is at an end of the orders tried: no order is known."""
        low, high = self.order_error
        return bool(low <= ORDERS[0] or high >= ORDERS[-1])


def weak_order(system: System, method: MonteCarlo, *, seconds: float) -> WeakOrder:
    """Return the weak order of the scheme of ``method``, spending about ``seconds`` on its steps.

    A pilot says by which factor its standard errors are too large for the order to be known to
    ``ORDER_ERROR``; the sample grows as the square of that, or until ``seconds`` of processor time
    are spent.
    """
    theory = SCHEMES[method.scheme].weak_order
    unusable = WeakOrder(method.scheme, f"E {squared(system)}", theory)
    first = largest_stable(system, method, patience=SHARE_OF_A_TRIAL * seconds)
    if first is None:
        return unusable
    exact = full_density(system, observed(system))
    count, truth = LEVELS, exact.density.moment(2).value if exact else None
    if first < SMALL_STEP:  # only a large bias asks for such steps: it needs few paths to be seen
        method, count = replace(method, paths=LEAST_PATHS), FEW_LEVELS

    def result(relaxations: float) -> tuple[WeakOrder, float]:
        # Different seeds: the regression takes the values at different steps as independent.
        seed = method.seed + 1000 * ceil(relaxations)
        levels = [
            replace(method, relaxations=relaxations, step_factor=first / RATIO**k, seed=seed + k)
            for k in range(count)
        ]
        try:
            runs = [run(system, level)[0] for level in levels]
        except NotCertified:  # an unstable step
            return unusable, inf
        return judged(unusable, runs, truth), sum(r.seconds for r in runs)

    order, taken = result(PILOT)
    # Burn-in costs once; where it takes all the time the pilot is all that there is.
    affordable = (seconds * (PILOT + method.burn_in) / taken - method.burn_in) / PILOT
    growth = min(order.short**2, affordable)
    return result(PILOT * growth)[0] if growth > 1.0 else order


def _chi2(points: Array, order: float) -> float:
    """χ² of the best line through the values over dtʳ, r the ``order``."""
    dt, value, error = points
    _, (chi2,), *_ = np.polyfit(dt**order, value, 1, w=1.0 / error, full=True)
    return float(chi2)


def judged(scheme: WeakOrder, levels: Sequence[Run], truth: float | None) -> WeakOrder:
    """Return ``scheme`` with the order that the levels show and its verdict.

    "as theory" only where two standard errors of the profile (χ² + 4) exclude other orders; where
    they leave nearly every order, or no slope is resolved, the order is "not resolved".
    """
    dt, value, error = np.array([(run.dt, run.value, run.error) for run in levels]).T
    points = np.array([dt, value, error])
    if truth is not None:  # a value at dt = 0 with nearly no error
        points = np.column_stack([points, [0.0, truth, KNOWN * error.min()]])
    origin = points[1, -1]
    points[1] -= origin  # costs no digits of the differences
    powers = points[0] ** scheme.theory, points[1]
    line, covariance = np.polyfit(*powers, 1, w=1.0 / points[2], cov="unscaled")
    slope, limit = float(line[0]), float(line[1] + origin)
    slope_error, limit_error = np.sqrt(np.diag(covariance)).tolist()
    chi2, profile = _chi2(points, scheme.theory), np.array([_chi2(points, r) for r in ORDERS])
    best, inside = profile.argmin(), ORDERS[profile <= profile.min() + 1.0]
    order, low, high = float(ORDERS[best]), float(inside[0]), float(inside[-1])
    verdict: Any = "as theory"
    if chi2 > profile[best] + 4.0:
        verdict = "pre-asymptotic"
    elif abs(slope) < 3.0 * slope_error or max(order - low, high - order) > UNRESOLVED:
        verdict = "not resolved"
    errors, bars = np.abs(value - limit), np.hypot(error, limit_error)
    relative = bars / errors
    order_bars = np.hypot(relative[1:], relative[:-1]) / -np.diff(np.log(dt))
    resolved = relative < 1.0 / MIN_ORDER_SIGNAL
    orders = np.stack([observed_orders(dt, errors), order_bars], axis=1)
    # No width is less than the spacing of the orders that are tried.
    width = 0.5 * max(high - low, ORDERS[1] - ORDERS[0])
    return replace(
        scheme,
        levels=tuple(levels),
        limit=limit,
        limit_error=limit_error,
        known=truth is not None,
        slope=slope,
        slope_error=slope_error,
        order=order,
        order_error=(low, high),
        chi2=chi2,
        freedom=points.shape[1] - 2,
        errors=tuple(errors.tolist()),
        error_bars=tuple(bars.tolist()),
        orders=tuple(map(tuple, orders[resolved[1:] & resolved[:-1]].tolist())),
        wanted=float(error.max()) * ORDER_ERROR / width,
        short=max(width / ORDER_ERROR, 1.0),
        verdict=verdict,
    )


@dataclass(frozen=True)
class SampleSlope:
    """Standard error of E q_i² against the sampled time: the slope, −1/2 in theory."""

    observable: str
    sampled: tuple[float, ...]
    errors: tuple[float, ...]
    slope: float
    slope_error: float


def sample_slope(system: System, method: MonteCarlo) -> SampleSlope:
    """Return how the standard error falls as the simulation is refined, from the chosen step on.

    Each error is good to 1/√(2·63) of itself at least, as errors from 64 batches would be.
    """
    levels = [replace(method, relaxations=1.0)]
    while len(levels) < SAMPLE_LEVELS:
        levels.append(levels[-1].refined())
    runs = [run(system, level)[0] for level in levels]
    sampled, errors = tuple(r.sampled for r in runs), tuple(r.error for r in runs)
    weights = np.full(len(runs), sqrt(2.0 * 63.0))
    line, covariance = np.polyfit(np.log(sampled), np.log(errors), 1, w=weights, cov="unscaled")
    of = f"E {squared(system)}"
    return SampleSlope(of, sampled, errors, float(line[0]), sqrt(covariance[0, 0]))
