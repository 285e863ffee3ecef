"""Compiled readers of traces: upcrossings of levels, and times of first passage.

Between two steps displacements are cubics through (q, v) at both ends, energies Brownian bridges.
"""

from collections.abc import Callable
from functools import lru_cache, partial, wraps
from typing import Any, NamedTuple

import numpy as np

from fpk.answer.names import Limit
from fpk.numeric.arrays import SMALLEST, Array, Integers
from fpk.numeric.compiling import cached_njit, njit_inline
from fpk.system.linear import natural_modes
from fpk.system.modulation import Modulation
from fpk.system.system import System
from sim.questions.limits import energies_of, modal_rates, values_at
from sim.sample.ensemble import Reader
from sim.step.arrays import W
from sim.step.kernel import kernel_checksum
from sim.step.lanes import quadratic_form

Cubic = tuple[float, float, float, float]


@njit_inline
def cubic_of(q0: float, v0: float, q1: float, v1: float, h: float) -> Cubic:
    """Return the coefficients of 1, s, s², s³, s = t/``h``, of the cubic by q, v at t = 0 and h."""
    change = q1 - q0
    return q0, h * v0, 3.0 * change - h * (2.0 * v0 + v1), h * (v0 + v1) - 2.0 * change


@njit_inline
def value_of(c: Cubic, s: float) -> float:
    """Return the cubic ``c`` at ``s``."""
    value: float = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    return value


@njit_inline
def turning_points(c: Cubic) -> tuple[float, float]:
    """Return the zeros of q'(s) within (0, 1), ascending; 1 in place of a missing zero."""
    a, b, d = 3.0 * c[3], c[2], c[1]  # a s² + 2 b s + d
    square = b * b - a * d
    if square <= 0.0:
        return 1.0, 1.0
    # Both roots without cancellation.
    far = -(b + np.copysign(np.sqrt(square), b))
    s1 = d / far if far != 0.0 else 1.0
    s2 = far / a if a != 0.0 else 1.0
    s1 = s1 if 0.0 < s1 < 1.0 else 1.0
    s2 = s2 if 0.0 < s2 < 1.0 else 1.0
    return min(s1, s2), max(s1, s2)


@njit_inline
def distance_to(limit: float, H: float, variance: float, growth: float, at_rest: float) -> float:
    """Return ∫dH/σ from ``H`` to the ``limit``, for σ² that is linear in H; <= 0 beyond the limit.

    σ² is ``variance`` at H, and its slope is β = ``growth``/σ², or ``at_rest`` if σ = 0.
    """
    beta = growth / variance if growth > 0.0 else at_rest
    e = variance / beta
    return float(2.0 * (np.sqrt(max(e + limit - H, 0.0)) - np.sqrt(e)) / np.sqrt(beta))


@njit_inline
def cubic_passage(c: Cubic, low: float, high: float) -> float:
    """Return the first s in (0, 1] with q(s) <= ``low`` or >= ``high``, q(0) between; 2 if none."""
    turning, before = turning_points(c), 0.0
    for end in (turning[0], turning[1], 1.0):
        value = value_of(c, end)
        if min(high - value, value - low) <= 0.0:
            after = end
            for _ in range(30):  # to 1e-9 of the step
                middle = 0.5 * (before + after)
                value = value_of(c, middle)
                if min(high - value, value - low) <= 0.0:
                    after = middle
                else:
                    before = middle
            return after
        before = end
    return 2.0


NEGLIGIBLE_NATS = 40.0
"""−ln of a probability that is neglected: 4e-18."""


class Diffusion(NamedTuple):
    """Diffusion of energies, dH = … + σ dB, as quadratic forms of the momenta p, or of one p_i."""

    variance: Array  # (limits, n, n), F of σ² = pᵀ F p
    growth: Array  # (limits, n, n), G of β σ² = pᵀ G p, see ``distance_to``
    at_rest: Array  # (limits,), β for p = 0
    of_momentum: Array  # (limits,), the constant σ of p_i, −σ at a lower limit; of energies 0


def reader(function: Callable[..., None]) -> Reader:
    """Return ``function``, compiled at its first call with the disk cache of its sources."""
    compiled = cached_njit(kernel_checksum())(function)

    @wraps(function)  # of a module: another process finds it by its name
    def read(*arrays: Any, **numbers: Any) -> None:
        compiled(*arrays, **numbers)

    return read


@njit_inline
def count_rise(counts: Integers, levels: Array, low: float, high: float) -> None:
    """Change ``counts``: 1 more in its running sum at each of ``levels`` in (``low``, ``high``]."""
    if high <= levels[0] or low >= levels[-1] or not low < high:
        return
    begin, end = np.searchsorted(levels, low, "right"), np.searchsorted(levels, high, "right")
    if end > begin:
        counts[begin] += 1
        counts[end] -= 1


@reader
def count_upcrossings(
    trace: Array, samples: int, done: int, counts: Integers, dt: float, row: int, momentum: int,
    inverse_mass: float, levels: Array,
) -> None:  # fmt: skip
    """Add to ``counts`` (blocks, levels + 1), whose running sums are upcrossings of the ``levels``.

    A ``Reader``; ``done`` is not used. Levels ascend. q and p are the rows ``row``, ``momentum`` of
    ``trace``, v = ``inverse_mass`` · p. Every rising part of the cubic between two of the
    ``samples`` + 1 states, ``dt`` apart, counts.
    """
    for b in range(trace.shape[0]):
        own = counts[b]
        for k in range(samples):
            q0, q1 = trace[b, k, row], trace[b, k + 1, row]
            p0, p1 = trace[b, k, momentum], trace[b, k + 1, momentum]
            for w in range(W):
                v0, v1 = inverse_mass * p0[w], inverse_mass * p1[w]
                change = q1[w] - q0[w]
                # A cubic with these slopes is monotone (de Boor and Swartz).
                if min(v0, v1) >= 0.0 and dt * max(v0, v1) <= 3.0 * change:
                    count_rise(own, levels, q0[w], q1[w])
                elif max(v0, v1) > 0.0 or dt * min(v0, v1) < 3.0 * change:
                    cubic, before = cubic_of(q0[w], v0, q1[w], v1, dt), q0[w]
                    for s in turning_points(cubic):
                        value = value_of(cubic, s)
                        count_rise(own, levels, before, value)
                        before = value
                    count_rise(own, levels, before, q1[w])


@reader
def pass_displacement(
    trace: Array, samples: int, done: int, time: Array, chance: Array, dt: float, begin: float,
    row: int, momentum: int, inverse_mass: float, low: float, high: float,
) -> None:  # fmt: skip
    """Write the time when q first leaves (``low``, ``high``) to ``time`` (blocks, 1, LANES), if inf
    there.

    A ``Reader``; ``chance`` is not used. q and p are the rows ``row``, ``momentum`` of ``trace``, v
    = ``inverse_mass`` · p; the states ``done`` to ``done`` + ``samples`` lie ``dt`` apart, number 0
    at the time ``begin``.
    """
    for b in range(trace.shape[0]):
        own = time[b, 0]
        for k in range(samples):
            q0, q1 = trace[b, k, row], trace[b, k + 1, row]
            p0, p1 = trace[b, k, momentum], trace[b, k + 1, momentum]
            # A cubic exceeds the larger of its ends by 4/27 · h (|v0| + |v1|) at most.
            slope = 4.0 / 27.0 * dt * inverse_mass
            for w in range(W):
                most = slope * (abs(p0[w]) + abs(p1[w]))
                near = min(q0[w], q1[w]) - most <= low or max(q0[w], q1[w]) + most >= high
                if near and own[w] == np.inf:
                    v0, v1 = inverse_mass * p0[w], inverse_mass * p1[w]
                    share = cubic_passage(cubic_of(q0[w], v0, q1[w], v1, dt), low, high)
                    if share <= 1.0:
                        own[w] = begin + (done + k + share) * dt


@reader
def pass_energies(
    trace: Array, samples: int, done: int, time: Array, chance: Array, dt: float, begin: float,
    first: int, rows: Integers, limits: Array, diffusion: Diffusion, spread: Array,
) -> None:  # fmt: skip
    """Write the time when an energy first passes its limit to ``time`` (blocks, 1, LANES), if less.

    Energies are the ``rows`` (limits,) of ``trace``, momenta the rows from ``first``; times of the
    samples follow from ``done``, ``dt`` and ``begin``. A momentum may take the place of an energy.
    Between samples the distance d (``distance_to``) is a Brownian bridge, which reaches 0 with the
    probability exp(−2 d0 d1/h), h in ``spread`` (samples,) being ∫e² dt, at the share d0/(d0 +
    |d1|) of the step. A limit is passed when the sum of −ln(1 − probability) exceeds its
    exponential number in ``chance`` (blocks, limits, LANES), from which the sum is subtracted in
    place: at another step the same motion passes at nearly the same time.
    """
    variance, rise, before, after = np.empty(W), np.empty(W), np.empty(W), np.empty(W)
    for b in range(trace.shape[0]):
        own = time[b, 0]
        for m in range(rows.size):
            left, limit, sigma = chance[b, m], limits[m], diffusion.of_momentum[m]
            for k in range(samples + 1):
                state = trace[b, k].reshape(trace.shape[2] * W)
                quadratic_form(variance, state, first, diffusion.variance[m])
                quadratic_form(rise, state, first, diffusion.growth[m])
                H = trace[b, k, rows[m]]
                near, h = 0, spread[max(k - 1, 0)]
                for w in range(W):
                    if sigma != 0.0:
                        after[w] = (limit - H[w]) / sigma
                    else:
                        at_rest = diffusion.at_rest[m]
                        after[w] = distance_to(limit, H[w], variance[w], rise[w], at_rest)
                    near += 2.0 * before[w] * after[w] < NEGLIGIBLE_NATS * h
                if k > 0 and near > 0:
                    end = begin + (done + k) * dt
                    for w in range(W):
                        # If several limits are passed in a step, the first counts.
                        if own[w] > end - dt:
                            nats = 2.0 * before[w] * after[w] / h
                            if 0.0 < nats < NEGLIGIBLE_NATS:
                                left[w] += np.log1p(-np.exp(-nats))
                            if nats <= 0.0 or left[w] <= 0.0:
                                share = before[w] / (before[w] + abs(after[w]))
                                own[w] = min(own[w], end - dt * (1.0 - share))
                before[:] = after


def diffusion_of(system: System, limit: Limit) -> Diffusion:
    """Return the diffusion of the energies or the velocity that ``limit`` is on by N = f D fᵀ.

    For H, F = 2 M⁻¹ N M⁻¹ and G = 8 M⁻¹ N M⁻¹ N M⁻¹; for a mode of shape T_m the same with its own
    momentum; for v_i at each of ``limit.ends`` σ² = 2 N_ii of p_i; empty for q_i. If no noise
    reaches an energy or a velocity, the distance to its limit is huge.
    """
    N = system.noise_matrix
    if limit.kind == "v":
        sigma = np.sqrt(max(2.0 * float(N[limit.row, limit.row]), SMALLEST))
        sides = np.where(np.array(limit.ends) == limit.bounds[1], sigma, -sigma)
        none = np.zeros((sides.size, system.n, system.n))
        return Diffusion(none, none, 0.0 * sides, sides)
    if limit.kind == "H":
        mobility = np.diag(1.0 / system.mass)
        F = (2.0 * mobility @ N @ mobility)[None]
        G = (8.0 * mobility @ N @ mobility @ N @ mobility)[None]
    else:
        T = natural_modes(system)[0].T[[c.row for c in energies_of(limit, system.n)]]
        F = 2.0 * modal_rates(system, limit, N)[:, None, None] * T[:, :, None] * T[:, None, :]
        G = 4.0 * modal_rates(system, limit, N)[:, None, None] * F
    trace_f, trace_g = (np.trace(form, axis1=1, axis2=2) for form in (F, G))
    at_rest = np.maximum(trace_g / np.maximum(trace_f, SMALLEST), SMALLEST)
    return Diffusion(F, G, at_rest, np.zeros_like(at_rest))


@lru_cache(maxsize=64)  # the same for all blocks
def spread_of(
    modulation: Modulation | None, dt: float, done: int, samples: int, begin: float = 0.0
) -> Array:
    """Return ∫e² dt over each of ``samples`` steps ``dt``, after ``done`` steps from ``begin``.

    It is > 0 even if e = 0. The array (samples,) is cached: do not change it.
    """
    if modulation is None:
        return np.full(samples, dt)
    begins = begin + dt * np.arange(done, done + samples, dtype=float)
    return np.maximum(dt * modulation.mean_square(begins, dt), SMALLEST)


def pass_under(
    trace: Array, samples: int, done: int, *arrays: Array, modulation: Modulation | None,
    dt: float, begin: float, **known: Any,
) -> None:  # fmt: skip
    """Call ``pass_energies`` with the ∫e² dt of the steps in ``trace``; a ``Reader``.

    ``samples`` steps ``dt`` after ``done`` steps from the time ``begin``.
    """
    spread = spread_of(modulation, dt, done, samples, begin)
    pass_energies(trace, samples, done, *arrays, dt=dt, begin=begin, spread=spread, **known)


def reader_of(system: System, limit: Limit, dt: float, begin: float = 0.0) -> Reader:
    """Return the reader of first passage of ``limit``, for samples ``dt`` apart from ``begin`` on.

    Its arrays are ``time`` and ``chance``, see ``pass_energies``.
    """
    n, known = system.n, dict[str, Any](dt=dt, begin=begin)
    if limit.kind == "q":
        known |= dict(zip(("low", "high"), limit.bounds, strict=True))
        known |= {"inverse_mass": 1.0 / float(system.mass[limit.row])}
        return partial(pass_displacement, row=limit.row, momentum=n + limit.row, **known)
    known |= {"modulation": system.modulation, "diffusion": diffusion_of(system, limit)}
    values = values_at(system, limit)
    rows = np.arange(2 * n, 2 * n + values.size)
    if limit.kind == "v":
        rows[:] = n + limit.row
    return partial(pass_under, first=n, rows=rows, limits=values, **known)
