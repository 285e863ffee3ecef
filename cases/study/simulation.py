"""The simulation of the full system (6) as the studies read it: reference, stable step, orders.

The weak order in the step has error bars; the standard error falls as the root of the samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, nan, sqrt
from time import process_time
from typing import Any, Literal, NamedTuple

import numpy as np

from cases.compare.compare import chance_l1, join_bins
from cases.compare.routes import all_routes
from cases.compare.stationary import answers_of
from cases.study.levels import time_call
from cases.study.orders import observed_orders
from fpk.answer.certificate import Measured
from fpk.answer.density import AnyDensity, Density, certify_density
from fpk.answer.method import Method, Result, Solves
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import Report
from sim.sample.settings import LEAST_PATHS
from sim.step.schemes import SCHEMES

LARGEST_FACTOR, SMALLEST_FACTOR = 4.0, 2.0**-10
"""Ratios to the chosen step that are tried: above the largest no scheme is stable in contact."""
SMALL_STEP = 0.25
"""Ratio to the chosen step below which runs have fewer paths and a slow trial is final."""
TRIAL = 0.4
"""Relaxation times of a trial, after one of burn-in: an unstable step is seen within one."""
REFERENCE_RELAXATIONS = 200.0
"""Sampled relaxation times of a simulation as reference: three times the longest compared run."""
SEED_STEP = 7919
"""Added to the seed for the reference, which must be independent of the runs that it judges."""
SECONDS = 10.0
"""Seconds of processor time for the runs of one scheme; fewer if the pilot resolves the order."""
SHARE_OF_A_TRIAL = 0.2
"""Share of ``SECONDS`` that a trial of one step may take; a slower scheme is not studied."""
LEVELS, FEW_LEVELS = 5, 4
"""Number of steps of a study; the second if they are small, as each then takes long, and for the
study in samples, each level of which takes four times as long."""
STEP_RATIO = sqrt(2.0)
"""Ratio of neighbouring steps: five levels then fit between the stable and the chosen step."""
PILOT = 4.0
"""Sampled relaxation times of a pilot run, after its burn-in."""
MIN_ORDER_SIGNAL = 2.0
"""Standard errors an error must exceed for an order to be given from it."""
ORDER_ERROR = 0.25
"""One standard error of the order that a study asks for; at twice as much it is not judged, as
neighbouring orders are not distinguished."""
ORDERS = np.linspace(0.25, 10.0, 391)
"""Orders r at which χ² is evaluated."""
KNOWN_LIMIT_ERROR = 1e-6
"""Standard error given to a known limit, relative to the smallest of the levels: negligible."""


class Reference(NamedTuple):
    """The density of the full system that answers are compared with.

    ``words`` name its method; ``given`` is its answer; ``density`` is the same, or the fit to it if
    it is sampled.
    """

    words: str
    density: Density
    given: AnyDensity


@dataclass(frozen=True)
class Run:
    """E q_i² of one simulation at the step ``dt``: its ``value`` with one standard ``error``.

    ``sampled`` is the sampled time of all paths, ``seconds`` the processor time.
    """

    dt: float
    value: float
    error: float
    sampled: float
    seconds: float


def displacement_of_study(system: System) -> Observable:
    """Return the studied displacement: of the first mass that touches a stop, else of the last."""
    index = system.contact_masses[0] if system.contact_masses else system.n - 1
    return (Coordinate("q", index),)


def square_name(system: System) -> str:
    """Return the name of the square of ``displacement_of_study``, such as ``q2²``."""
    return f"{observable_name(displacement_of_study(system))}²"


def time_simulation(
    system: System, method: MonteCarlo, observables: Sequence[Observable] = ()
) -> tuple[Run, Result]:
    """Run ``method``; return the run, q in E q² being ``displacement_of_study``, and the answer."""
    result, seconds = time_call(lambda: method.solve(system, observables))
    assert isinstance(result.report, Report)
    report, square = result.report, result.report.moments[square_name(system)]
    return Run(report.dt, square.value, square.error, report.paths * report.time, seconds), result


def largest_stable(system: System, method: MonteCarlo, *, patience: float) -> float | None:
    """Return the largest step, as a ratio to the chosen step, whose trial shows no instability.

    None if there is none down to ``SMALLEST_FACTOR``, or if an unstable trial below ``SMALL_STEP``
    takes more than ``patience`` seconds of processor time.
    """
    trial = replace(method, paths=LEAST_PATHS, relaxations=TRIAL, burn_in=1.0)
    factor = LARGEST_FACTOR
    while factor > SMALLEST_FACTOR:
        begin = process_time()
        try:
            time_simulation(system, replace(trial, step_factor=factor))
            return factor
        except InvalidInput as refusal:  # beyond the limit of stability
            if refusal.key != "dt":
                raise
        except NotCertified:
            if factor < SMALL_STEP and process_time() - begin > patience:
                return None
        factor /= sqrt(2.0) if factor > 2.0 * SMALL_STEP else 2.0
    return None


def deterministic(solves: Solves) -> list[Method]:
    """Return the quick methods without sampling that solve the "full" or an "averaged" equation."""
    routes = [r for r in all_routes() if r.solves == solves and not r.sampled and r.quick]
    return [route.make() for route in routes]


def best_answer(
    methods: Sequence[Method], system: System, observable: Observable, problems: list[str]
) -> tuple[str, AnyDensity] | None:
    """Return label and density of the certified answer with the least stated error, 0 if sampled.

    An answer that is not certified is taken if there is no other. Appends to ``problems`` the
    failed checks of the answer; without an answer the methods that failed, and returns None.
    """
    answers = answers_of(system, [observable], methods)
    offers = [
        (not d.certificate.certified, d.l1_error if isinstance(d, Density) else 0.0, route.label, d)
        for route, d in answers.densities(observable).items()
    ]
    if not offers:
        problems += [f"{r.route.label}: {r.reason}" for r in answers.refused if r.failed]
        return None
    *_, label, density = min(offers, key=lambda offer: offer[:2])
    problems += [f"{label}: {failure}" for failure in density.certificate.failures]
    return label, density


def full_density(system: System, observable: Observable) -> Reference | None:
    """Return a certified density of the full system that is not sampled, None if there is none."""
    answer = best_answer(deterministic("full"), system, observable, [])
    label, density = answer or ("", None)
    if isinstance(density, Density) and density.certificate.certified:
        return Reference(label, density, density)
    return None


def full_reference(system: System, *, seed: int) -> Reference:
    """Return the full system's p(q_i); if no route solves (6), by a long simulation.

    Its step is 0.7 of the chosen step, its seed follows from ``seed``. Raises ``NotCertified`` if
    that step is unstable.
    """
    observable = displacement_of_study(system)
    if known := full_density(system, observable):
        return known
    long = MonteCarlo(relaxations=REFERENCE_RELAXATIONS, seed=seed + SEED_STEP)
    method = replace(long, step_factor=sqrt(0.5))
    (sampled,) = method.solve(system, [observable]).densities
    assert isinstance(sampled, SampledDensity)
    few, own = join_bins(sampled), sampled.certificate
    measured = Measured(chance_l1(few)[0], None, None, own.residual, own.tail_mass)
    density = certify_density(
        observable, few.edges, sampled, lambda q: sampled.at(q)[1], measured=measured, tol=inf
    )
    return Reference("long simulation", density, sampled)


@dataclass(frozen=True)
class WeakOrder:
    """How E q_i² of one scheme depends on the step, from all steps in one regression.

    ``limit`` is the value at dt → 0: of the closed form if there is one (``known``), else of the
    fit ``limit + slope dtʳ`` with the order r of theory, whose χ² with ``freedom`` degrees is
    ``chi2``. ``order`` is the r of the best fit; between the two of ``order_error`` χ² rises by
    less than one. ``errors`` |E q²(dt) − limit| of each level have the standard errors
    ``error_bars``; ``orders`` are the orders of consecutive resolved errors, each with its standard
    error. ``wanted`` is the standard error of the levels that gives the order to ``ORDER_ERROR``,
    and ``short`` the factor by which the standard error of the levels is larger, at least 1.
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
        """Whether ``order_error`` reaches an end of ``ORDERS``: no order is known."""
        low, high = self.order_error
        return bool(low <= ORDERS[0] or high >= ORDERS[-1])


def weak_order(system: System, method: MonteCarlo, *, seconds: float) -> WeakOrder:
    """Return the weak order of the scheme of ``method``, spending about ``seconds`` on its steps.

    A pilot gives the factor by which its standard errors are too large for the order to be known to
    ``ORDER_ERROR``; the sample grows as the square of the factor, or until ``seconds`` of processor
    time are spent. The verdict is "unstable", without levels, if no step can be used.
    """
    theory = SCHEMES[method.scheme].weak_order
    unusable = WeakOrder(method.scheme, f"E {square_name(system)}", theory)
    first = largest_stable(system, method, patience=SHARE_OF_A_TRIAL * seconds)
    if first is None:
        return unusable
    exact = full_density(system, displacement_of_study(system))
    count, truth = LEVELS, exact.density.moment(2).value if exact else None
    if first < SMALL_STEP:  # only a large bias asks for such steps: it needs few paths to be seen
        method, count = replace(method, paths=LEAST_PATHS), FEW_LEVELS

    def result(relaxations: float) -> tuple[WeakOrder, float]:
        # Different seeds: the regression takes the values at different steps as independent.
        seed = method.seed + 1000 * ceil(relaxations)
        levels = [
            replace(
                method, relaxations=relaxations, step_factor=first / STEP_RATIO**k, seed=seed + k
            )
            for k in range(count)
        ]
        try:
            runs = [time_simulation(system, level)[0] for level in levels]
        except NotCertified:  # an unstable step
            return unusable, inf
        return with_order(unusable, runs, truth), sum(r.seconds for r in runs)

    order, taken = result(PILOT)
    # Burn-in costs once; where it takes all the time the pilot is all that there is.
    affordable = (seconds * (PILOT + method.burn_in) / taken - method.burn_in) / PILOT
    growth = min(order.short**2, affordable)
    return result(PILOT * growth)[0] if growth > 1.0 else order


def _chi2(points: Array, order: float) -> float:
    """Return χ² of the best line through the values over dtʳ, r the ``order``.

    ``points`` (3, n) are the steps dt, the values and their standard errors.
    """
    dt, value, error = points
    _, (chi2,), *_ = np.polyfit(dt**order, value, 1, w=1.0 / error, full=True)
    return float(chi2)


def with_order(scheme: WeakOrder, levels: Sequence[Run], truth: float | None) -> WeakOrder:
    """Return ``scheme`` with the order of its ``levels`` and its verdict.

    ``truth`` is the limit at dt = 0 if it is known. The verdict is "pre-asymptotic" if two standard
    errors of the profile (χ² + 4) exclude the order of theory, "not resolved" if the order is known
    to worse than twice ``ORDER_ERROR`` or the slope is below three of its standard errors.
    """
    dt, value, error = np.array([(run.dt, run.value, run.error) for run in levels]).T
    points = np.array([dt, value, error])
    if truth is not None:  # a value at dt = 0 with nearly no error
        points = np.column_stack([points, [0.0, truth, KNOWN_LIMIT_ERROR * error.min()]])
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
    elif abs(slope) < 3.0 * slope_error or max(order - low, high - order) > 2.0 * ORDER_ERROR:
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
    """Standard errors of E q_i² by sampled time, with their log-log slope, −1/2 in theory."""

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
    while len(levels) < FEW_LEVELS:
        levels.append(levels[-1].refined())
    runs = [time_simulation(system, level)[0] for level in levels]
    sampled, errors = tuple(r.sampled for r in runs), tuple(r.error for r in runs)
    weights = np.full(len(runs), sqrt(2.0 * 63.0))
    line, covariance = np.polyfit(np.log(sampled), np.log(errors), 1, w=weights, cov="unscaled")
    of = f"E {square_name(system)}"
    return SampleSlope(of, sampled, errors, float(line[0]), sqrt(covariance[0, 0]))
