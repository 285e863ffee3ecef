"""The weak order of a scheme from values at several steps: the fit and what it says."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Literal

import numpy as np

from fpk.density import Array
from fpk.orders import observed_orders, order_errors

MIN_ORDER_SIGNAL = 2.0
"""Standard errors an error must exceed for an order to be given from it."""
ORDER_ERROR = 0.25
"""One standard error of the order that a study asks for."""
UNRESOLVED = 0.5
"""Error of the order above which it is not judged: neighbouring orders are not distinguished."""
LOWEST_ORDER, HIGHEST_ORDER = 0.25, 10.0
"""Orders between which the fit is sought."""

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
    error of the order that is wanted and the bias of a pilot run, and ``short`` is the factor by
    which the sample fell short of it.
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
    def beyond(self) -> bool:
        """Whether the best fit is at an end of the orders tried: no order is known."""
        low, high = self.order_error
        return low <= LOWEST_ORDER or high >= HIGHEST_ORDER

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
        resolved = [a > MIN_ORDER_SIGNAL * b for a, b in zip(e, bars, strict=True)]
        both = zip(pairs, resolved, resolved[1:], strict=False)
        return [(float(o), float(s)) for (o, s), a, b in both if a and b]


def wanted_error(levels: Sequence[StepLevel], theory: int, bias: float, *, known: bool) -> float:
    """Return the standard error of every level from which the order follows to ``ORDER_ERROR``.

    ``bias`` is that of the largest step. First order of limit + bias (dt/dt_1)ʳ in its parameters,
    the limit left out where it is ``known``.
    """
    x = np.array([level.dt for level in levels]) / levels[0].dt
    columns = [x**theory, bias * x**theory * np.log(x)]
    J = np.stack(columns if known else [*columns, np.ones(x.size)], axis=1)
    return ORDER_ERROR / sqrt(float(np.linalg.inv(J.T @ J)[1, 1]))


def fit(
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
    limit, slope, _, _ = fit(levels, order, truth)
    z = [(level.value - limit - slope * level.dt**order) / level.error for level in levels]
    return float(np.sum(np.square(z)))


def judged(
    scheme: str,
    mass: int,
    theory: int,
    levels: Sequence[StepLevel],
    truth: float | None,
    wanted: float,
    short: float,
) -> WeakOrder:
    """Return what the levels show: "as theory" only where other orders are excluded.

    ``wanted`` and ``short`` are handed through.
    """
    limit, slope, limit_error, slope_error = fit(levels, theory, truth)
    orders: Array = np.linspace(LOWEST_ORDER, HIGHEST_ORDER, 391)
    profile = np.array([_chi2(levels, r, truth) for r in orders])
    best = int(profile.argmin())
    inside = orders[profile <= profile[best] + 1.0]
    order, low, high = float(orders[best]), float(inside[0]), float(inside[-1])
    # Two standard errors of the profile, χ² + 4, exclude theory or do not; where they leave nearly
    # every order, or no slope is seen, they say nothing for theory either.
    verdict: Verdict = "as theory"
    if _chi2(levels, theory, truth) > profile[best] + 4.0:
        verdict = "pre-asymptotic"
    elif abs(slope) < 3.0 * slope_error or max(order - low, high - order) > UNRESOLVED:
        verdict = "not resolved"
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
        order=order,
        order_error=(low, high),
        chi2=_chi2(levels, theory, truth),
        freedom=len(levels) - (1 if truth is not None else 2),
        wanted=wanted,
        short=short,
        verdict=verdict,
    )


def unstable(scheme: str, mass: int, theory: int) -> WeakOrder:
    """Return the answer for a scheme without steps that are stable and cheap enough to study."""
    nan = float("nan")
    return WeakOrder(
        scheme, f"E q{mass + 1}²", theory, (), nan, nan, False, nan, nan, nan, (nan, nan), nan, 0,
        nan, nan, "unstable",
    )  # fmt: skip
