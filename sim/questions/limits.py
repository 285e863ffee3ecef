"""Limits of first passage as tests of states, and steps short enough to see what is between two."""

from collections.abc import Iterator
from functools import partial
from math import ceil, inf, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np

from fpk.answer.names import REST, Coordinate, Limit, Start
from fpk.numeric.arrays import ROUND_OFF, Array, Flags
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.linear import diffusion_matrix, drift_matrix, natural_modes
from fpk.system.system import System, effects_of
from sim.sample.histogram import values_of
from sim.sample.settings import Settings
from sim.step import step_size
from sim.step.schemes import SCHEMES, flow_covariance


def energies_of(limit: Limit, n: int) -> tuple[Coordinate, ...]:
    """Return the energies that must be observed to see ``limit`` passed."""
    if limit.kind == "q":
        return ()
    modes = [Coordinate("H", m) for m in range(n) if f"H{m + 1}" in limit.values]
    return tuple(modes) or (Coordinate("H"),)


def energies_at(system: System, limit: Limit) -> Array:
    """Return the limits as of ``energies_of``; of q the least potential energy at either side."""
    if limit.kind != "q":
        return np.array([limit.values[str(c)] for c in energies_of(limit, system.n)])
    i, springs = limit.observable(system.n)[0].row, 0.5 * limit.value**2
    contact = [float(system.contact_energy(i, side * limit.value)) for side in (1.0, -1.0)]
    return springs / float(system.compliance[i, i]) + np.array(contact)


def beyond(system: System, limit: Limit, q: Array, p: Array) -> Flags:
    """Return which states q, p (paths, n) are at or beyond the limit, to the round-off of H."""
    if limit.kind == "q":
        return np.asarray(np.abs(q[:, limit.observable(system.n)[0].row]) >= limit.value)
    reached = (1.0 - ROUND_OFF) * energies_at(system, limit)
    H = [values_of(system, c, q, p) for c in energies_of(limit, system.n)]
    return np.asarray(np.any(np.transpose(H) >= reached, axis=1))


def modal_rates(system: System, limit: Limit, matrix: Array) -> Array:
    """Return T_m' ``matrix`` T_m (modes,) of the modes m whose energies ``limit`` is on."""
    T = natural_modes(system)[0][:, [c.row for c in energies_of(limit, system.n)]]
    return np.asarray(np.einsum("im,ij,jm->m", T, matrix, T))


def largest_energy(system: System, start: Start) -> float:
    """Return the energy up to which the start reaches, without that of its own noise."""
    if start.kind == "state":
        return float(system.hamiltonian(*start.state(system.n)))
    if start.kind == "noise" and not start.rest:
        if (kT := step_size.temperature(system)) == inf:
            raise NotApplicable("some motion is not damped: no stationary state to start from")
        return step_size.REACHED * start.values["noise"] * kT
    return float(sum(start.values.values()))


def time_to_limit(system: System, limit: Limit, start: Start = REST) -> float:
    """Return about the time in which noise and the speed of the ``start`` can reach the ``limit``.

    Of |q_i| without stops and up to a factor 2 less; inf beyond the shortest natural period. Of H
    it is (√L − √E)²/N, E the energy of the start and N = Σ N_ii/m_i the power of the noise. Of
    modal energies it is from rest, N the power of the noise into the mode.
    """
    away, energy = np.sqrt(energies_at(system, limit)), largest_energy(system, start)
    if limit.kind != "q":
        power: Array = np.sum(np.diag(system.noise_matrix) / system.mass, keepdims=True)
        if limit.kind == "modal":
            power = modal_rates(system, limit, system.noise_matrix)
        elif start.kind != "noise":
            away = np.maximum(away - sqrt(energy), 0.0)
        filling = np.max(power / away**2) if np.all(away > 0.0) else 0.0
        return float(1.0 / filling) if filling > 0.0 else inf
    i, time = limit.observable(system.n)[0].row, 2.0 * pi / step_size.highest_frequency(system)
    distance, speed = limit.value, sqrt(2.0 * energy / system.mass[i])
    if start.kind == "state":
        q, p = start.state(system.n)
        distance, speed = distance - abs(q[i]), abs(p[i]) / system.mass[i]
    flow = partial(flow_covariance, drift_matrix(system), diffusion_matrix(system))
    shorter = time
    while speed * shorter + sqrt(flow(shorter)[1][i, i]) >= distance > 0.0:
        shorter *= 0.5
    return shorter if shorter < time else inf


class Reach(NamedTuple):
    """How far a motion gets and how soon, by which its steps are chosen; else it is stationary."""

    kT: float | None = None  # largest mean of m v² of a mass, None for the stationary one
    energy: float = 0.0  # of the limit, or of the start: steps must be short for it
    limit: float = inf  # time_to_limit from rest
    start: float = inf  # time_to_limit from the start


def reach_of(system: System, limit: Limit | None, start: Start, time: float) -> Reach:
    """Return how far a motion gets that is followed to the ``limit``, or for ``time``."""
    kT, energy = step_size.temperature(system), largest_energy(system, start)
    if not system.damping_terms and 0.0 < time < inf:  # terms may feed energy in
        power = float(np.sum(np.diag(system.noise_matrix) / system.mass))
        kT = min(kT, 2.0 * (energy + power * time))  # m v² is twice the energy by then at most
    with_noise = energy + (step_size.REACHED * kT if isfinite(kT) else 0.0)
    if limit is None:
        return Reach(kT, with_noise)
    at, of_q = energies_at(system, limit), limit.kind == "q"
    energy = max(float(np.max(at)), with_noise) if of_q else max(float(np.sum(at)), energy)
    kT = min(kT, 2.0 * energy) if limit.kind == "H" else kT  # m v² <= 2 H
    return Reach(kT, energy, time_to_limit(system, limit), time_to_limit(system, limit, start))


STEPS_PER_PERIOD = 20
"""Steps, of the coarser of both simulations, in the shortest natural period."""

STEP_TO_LIMIT = 0.1
"""Step h, of the coarser simulation, in units of ``time_to_limit`` t and of the fastest decay of an
amplitude: q leaves the cubic by (√3/8) (h/t)^1.5 standard deviations at t, 0.7 %."""

STEPS_SINCE_START = 8
"""Steps, of the coarser simulation, that have been made at least by a time that is asked for."""

CHUNK = 256
"""Steps, of the coarser simulation, after which the wall time is looked at: 8192 take 10 ms."""

TOO_LONG = 4.0
"""Steps of one's own, in units of the longest that is chosen, beyond which nothing is certified."""


def needs_steps(system: System) -> bool:
    """Return whether the step has an error at all: without contact and terms it is exact."""
    effects = effects_of(system)
    return effects.stops > 0 or effects.state_damping


def longest_step(system: System, reach: Reach) -> float:
    """Return the step in which velocities change little enough to see what is between two steps."""
    decay = float(np.max(np.abs(np.linalg.eigvals(system.damping / system.mass))))
    amplitude = 2.0 * STEP_TO_LIMIT / decay if decay > 0.0 else inf
    period = 2.0 * pi / step_size.highest_frequency(system) / STEPS_PER_PERIOD
    contact = step_size.chosen_step(system, energy=reach.energy, kT=reach.kT)
    return min(period, amplitude, STEP_TO_LIMIT * reach.limit, contact)


def motion_step(
    method: Settings,
    system: System,
    reach: Reach,
    *,
    error: float | None = None,
    too_long: float = TOO_LONG,
) -> tuple[float, list[str]]:
    """Return the longer of the steps of a motion within ``reach``, and why it is not certified.

    ``error`` is as of ``step_for``. Words are there for a step of one's own that is ``too_long``.
    Raises ``InvalidInput`` for an unstable step, and for a scheme but exact_flow, which alone can
    repeat a motion at half the step.
    """
    if method.scheme != "exact_flow":
        raise InvalidInput("scheme", method.scheme, "motions in time take exact_flow")
    if method.checkpoint is not None:
        raise InvalidInput("checkpoint", method.checkpoint, "motions in time save no state")
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: the motion is not random")
    kT, energy = step_size.temperature(system) if reach.kT is None else reach.kT, reach.energy
    kT = kT if kT < inf else 2.0 * energy  # of undamped motion up to the limit
    longest, error = longest_step(system, reach), error or method.paths**-0.5
    dt = method.dt or method.step_factor * min(longest, step_size.step_for(system, error, kT=kT))
    limit = step_size.stability_limit(system, SCHEMES[method.scheme], energy=energy, kT=kT)
    if not 0.0 < dt < limit and not method.allow_unstable:
        remedy = f"must be > 0 and below the stability limit {limit:.4g} of {method.scheme}"
        raise InvalidInput("dt", dt, remedy)
    words = f"between steps as long as dt = {dt:g} not all is seen; use {longest:.2g}"
    return dt, [words] if dt > too_long * longest else []


def first_step(dt: float, times: Array, start: float = inf, factor: float = 1.0) -> float:
    """Return the step up to ``dt`` that is short beside ``times`` > 0 and ``Reach.start``."""
    asked = float(np.min(times[times > 0.0], initial=inf)) / STEPS_SINCE_START
    return min(dt, factor * min(asked, STEP_TO_LIMIT * start))


def stages(first: float, dt: float, end: float, *, most: int) -> Iterator[tuple[float, int]]:
    """Yield steps, and how many of each, ``most`` at once, that lead from time 0 to ``end``.

    They double from ``first`` to ``dt``, each below the time before it over ``STEPS_SINCE_START``.
    """
    now, step = 0.0, first
    while now < end * (1.0 - 1e-12):
        until = min(2.0 * STEPS_SINCE_START * step, end) if step < dt else end
        left = max(1, ceil((until - now) / step * (1.0 - 1e-12)))
        now += left * step
        for done in range(0, left, most):
            yield step, min(most, left - done)
        step = min(2.0 * step, dt)
