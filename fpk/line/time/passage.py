"""First passage of one energy through a limit: moments, failure rate and probability of failure."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from fpk.arrays import EPS, SMALLEST, Array, Flags
from fpk.errors import InvalidInput
from fpk.evolution import BEYOND_RANGE, STARTS, Passage, StartCurve, certified_passage
from fpk.line.time.elements import ENRICHMENT, MOST_ROUNDS, Elements, cut, degree_for, meshed
from fpk.line.time.mesh import HIGHEST, NONE, layer_at, time_nodes
from fpk.line.time.propagation import Source
from fpk.line.time.resolvent import evolved, moment
from fpk.number import Number
from fpk.probe import probed
from fpk.process import Process

SAFETY = 3.0
"""Factor on the distance to the enriched solution."""
ROUND_OFF = 8.0
"""Roundings of sums along the chain, for each element and each unit of ln π from end to end."""
MOST_ELEMENTS = 3_000
"""Elements beyond which none is cut any more."""
FARTHEST = 900.0
"""Fall of ln(π H) from its maximum to the limit beyond which none is solved for: e^900 times."""
LARGEST_MEAN = 1e300
"""Mean times beyond it are out of the range of double precision in what is made of them."""
BRACKET = 1e-9
"""Relative distance of the two bounds of the failure rate that ends the iteration: the Rayleigh
quotient is then known to the square of it."""
MOST_STEPS = 2_000
"""Most iterations for the failure rate; a hundred do for a hundred masses."""
SAMPLES = np.array([0.0, 0.1, 0.35, 0.65, 0.9])
"""Points of an element, as shares of its length, at which the answer is compared."""


@dataclass(frozen=True, eq=False)
class Answers:
    """First passage of the right end of the last element, on one mesh in one degree."""

    elements: Elements
    more: int = 0

    @cached_property
    def mean(self) -> Array:
        """T: mean time of first passage over the start, L T = −1, (elements, functions)."""
        return moment(self.elements, self.elements.load)

    @cached_property
    def longest(self) -> float:
        """Mean time from H = 0, the longest."""
        return float(self.elements.at(np.zeros(1), self.mean)[0][0])

    @cached_property
    def second(self) -> Array:
        """(−L)⁻¹ T in units of the square of the longest T: half of the second moment."""
        unit = self.longest
        return moment(self.elements, self._load(self.mean / unit)) / unit

    @cached_property
    def rate(self) -> tuple[float, float]:
        """The least eigenvalue λ of −L, and an error of the iteration.

        By powers of (−L)⁻¹, which is positive: f/(−L)⁻¹f, at its largest and least, are bounds of
        λ (Barta), whatever its size; of the Rayleigh quotient the error is of second order.
        """
        e, f = self.elements, self.mean
        share = np.exp(e.log_scale - e.log_mass.max())  # what underflows counts nothing
        quotient = bracket = np.nan
        for _ in range(MOST_STEPS):
            f = f / f[0, 1]
            load = self._load(f)
            g = moment(e, load)
            quotient = float(share @ (load * f).sum(axis=1) / (share @ (load * g).sum(axis=1)))
            before, bracket = bracket, float(np.ptp(f[:, 0] / g[:, 0])) / quotient
            if bracket < BRACKET or (bracket < 1e-6 and not bracket < before):
                break
            f = g
        return quotient, quotient * bracket**2

    def _load(self, f: Array) -> Array:
        """∫π f f_i (elements, functions) in the units of the elements."""
        return np.asarray(np.einsum("eij,ej->ei", self.elements.mass, f))

    def failure(self, times: Array, x: Array) -> tuple[Array, Array]:
        """Return P(T <= t) (times, points) from the starts x, and its round-off."""
        e, later = self.elements, times > 0.0
        f = evolved(
            e, np.zeros(e.load.shape), times[later], held=1.0, more=self.more, density=False
        )
        p, size = np.zeros((2, times.size, x.size))
        p[later], size[later] = e.at(x, f.values, f.size)
        return p, EPS * size


@dataclass(frozen=True, eq=False)
class FirstPassage:
    """First passage of an energy through a ``limit`` with errors: ``answer`` and ``enriched``."""

    limit: float
    answer: Answers
    enriched: Answers

    @property
    def round_off(self) -> float:
        """Relative round-off of sums along the chain."""
        e = self.answer.elements
        return ROUND_OFF * EPS * (e.count + float(np.ptp(e.log_scale)) + e.degree)

    @cached_property
    def _coefficients(self) -> Array:
        """Error of T, by those of the coefficients, at the left ends of the elements.

        T = ∫dx/m ∫π: an element counts by what T falls over it, and by its mass in all below.
        """
        e, T = self.answer.elements, self.answer.mean
        mass = np.exp(e.log_mass - e.log_mass.max())
        below = np.cumsum(e.relative_error * mass) / np.maximum(np.cumsum(mass), SMALLEST)
        fall = T[:, 0] - T[:, 1]
        fall[0] = self.longest - T[0, 1]
        own = (e.relative_error + below + e.slope_error.sum()) * fall
        return np.asarray(own[::-1].cumsum()[::-1])

    @property
    def relative(self) -> float:
        """Relative error of the mean time from H = 0 by coefficients and round-off."""
        return float(self._coefficients[0]) / self.longest + self.round_off

    def mean(self, x: Array) -> tuple[Array, Array]:
        """Return the mean time from the starts x and its error."""
        a, b = self.answer, self.enriched
        (T, size), (better, _) = a.elements.at(x, a.mean), b.elements.at(x, b.mean)
        rounding = self._rounding(x) * T + self.round_off * size
        by_coefficients = self._coefficients[a.elements.element_of(x)]
        return T, SAFETY * np.abs(T - better) + rounding + by_coefficients

    def _rounding(self, x: Array) -> Array:
        """Relative round-off by that of the energies: T is about linear in H_f − x."""
        return ROUND_OFF * EPS * self.limit / np.maximum(self.limit - x, EPS * self.limit)

    @property
    def longest(self) -> float:
        """Mean time from H = 0."""
        return self.answer.longest

    def variance(self, x: Array) -> tuple[Array, Array]:
        """Return the variance of the time from the starts x in ``longest``², and its error."""
        a, b, unit = self.answer, self.enriched, self.longest
        (T, of_T), (U, of_U) = a.elements.at(x, a.mean / unit), a.elements.at(x, a.second)
        (better, _), (half, _) = b.elements.at(x, b.mean / unit), b.elements.at(x, b.second)
        value = 2.0 * U - T**2
        distance = np.abs(value - 2.0 * half * (b.longest / unit) ** 2 + better**2)
        # The variance is ∫dx/m ∫2 m T'² dy with T' = −∫π/m: no term of it cancels.
        error = SAFETY * distance + (3.0 * self.relative + self._rounding(x)) * value
        error += self.round_off * 2.0 * (value + of_U + T * of_T)
        return value, error

    def rate(self) -> tuple[float, float]:
        """Return the failure rate and its error."""
        (value, left), (better, other) = self.answer.rate, self.enriched.rate
        error = SAFETY * abs(value - better) + left + other + 2.0 * self.relative * value
        return value, error

    def failure(self, times: Array, x: Array) -> tuple[Array, Array]:
        """Return P(T <= t), (times, points), from the starts x and its error."""
        (p, rounding), (better, other) = (
            self.answer.failure(times, x),
            self.enriched.failure(times, x),
        )
        # At short times ln P ~ −(distance)²/(2 b t): so much more the coefficients count.
        steep = 2.0 - np.log(np.clip(np.abs(p), 1e-300, 1.0))
        error = SAFETY * np.abs(p - better) + 2.0 * self.relative * steep * np.abs(p)
        return p, error + ROUND_OFF * (rounding + other) + EPS**2


def first_passage(
    process: Process, limit: float, *, times: Array, tol: float = 1e-10, nodes: Array = NONE
) -> FirstPassage:
    """Return the first passage of ``limit`` > 0 with errors below ``tol`` where that is possible.

    Errors are relative ones of the moments and of the rate, absolute ones of the probability of
    failure at ``times`` >= 0. The mesh adapts; elements end at ``nodes``, too. Raises
    ``InvalidInput`` for a limit whose mean time is beyond double precision.
    """
    degree = degree_for(tol)
    beyond = InvalidInput("limit", limit, BEYOND_RANGE)
    later = times[times > 0.0]
    fine = (layer_at(process, limit, float(later.min())),) if later.size else ()
    probe = probed(process)
    log_mass = np.interp(math.log(limit), np.log(probe.energy), probe.log_mass)
    if not probe.log_mass.max() - log_mass < FARTHEST:
        raise beyond
    nodes = time_nodes(process, limit, degree, fine=fine, more=nodes)
    pair = meshed(process, nodes, degree)
    for _ in range(MOST_ROUNDS):
        # Sums to beyond the range are judged below.
        with np.errstate(over="ignore", invalid="ignore"):
            solved = FirstPassage(limit, Answers(pair[0]), Answers(pair[1], more=ENRICHMENT))
            longest = solved.longest
        if not longest < LARGEST_MEAN:
            raise beyond
        marked = _marked(solved, times, 0.25 * tol)
        if not marked.any() or marked.size > MOST_ELEMENTS:
            break
        pair = cut(process, pair, marked)
    return solved


def _marked(solved: FirstPassage, times: Array, wanted: float) -> Flags:
    """Elements whose part of the answer is not known to ``wanted``."""
    a, b = solved.answer.elements, solved.enriched.elements
    unit = np.exp(a.log_local - b.log_local)
    marked = np.zeros(a.count, dtype=bool)
    for own, better in ((a.conductance, b.conductance), (a.local_mass, b.local_mass)):
        marked |= np.abs(own * unit - better) > wanted * better
    if times.size:
        x = (a.left[:, None] + (a.right - a.left)[:, None] * SAMPLES).ravel()
        p, better = (a.failure(times, x)[0] for a in (solved.answer, solved.enriched))
        distance = np.abs(p - better)
        marked |= (distance.max(axis=0) > wanted).reshape(a.count, -1).any(axis=1)
    return np.asarray(marked)


def fem_passage(
    process: Process, limit: float, source: Source, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of the energy through ``limit`` from ``source`` below it.

    Of a density that begins beyond the limit in part, that part has failed at the time 0. Raises
    ``InvalidInput`` where the mean time is beyond double precision.
    """
    nodes = source.nodes(limit, HIGHEST)
    solved = first_passage(process, limit, times=times, tol=tol, nodes=nodes)
    e = solved.answer.elements
    # The means over the source by the points of the elements, and by those of the enriched ones.
    x, weights = source.samples(e)
    y, better = source.samples(solved.enriched.elements)
    unit, beyond = solved.longest, float(1.0 - weights.sum())
    off = 0.0 if source.process is None else solved.round_off

    def over(f: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array]:
        values, errors = f(np.append(x, y))
        mean, finer = values[..., : x.size] @ weights, values[..., x.size :] @ better
        distance = SAFETY * np.abs(mean - finer) + off * np.abs(mean)
        return mean, errors[..., : x.size] @ weights + distance

    mean, mean_error = map(float, over(solved.mean))
    share = mean / unit

    def spread(x: Array) -> tuple[Array, Array]:
        """(E T − mean)² − mean² of a start in units of the square of the longest mean time."""
        T, T_error = (a / unit for a in solved.mean(x))
        return T * (T - 2.0 * share), 2.0 * np.abs(T - share) * T_error

    (V, V_error), (W, W_error) = over(solved.variance), over(spread)
    starts = np.linspace(0.0, limit, STARTS)
    with np.errstate(over="ignore"):
        variance, variance_error, *variances = (
            a * unit * unit
            for a in (V + (W + share**2), V_error + W_error, *solved.variance(starts))
        )
    rate, rate_error = solved.rate()
    # Forward and backward equation are compared at the mean time where no other is asked for.
    compared = times if times.size else np.array([mean])
    failure, failure_error = over(partial(solved.failure, compared))
    failure = failure + beyond
    failure_error = failure_error + SAFETY * np.abs(weights.sum() - better.sum()) + off
    kept, residual = _forward(e, source, compared)
    settings: dict[str, str | float | int] = {
        "degree": e.degree, "elements": e.count, "tol": tol
    }  # fmt: skip
    if source.process is not None:
        settings["beyond the limit at the start"] = float(beyond)
    numbers = Number(mean, mean_error), Number(float(variance), float(variance_error))
    return certified_passage(
        (*numbers, Number(rate, rate_error)),
        times,
        failure[: times.size],
        failure_error[: times.size],
        tol=tol,
        mass_defect=float(np.abs(kept + failure - 1.0).max()),
        residual=residual,
        starts=StartCurve(starts, *solved.mean(starts), *variances),
        settings=settings,
    )


def _forward(e: Elements, source: Source, times: Array) -> tuple[Array, float]:
    """Return ∫p at ``times`` where the limit absorbs, by the forward equation, and its residual."""
    later = times > 0.0
    load = source.load(e)
    g = evolved(e, load, times[later], held=0.0)
    mass = np.full(times.size, load[:, :2].sum())
    mass[later] = np.einsum("tei,ei->t", g.values, e.load)
    return mass, g.residual
