"""Limits of first passage, and steps so short that the motion between two is known."""

from collections.abc import Iterator
from math import ceil, inf, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np

from fpk.answer.names import REST, Coordinate, Limit, Start
from fpk.numeric.arrays import ROUND_OFF, Array, Flags
from fpk.numeric.errors import NotApplicable, require
from fpk.system.linear import (
    diffusion_matrix,
    drift_matrix,
    flow_covariance,
    natural_modes,
)
from fpk.system.system import System, effects_of
from sim.sample.histogram import values_of
from sim.sample.settings import Settings
from sim.step import step_size
from sim.step.schemes import SCHEMES


def energies_of(limit: Limit, n: int) -> tuple[Coordinate, ...]:
    """Return (H,), the limited modal energies of ``n`` masses by mode, or () for q_i and v_i."""
    if not limit.of_energy:
        return ()
    modes = [Coordinate("H", m) for m in range(n) if f"H{m + 1}" in limit.values]
    return tuple(modes) or (Coordinate("H"),)


def energies_at(system: System, limit: Limit) -> Array:
    """Return the limits of ``energies_of``; of q_i and v_i the least energies at ``limit.ends``."""
    if limit.of_energy:
        return np.array([limit.values[str(c)] for c in energies_of(limit, system.n)])
    i, halves = limit.row, 0.5 * np.square(limit.ends)
    if limit.kind == "v":
        return np.asarray(float(system.mass[i]) * halves)
    contact = [float(system.contact_energy(i, end)) for end in limit.ends]
    return np.asarray(halves / float(system.compliance[i, i]) + np.array(contact))


def values_at(system: System, limit: Limit) -> Array:
    """Return what the compiled readers compare: the energies (limits,) of ``energies_of``, both
    bounds of q_i, or the momenta p_i (limits,) at ``limit.ends``."""
    if limit.kind == "q":
        return np.array(limit.bounds)
    if limit.kind == "v":
        return np.asarray(float(system.mass[limit.row]) * np.array(limit.ends))
    return energies_at(system, limit)


def states_beyond(system: System, limit: Limit, q: Array, p: Array) -> Flags:
    """Return flags (paths,): True if ``q``, ``p`` (paths, n) is at or beyond ``limit``."""
    if not limit.of_energy:
        return np.asarray(limit.distance(q, p / system.mass) <= 0.0)
    reached = (1.0 - ROUND_OFF) * energies_at(system, limit)
    H = [values_of(system, c, q, p) for c in energies_of(limit, system.n)]
    return np.asarray(np.any(np.transpose(H) >= reached, axis=1))


def modal_rates(system: System, limit: Limit, matrix: Array) -> Array:
    """Return T_mᵀ ``matrix`` T_m (modes,), T_m the shapes of the modes m of a modal ``limit``."""
    T = natural_modes(system)[0][:, [c.row for c in energies_of(limit, system.n)]]
    return np.asarray(np.einsum("im,ij,jm->m", T, matrix, T))


def largest_energy(system: System, start: Start) -> float:
    """Return the energy H of the ``start``; of stationary states ``REACHED`` kT of their noise.

    Raises ``NotApplicable`` for a stationary state without damping.
    """
    if start.kind == "state":
        return float(system.hamiltonian(*start.state(system.n)))
    if start.kind == "noise" and not start.rest:
        if (kT := step_size.temperature(system)) == inf:
            raise NotApplicable("some motion is not damped: no stationary state to start from")
        return step_size.REACHED * start.values["noise"] * kT
    return float(sum(start.values.values()))


def time_to_limit(system: System, limit: Limit, start: Start = REST) -> float:
    """Return the estimated time in which noise and the speed of the ``start`` reach the ``limit``.

    For H it is (√L − √E)²/N, E the energy of the start and N = Σ N_ii/m_i the power of the noise;
    for modal energies the same from rest, N the power into the mode. For q_i and v_i it is computed
    without stops, up to a factor 2 too small, and inf if longer than the shortest natural period.
    For H, q_i and v_i it is inf, too, if the start is at or beyond the limit.
    """
    away, energy = np.sqrt(energies_at(system, limit)), largest_energy(system, start)
    if limit.of_energy:
        power: Array = np.sum(np.diag(system.noise_matrix) / system.mass, keepdims=True)
        if limit.kind == "modal":
            power = modal_rates(system, limit, system.noise_matrix)
        elif start.kind != "noise":
            away = np.maximum(away - sqrt(energy), 0.0)
        filling = np.max(power / away**2) if np.all(away > 0.0) else 0.0
        return float(1.0 / filling) if filling > 0.0 else inf
    i, highest = limit.row, step_size.highest_frequency(system)
    time, (q, p) = 2.0 * pi / highest, start.state(system.n)  # without a state 0
    rate, distance = sqrt(2.0 * energy / system.mass[i]), float(limit.distance(q, p / system.mass))
    unit = np.append(np.ones(system.n), system.mass)
    if limit.kind == "v":
        i, rate = system.n + i, highest * rate
    elif start.kind == "state":
        rate = abs(p[i]) / system.mass[i]
    drift, b = drift_matrix(system), diffusion_matrix(system)

    def spread(time: float) -> float:  # of a velocity soonest without damping
        variance = float(flow_covariance(drift, b, time)[1][i, i])
        return sqrt(max(variance, float(b[i, i]) * time)) / float(unit[i])

    shorter = time
    while rate * shorter + spread(shorter) >= distance > 0.0:
        shorter *= 0.5
    return shorter if shorter < time else inf


class Reach(NamedTuple):
    """Energies and times of a motion, from which its steps are chosen; by default stationary."""

    kT: float | None = None  # largest mean of m v² of a mass; None: the stationary temperature
    energy: float = 0.0  # for which the step must be accurate
    limit: float = inf  # time_to_limit from rest
    start: float = inf  # time_to_limit from the start


def motion_reach(system: System, limit: Limit | None, start: Start, time: float) -> Reach:
    """Return the ``Reach`` of a motion from ``start`` that ends at ``limit``, or at ``time``."""
    kT, energy = step_size.temperature(system), largest_energy(system, start)
    if not system.damping_terms and 0.0 < time < inf:  # damping terms may supply energy
        power = float(np.sum(np.diag(system.noise_matrix) / system.mass))
        kT = min(kT, 2.0 * (energy + power * time))  # m v² is at most twice the energy
    with_noise = energy + (step_size.REACHED * kT if isfinite(kT) else 0.0)
    if limit is None:
        return Reach(kT, with_noise)
    at = energies_at(system, limit)
    ends = (np.sum(at), energy) if limit.of_energy else (np.max(at), with_noise)
    energy = float(max(ends))
    kT = min(kT, 2.0 * energy) if limit.kind == "H" else kT  # m v² <= 2 H
    return Reach(kT, energy, time_to_limit(system, limit), time_to_limit(system, limit, start))


STEPS_PER_PERIOD = 20
"""Least number of steps in the shortest natural period; here and below steps are the longer steps
of the two simulations."""

STEPS_SINCE_START = 8
"""Least number of steps from the start to the first output time."""

CHUNK_STEPS = 256
"""Steps after which the wall time is checked; of 8192 trajectories they take 10 ms or more."""

TOO_LONG = 4.0
"""Largest step set by the user whose answer is certified, in units of ``longest_step``."""


def needs_steps(system: System) -> bool:
    """Return whether the step has an error: without stops and damping terms it is exact."""
    effects = effects_of(system)
    return effects.stops > 0 or effects.state_damping


def longest_step(system: System, reach: Reach) -> float:
    """Return the longest step that resolves periods, damping, contacts and time ``reach.limit``."""
    decay = float(np.max(np.abs(np.linalg.eigvals(system.damping / system.mass))))
    amplitude = 2.0 * step_size.STEP_PER_RATE / decay if decay > 0.0 else inf
    period = 2.0 * pi / step_size.highest_frequency(system) / STEPS_PER_PERIOD
    contact = step_size.chosen_step(system, energy=reach.energy, kT=reach.kT)
    return min(period, amplitude, step_size.STEP_PER_RATE * reach.limit, contact)


def motion_step(
    method: Settings,
    system: System,
    reach: Reach,
    *,
    error: float | None = None,
    too_long: float = TOO_LONG,
) -> tuple[float, list[str]]:
    """Return the longer step of the two simulations of a motion, and a list of words against it.

    ``reach``: energies and times of the motion; ``error``: allowed relative error of p, by default
    paths^(−½). The list is empty unless ``dt`` exceeds ``too_long`` times the longest step. Raises
    ``InvalidInput`` for an unstable step without ``allow_unstable``, a checkpoint, and any scheme
    but exact_flow, which alone can repeat a motion at half the step; ``NotApplicable`` without
    noise.
    """
    scheme, folder = method.scheme, method.checkpoint
    require(scheme == "exact_flow", "scheme", scheme, "motions in time take exact_flow")
    require(folder is None, "checkpoint", folder, "motions in time save no state")
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: the motion is not random")
    kT, energy = step_size.temperature(system) if reach.kT is None else reach.kT, reach.energy
    kT = kT if kT < inf else 2.0 * energy  # undamped motion up to the limit
    longest, error = longest_step(system, reach), error or method.paths**-0.5
    dt = method.dt or method.step_factor * min(longest, step_size.step_for(system, error, kT=kT))
    limit = step_size.stability_limit(system, SCHEMES[scheme], energy=energy, kT=kT)
    remedy = f"must be > 0 and below the stability limit {limit:.4g} of {scheme}"
    require(0.0 < dt < limit or method.allow_unstable, "dt", dt, remedy)
    words = f"between steps as long as dt = {dt:g} not all is seen; use {longest:.2g}"
    return dt, [words] if dt > too_long * longest else []


def first_step(dt: float, times: Array, start: float = inf, factor: float = 1.0) -> float:
    """Return the first step: ``dt``, or less if the first of ``times`` > 0 or ``start`` is near.

    Its bounds ``times`` / ``STEPS_SINCE_START`` and ``start`` · ``STEP_PER_RATE``, ``start`` being
    ``Reach.start``, are multiplied by ``factor``.
    """
    asked = float(np.min(times[times > 0.0], initial=inf)) / STEPS_SINCE_START
    return min(dt, factor * min(asked, step_size.STEP_PER_RATE * start))


def stages(first: float, dt: float, end: float, *, most: int) -> Iterator[tuple[float, int]]:
    """Yield pairs of a step and a number of such steps, at most ``most``, from time 0 to ``end``.

    Steps double from ``first`` to ``dt``; a longer step than ``first`` is at most the time so far /
    ``STEPS_SINCE_START``. The last step may go beyond ``end``.
    """
    now, step = 0.0, first
    while now < end * (1.0 - 1e-12):
        until = min(2.0 * STEPS_SINCE_START * step, end) if step < dt else end
        left = max(1, ceil((until - now) / step * (1.0 - 1e-12)))
        now += left * step
        for done in range(0, left, most):
            yield step, min(most, left - done)
        step = min(2.0 * step, dt)
