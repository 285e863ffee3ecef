"""Limits of first passage as tests of states: which lie beyond, and how far motion gets when."""

from functools import partial
from math import inf, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np

from fpk.arrays import Array, Flags
from fpk.errors import NotApplicable
from fpk.limit import Limit
from fpk.linear import diffusion_matrix, drift_matrix, modal_energies, natural_modes
from fpk.observable import Coordinate
from fpk.start import REST, Start
from fpk.system import System
from sim.flow import flow_covariance
from sim.step_size import REACHED, highest_frequency, temperature

AT_LIMIT = 1.0 - 1e-12
"""Share of its limit that counts as reached: a start drawn at an energy has it to round-off."""


def energies_of(limit: Limit, n: int) -> tuple[Coordinate, ...]:
    """Return the energies that must be observed to see ``limit`` passed."""
    if limit.kind == "q":
        return ()
    modes = [Coordinate("H", m) for m in range(n) if f"H{m + 1}" in limit.values]
    return tuple(modes) or (Coordinate("H"),)


def energies_at(system: System, limit: Limit) -> Array:
    """Return the limits in the order of ``energies_of``.

    Of a displacement it is the least potential energy there, on its right and on its left.
    """
    if limit.kind != "q":
        return np.array([limit.values[str(c)] for c in energies_of(limit, system.n)])
    i, springs = limit.observable(system.n)[0].row, 0.5 * limit.value**2
    contact = [float(system.contact_energy(i, side * limit.value)) for side in (1.0, -1.0)]
    return springs / float(system.compliance[i, i]) + np.array(contact)


def beyond(system: System, limit: Limit, q: Array, p: Array) -> Flags:
    """Return which states q, p (paths, n) are at or beyond the limit."""
    if limit.kind == "q":
        return np.asarray(np.abs(q[:, limit.observable(system.n)[0].row]) >= limit.value)
    if limit.kind == "H":
        return np.asarray(system.hamiltonian(q, p) >= AT_LIMIT * limit.value)
    rows = [c.row for c in energies_of(limit, system.n)]
    modal = modal_energies(system, q, p)[:, rows]
    return np.asarray(np.any(modal >= AT_LIMIT * energies_at(system, limit), axis=1))


def largest_energy(system: System, start: Start) -> float:
    """Return the energy up to which the start reaches, without that of its own noise."""
    if start.kind == "state":
        return float(system.hamiltonian(*start.state(system.n)))
    if start.kind == "noise" and not start.rest:
        if (kT := temperature(system)) == inf:
            raise NotApplicable("some motion is not damped: no stationary state to start from")
        return REACHED * start.values["noise"] * kT
    return float(sum(start.values.values()))


def temperature_reached(system: System, start: Start, time: float) -> float:
    """Return the largest mean of m v² of a mass from the ``start`` to ``time``.

    It is kT, or less: twice the energy of the start and that of the noise by then, Σ (N_ii/m_i) t.
    """
    kT = temperature(system)
    if system.damping_terms or not 0.0 < time < inf:  # terms may feed energy in
        return kT
    power = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    return min(kT, 2.0 * (largest_energy(system, start) + power * time))


def time_to_limit(system: System, limit: Limit, start: Start = REST) -> float:
    """Return about the time in which noise and the speed of the ``start`` can reach the ``limit``.

    Of |q_i| it is when the rms displacement from rest and that speed times t are the distance to
    the limit, without stops and up to a factor 2 less; inf where that is not within the shortest
    natural period. Of H it is (√L − √E)²/N, E the energy of the start and N = Σ N_ii/m_i the power
    of the noise: from rest the mean of H then is the limit L. Of modal energies it is that from
    rest, N the power of the noise into the mode.
    """
    away, energy = np.sqrt(energies_at(system, limit)), largest_energy(system, start)
    if limit.kind != "q":
        power = np.sum(np.diag(system.noise_matrix) / system.mass)
        if limit.kind == "modal":
            T = natural_modes(system)[0][:, [c.row for c in energies_of(limit, system.n)]]
            power = np.einsum("im,ij,jm->m", T, system.noise_matrix, T)
        elif start.kind != "noise":
            away = np.maximum(away - sqrt(energy), 0.0)
        filling = np.max(power / away**2) if np.all(away > 0.0) else 0.0
        return float(1.0 / filling) if filling > 0.0 else inf
    i, time = limit.observable(system.n)[0].row, 2.0 * pi / highest_frequency(system)
    distance, speed = limit.value, sqrt(2.0 * energy / system.mass[i])
    if start.kind == "state":
        q, p = start.state(system.n)
        distance, speed = distance - abs(q[i]), abs(p[i]) / system.mass[i]
    flow = partial(flow_covariance, drift_matrix(system), diffusion_matrix(system))

    def reached(time: float) -> bool:
        return bool(speed * time + sqrt(flow(time)[1][i, i]) >= distance)

    if not (distance > 0.0 and reached(time)):
        return inf
    while reached(time):
        time *= 0.5
    return time


class Reach(NamedTuple):
    """How far a motion gets and how soon, by which its steps are chosen; else it is stationary."""

    kT: float | None = None  # largest mean of m v² of a mass, None for the stationary one
    energy: float = 0.0  # for which steps must be short: that of the limit, or of the start
    limit: float = inf  # time_to_limit from rest
    start: float = inf  # time_to_limit from the start


def reach_of(system: System, limit: Limit, start: Start, time: float) -> Reach:
    """Return how far a motion gets that is followed to the ``limit``, or for ``time``."""
    kT, energy = temperature_reached(system, start, time), largest_energy(system, start)
    at = energies_at(system, limit)
    if limit.kind == "q":
        energy = max(float(np.max(at)), energy + (REACHED * kT if isfinite(kT) else 0.0))
    else:
        energy = max(float(np.sum(at)), energy)
    kT = min(kT, 2.0 * energy) if limit.kind == "H" else kT  # m v² <= 2 H
    return Reach(kT, energy, time_to_limit(system, limit), time_to_limit(system, limit, start))
