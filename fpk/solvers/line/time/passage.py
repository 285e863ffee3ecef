"""First passage of one energy through a limit: moments, failure rate and probability of failure.

Under constant noise the backward equation is solved, for all starts at once; under modulated noise
the forward equation, whose mass is P(T > t).
"""

import math
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.answer.dynamics import BEYOND_RANGE, START_POINTS, Passage, certify_passage
from fpk.answer.quantities import Number
from fpk.numeric.arrays import EPS, LARGEST_LOG, ROUNDINGS, SMALLEST, Array, Flags
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.line.mesh import MAX_ELEMENT_DEGREE, layer_at, probe_process, time_nodes
from fpk.solvers.line.time import elements as chain
from fpk.solvers.line.time import modulated
from fpk.solvers.line.time.elements import Elements, Pair
from fpk.solvers.line.time.resolvent import chain_potential, inverse_laplace
from fpk.solvers.line.time.transition import Source, pose_question
from fpk.system.modulation import Modulation
from fpk.system.process import Process

MAX_POWER_STEPS = 2_000
"""Largest number of power iterations for the failure rate; a hundred masses take a hundred."""
MODULATED_SHARE = 0.1
"""Tolerance of mesh and steps under modulated noise, over the tolerance of the answer: variances
have larger errors than densities."""


@dataclass(frozen=True, eq=False)
class FirstPassage:
    """First passage of an energy through ``limit``, solved on a pair of chains that end there.

    Times are given for starts x below the limit. ``longest`` is the unit of moments.
    """

    limit: float
    pair: Pair

    @cached_property
    def means(self) -> list[Array]:
        """Mean time T until passage as a function of the start, L T = −1, T = 0 at the limit:
        coefficients (elements, functions) on each chain."""
        return [chain_potential(e, e.load) for e in self.pair]

    @cached_property
    def longest(self) -> float:
        """Mean time until passage from H = 0."""
        return float(self.pair[0].at(np.zeros(1), self.means[0])[0][0])

    @property
    def round_off(self) -> float:
        """Relative round-off of sums along the chain."""
        e = self.pair[0]
        return ROUNDINGS * EPS * (e.count + e.log_range + e.degree)

    @cached_property
    def _coefficients(self) -> Array:
        """Absolute error of T at the left ends of the elements by the errors of the coefficients.

        T = ∫dx/m ∫π: the error of 1/m in an element is weighted by the fall of T over it, the error
        of π by its mass.
        """
        e, T = self.pair[0], self.means[0]
        mass = np.exp(e.log_mass - e.log_mass.max())
        below = np.cumsum(e.relative_error * mass) / np.maximum(np.cumsum(mass), SMALLEST)
        fall = np.append(self.longest, T[1:, 0]) - T[:, 1]
        own = (e.relative_error + below + e.slope_error.sum()) * fall
        return np.asarray(own[::-1].cumsum()[::-1])

    @property
    def relative(self) -> float:
        """Relative error of the mean time from H = 0 by the coefficients and round-off."""
        return float(self._coefficients[0]) / self.longest + self.round_off

    def moments(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return mean, its error, variance, its error for starts ``x``, (points,) each. Mean and
        error are in units of ``longest``, variance and error in units of its square."""
        values = []
        for e, mean in zip(self.pair, self.means, strict=True):
            f = mean / self.longest
            # (−L)⁻¹ T is half of the second moment.
            half = chain_potential(e, np.einsum("eij,ej->ei", e.mass, f)) / self.longest
            values += [*e.at(x, f), *e.at(x, half)]
        T, of_T, U, of_U, better, _, half, _ = values
        # T is nearly linear in limit − x, which has the round-off of energies.
        rounding = ROUNDINGS * EPS * self.limit / np.maximum(self.limit - x, EPS * self.limit)
        error = DISTANCE_FACTOR * np.abs(T - better) + rounding * T + self.round_off * of_T
        error += self._coefficients[self.pair[0].within(x)[0]] / self.longest
        V = 2.0 * U - T**2
        distance = np.abs(V - 2.0 * half + better**2)
        # The variance is ∫dx/m ∫2 m T'² dy with T' = −∫π/m: no terms cancel.
        V_error = DISTANCE_FACTOR * distance + (3.0 * self.relative + rounding) * V
        return T, error, V, V_error + self.round_off * 2.0 * (V + of_U + T * of_T)

    def rate(self) -> tuple[float, float]:
        """Return the failure rate, the smallest eigenvalue λ of −L, and its absolute error.

        Power iteration with (−L)⁻¹, a positive operator: the largest and smallest value of
        f/(−L)⁻¹f bound λ (Barta). The relative error of the Rayleigh quotient is the square of the
        relative distance of these bounds.
        """
        found = []
        for e, f in zip(self.pair, self.means, strict=True):
            share = np.exp(e.log_scale - e.log_mass.max())  # may underflow to 0
            quotient = bracket = np.nan
            for _ in range(MAX_POWER_STEPS):
                f = f / f[0, 1]
                load = np.einsum("eij,ej->ei", e.mass, f)
                g = chain_potential(e, load)
                quotient = float(share @ (load * f).sum(axis=1) / (share @ (load * g).sum(axis=1)))
                before, bracket = bracket, float(np.ptp(f[:, 0] / g[:, 0])) / quotient
                if bracket < 1e-9 or (bracket < 1e-6 and not bracket < before):
                    break
                f = g
            found.append((quotient, quotient * bracket**2))
        (value, left), (better, other) = found
        distance = DISTANCE_FACTOR * abs(value - better)
        return value, distance + left + other + 2.0 * self.relative * value

    def failures(self, times: Array, x: Array) -> tuple[Array, Array]:
        """Return P(T <= t) at ``times`` from starts ``x`` by both chains, and the sum of the sizes
        of its terms: two arrays (2, times, points), 0 for t <= 0."""
        p, size = np.zeros((2, 2, times.size, x.size))
        later = times > 0.0
        for k, e in enumerate(self.pair):
            nothing, more = np.zeros(e.load.shape), k * ENRICHMENT
            f = inverse_laplace(e, nothing, times[later], held=1.0, more=more, density=False)
            p[k, later], size[k, later] = e.at(x, f.values, f.size)
        return p, size

    def failure(self, times: Array, x: Array) -> tuple[Array, Array]:
        """Return P(T <= t) at ``times`` from starts ``x``, and its error, (times, points) each."""
        (p, better), size = self.failures(times, x)
        error = DISTANCE_FACTOR * np.abs(p - better) + _by_coefficients(2.0 * self.relative, p)
        return p, error + ROUNDINGS * EPS * size.sum(axis=0) + EPS**2


def _by_coefficients(relative: float, failure: Array) -> Array:
    """Absolute error of P(T <= t) = ``failure`` by a ``relative`` error of the coefficients. At
    short times ln P ~ −(distance)²/(2 b t), so that it is amplified by ln P."""
    steep = 2.0 - np.log(np.clip(np.abs(failure), SMALLEST, 1.0))
    return np.asarray(relative * steep * np.abs(failure))


def chain_first_passage(
    process: Process, limit: float, times: Array, tol: float = 1e-10, source: Source | None = None
) -> FirstPassage:
    """Return the first passage of ``limit`` > 0, with errors below ``tol`` if possible.

    The mesh is refined for ``tol``, relative for moments and rate, absolute for P(T <= t) at
    ascending ``times``. If ``source`` is a density, nodes resolve it; the answer is not averaged
    over it. Raises ``InvalidInput`` for a limit whose mean time is beyond double precision, and as
    ``probe_process`` does.
    """
    degree, wanted = chain.degree_for(tol), 0.25 * tol
    beyond, probe = InvalidInput("limit", limit, BEYOND_RANGE), probe_process(process)
    log_mass = np.interp(math.log(limit), np.log(probe.energy), probe.log_mass)
    # The mean time is about e^fall relaxation times; this bounds the mesh before it is computed.
    if not probe.log_mass.max() - log_mass < 2.0 * LARGEST_LOG:
        raise beyond
    fine = [layer_at(process, limit, time) for time in times[times > 0.0][:1]]
    more = source.nodes(limit, MAX_ELEMENT_DEGREE) if source else ()
    nodes = time_nodes(process, limit, degree, fine=fine, more=more)

    def solved(pair: Pair) -> tuple[FirstPassage, Flags]:
        # Sums may overflow; the limit is then refused below.
        with np.errstate(over="ignore", invalid="ignore"):
            answer = FirstPassage(limit, pair)
            longest = answer.longest
        if not longest < 1e300:  # beyond it the rate loses digits
            raise beyond
        a, b = pair
        unit = np.exp(a.log_local - b.log_local)
        marked = np.zeros(a.count, dtype=bool)
        masses = (e.load[:, :2].sum(axis=1) for e in pair)
        for own, better in ((a.conductance, b.conductance), masses):
            marked |= np.abs(own * unit - better) > wanted * better
        if times.size:
            p, better = answer.failures(times, panel_rule(a.nodes, 5)[0].ravel())[0]
            distance = np.abs(p - better).max(axis=0)
            marked |= (distance > wanted).reshape(a.count, -1).any(axis=1)
        return answer, marked

    return chain.solve_with_refinement(chain.element_pair(process, nodes, degree), solved)


def fem_passage(
    process: Process, limit: float, source: Source, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of the energy through ``limit`` from ``source`` below it.

    For ``times`` and ``tol`` see ``chain_first_passage``. The part of an initial density beyond the
    limit has failed at time 0. Raises as ``chain_first_passage`` does.
    """
    solved = chain_first_passage(process, limit, times=times, tol=tol, source=source)
    e, unit = solved.pair[0], solved.longest
    # Means over the source by the points of both chains.
    (x, weights), (y, better) = (source.samples(each) for each in solved.pair)
    beyond, off = float(1.0 - weights.sum()), 0.0 if source.process is None else solved.round_off
    starts, both = np.linspace(0.0, limit, START_POINTS), x.size + y.size

    def over(values: Array, errors: Array) -> tuple[Array, Array]:
        mean, finer = values[..., : x.size] @ weights, values[..., x.size : both] @ better
        distance = DISTANCE_FACTOR * np.abs(mean - finer) + off * np.abs(mean)
        return mean, errors[..., : x.size] @ weights + distance

    T, T_error, V, V_error = solved.moments(np.concatenate([x, y, starts]))
    share, share_error = map(float, over(T, T_error))
    # Law of total variance: E Var(T|x) + Var E(T|x), the latter as E m(m − 2 mean) + mean².
    own, own_error = over(V, V_error)
    spread, spread_error = over(T * (T - 2.0 * share), 2.0 * np.abs(T - share) * T_error)
    total, total_error = own + (spread + share**2), own_error + spread_error
    with np.errstate(over="ignore"):
        variance = Number(float(total * unit * unit), float(total_error * unit * unit))
        curves = T * unit, T_error * unit, V * unit * unit, V_error * unit * unit
    mean = Number(share * unit, share_error * unit)
    # Forward and backward equation are compared at ``times``, or at the mean time without any.
    compared = times if times.size else np.array([mean.value])
    failure, failure_error = over(*solved.failure(compared, np.append(x, y)))
    failure = failure + beyond
    failure_error = failure_error + DISTANCE_FACTOR * np.abs(weights.sum() - better.sum()) + off
    # ∫p with an absorbing limit, by the forward equation.
    load, later = source.load(e), compared > 0.0
    g = inverse_laplace(e, load, compared[later], held=0.0)
    kept = np.full(compared.size, load[:, :2].sum())
    kept[later] = np.einsum("tei,ei->t", g.values, e.load)
    settings = {"degree": e.degree, "elements": e.count, "tol": tol}
    if source.process is not None:
        settings["beyond the limit at the start"] = beyond
    return certify_passage(
        (mean, variance, Number(*solved.rate())),
        times,
        failure[: times.size],
        failure_error[: times.size],
        tol=tol,
        mass_defect=float(np.abs(kept + failure - 1.0).max()),
        residual=g.residual,
        starts=[starts, *(a[both:] for a in curves)],
        settings=settings,
    )


def passage_with_modulation(
    under: modulated.Processes,
    modulation: Modulation,
    source: Source,
    limit: float,
    times: Array,
    *,
    tol: float,
) -> Passage:
    """Return the first passage of ``limit`` from ``source`` under modulated noise.

    At the factor e(t)² on the noise intensity, e the ``modulation``, the process is ``under(e²)``.
    P(T > t) at ``times`` is the mass of the forward solution with p = 0 at the limit. The failure
    rate is the rate under the constant noise after the end of the modulation. If this noise is 0,
    moments are infinite, and there is no failure rate. For ``tol`` see ``chain_first_passage``.
    Raises as that function and ``quiet_until`` do, and ``NotApplicable`` if there is never any
    noise, or if damping feeds energy in at the limit while there is none.
    """
    unit, last = modulation.largest, modulation.last
    quiet = modulated.quiet_until(modulation, source)
    if unit == 0.0:
        raise NotApplicable("there is no noise at any time: nothing passes a limit")
    if modulation.times.size == 1:
        return fem_passage(under(last), limit, source, times, tol=tol)
    process = under(unit)
    at_limit = process.coefficients(np.array([limit]))
    if float(modulation.factor.min()) == 0.0 and at_limit.dissipation[0] > 0.0:
        words = "damping feeds energy in at the limit: while there is no noise, no mesh sees it"
        raise NotApplicable(words)
    modulation, asked = modulation.after(quiet), np.maximum(times - quiet, 0.0)
    end = float(modulation.times[-1])
    asked = asked if last else np.minimum(asked, end)
    stops = np.unique([0.0, *asked, end])
    later = chain_first_passage(under(last), limit, stops[:0], 0.01 * tol) if last else None
    first = float(modulation.energy(stops[1])) / unit

    def carried(e: Elements, level: int) -> modulated.Carried:
        """p at the stops > 0; P(T > t) at all stops, E T and E T² in one array; the errors (2,) of
        E T and E T² that ``later`` states, 0 if it is None.

        The steps are halved ``level`` times. The moments are ∫P(T > t) dt and ∫2t P(T > t) dt up to
        the end t_e of the modulation, plus E τ and E(2 t_e τ + τ²) of the remaining time τ over the
        density at t_e.
        """
        load, steps = source.load(e), partial(modulated.radau_steps, level=level, absorbing=True)
        g, t, weight, mass = steps(e, load, modulation, unit, stops[1:])
        kept = np.append(load[:, :2].sum(), np.einsum("tei,ei->t", g.values, e.load))
        density = weight * mass * (t <= end)
        moments, lost = np.array([density.sum(), 2.0 * density @ t]), np.zeros(2)
        if later is not None:
            x, longest = e.x.ravel(), later.longest
            p = g.density(x)[0][np.searchsorted(stops[1:], end)] * e.weight.ravel()
            T, T_error, V, V_error = later.moments(x)
            of_square = 2.0 * T * T_error + V_error
            with np.errstate(over="ignore"):
                one = np.array([p @ T, np.abs(p) @ T_error]) * longest
                two = np.array([p @ (T**2 + V), np.abs(p) @ of_square]) * longest * longest
            moments += [one[0], 2.0 * end * one[0] + two[0]]
            lost += [one[1], 2.0 * end * one[1] + two[1]]
        return g, np.append(kept, moments), lost

    solved, found = modulated.halve_steps(
        *pose_question(process, source, first, MODULATED_SHARE * tol, limit=limit),
        carried,
        lambda moved, numbers: float(np.max(moved / np.maximum(numbers, 1.0))),
        MODULATED_SHARE * tol,
    )
    e, (numbers, longer, both) = solved.elements, (each[1] for each in found)
    # Changes by twice as long steps and by a higher degree, added as they could cancel.
    error = DISTANCE_FACTOR * (np.abs(numbers - longer) + np.abs(longer - both))
    failure, at = 1.0 - numbers[:-2], np.searchsorted(stops, asked)
    relative = 2.0 * e.coefficient_error(source.energy)
    relative += ROUNDINGS * EPS * (e.count + e.log_range)
    failure_error = error[:-2] + _by_coefficients(relative, failure) + ROUNDINGS * EPS
    mean = variance = Number(np.inf, np.inf)
    if later is not None:
        mean_time, mean_square = numbers[-2:].tolist()
        lost = error[-2:] + found[0][2] + 2.0 * relative * numbers[-2:]
        time_error, square_error = lost.tolist()
        mean = Number(mean_time + quiet, time_error)
        variance_error = square_error + 2.0 * mean_time * time_error
        variance = Number(mean_square - mean_time**2, variance_error)
    return certify_passage(
        (mean, variance, Number(*later.rate()) if later else None),
        times,
        failure[at],
        failure_error[at],
        tol=tol,
        residual=found[0][0].residual,
        settings={**solved.settings, "tol": tol},
    )
