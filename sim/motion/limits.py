"""Limits of first passage as tests of states: which lie beyond, and how far motion can get."""

from math import isfinite

import numpy as np

from fpk.arrays import Array, Flags
from fpk.limit import Limit
from fpk.linear import modal_energies
from fpk.observable import Coordinate
from fpk.start import Start
from fpk.system import System
from sim.step_size import REACHED, temperature

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
    if start.kind == "noise":
        return REACHED * start.values["noise"] * temperature(system)
    return float(sum(start.values.values()))


def energy_reached(system: System, limit: Limit, start: Start) -> float:
    """Return the energy for which the step must be short: that of the limit, or of the start."""
    reached, at = largest_energy(system, start), energies_at(system, limit)
    if limit.kind != "q":
        return max(float(np.sum(at)), reached)
    kT = temperature(system)
    return max(float(np.max(at)), reached + (REACHED * kT if isfinite(kT) else 0.0))
