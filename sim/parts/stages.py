"""The stages of a step, each with only the effects that its flags ask for.

They are inlined before types are inferred, so that a flag that is a constant of the kernel removes
its branch: an effect that a system does not have is not even typed.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.arrays import Rows, StepArrays, WatchArrays
from sim.lanes import add, kick, row
from sim.parts.contact import add_contact_energy, add_contact_forces, contact_forces, no_law
from sim.parts.damping import (
    damping_forces,
    kick_by_springs,
    processed_by_terms,
    spring_energy,
    term_flow,
    term_flow_with_energy,
    whole_energy,
)
from sim.parts.linear import map_any, map_one_mass, map_two_masses
from sim.parts.observed import (
    fold_products,
    observed_displacements,
    observed_energy,
    observed_modes,
    observed_momenta,
    observed_springs,
    sum_products,
)
from sim.random import Singles

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(inline="always")
def forces(
    s: Array, at: Rows, step: StepArrays, contact: bool, energy: bool,
    force: Any, slope: Any, potential: Any,
) -> None:  # fmt: skip
    """Write the contact forces, and the potential energy where damping depends on H."""
    if contact:
        contact_forces(s, at.contact, step, force, slope)
    if energy:
        spring_energy(s, row(s, at.work + 1), step.terms)
        if contact:
            add_contact_energy(s, 0, at.work + 1, step, potential)


@njit(inline="always")
def flow_of_term(s: Array, at: Rows, step: StepArrays, k: int, energy: bool) -> None:
    """Advance the momenta by damping term k alone over half a step."""
    if energy:
        term_flow_with_energy(s, at.work, step.terms, k, 0.5 * step.dt)
    else:
        term_flow(s, at.work, step.terms, k, 0.5 * step.dt)


@njit(inline="always")
def terms_before(s: Array, at: Rows, step: StepArrays, energy: bool) -> None:
    """Advance by all damping terms over half a step."""
    for k in range(step.terms.target.size):
        flow_of_term(s, at, step, k, energy)


@njit(inline="always")
def terms_after(s: Array, at: Rows, step: StepArrays, energy: bool) -> None:
    """Kick by the springs, then advance by all damping terms in reverse: a symmetric step."""
    kick_by_springs(s, step.terms)
    for k in range(step.terms.target.size - 1, -1, -1):
        flow_of_term(s, at, step, k, energy)


@njit(inline="always")
def forces_of_terms(s: Array, at: Rows, step: StepArrays, energy: bool) -> None:
    """Write the forces of the damping terms at the state, where they are of Euler's kind."""
    H = row(s, at.work + 2)
    if energy:
        whole_energy(s, H, row(s, at.work + 1), step.terms)
    damping_forces(s, 0, H, at.damping, at.work, step.terms)


@njit(inline="always")
def kick_by_terms(s: Array, at: Rows, step: StepArrays, n: int) -> None:
    """Take the forces of the damping terms times dt from the momenta."""
    for i in range(n):
        add(row(s, n + i), row(s, at.damping + i), -step.dt)


@njit(inline="always")
def kick_by_contact(s: Array, at: Rows, step: StepArrays, n: int) -> None:
    """Take the modified contact forces times dt from the momenta."""
    for slot in range(step.slot_mass.size):
        p, g = row(s, n + step.slot_mass[slot]), row(s, at.contact + 2 * slot, 2)
        kick(p, g, step.dt, step.slot_shift[slot])


@njit(inline="always")
def observe(
    s: Array, step: StepArrays, watch: WatchArrays, contact: bool, momenta: bool, damping: bool,
    energy_damping: bool, energy: bool, modes: bool, moments: bool, force: Any, potential: Any,
) -> None:  # fmt: skip
    """Write everything of the observed state that is asked for, corrected by the processor."""
    at = watch.at
    observed_displacements(s, step, watch)
    if momenta:
        observed_momenta(s, step, watch)
    if damping and watch.term_shift != 0.0:
        H = row(s, at.work + 2)
        if energy_damping:
            whole_energy(s, H, row(s, at.work + 1), step.terms)
        processed_by_terms(s, H, at, watch.term_shift, step)
    if energy:
        observed_energy(s, watch)
    if moments:
        observed_springs(s, watch)
    if contact and moments:
        add_contact_forces(s, at.q, at.force, step, force)
    if contact and energy:
        add_contact_energy(s, at.q, at.energy, step, potential)
    if modes:
        observed_modes(s, watch.mode_q, watch.mode_p, watch)
    if damping and moments:
        damping_forces(s, at.q, row(s, at.energy), at.damping, at.work, step.terms)


@njit(inline="always")
def add_moments(
    s: Array, b: int, sums: Array, folded: Array, live: Integers, watch: WatchArrays
) -> None:
    """Add the products of block ``b``: lane by lane in the first blocks, folded in the others."""
    if b < sums.shape[0]:
        sum_products(s, sums[b], watch)
    else:
        fold_products(s, folded[b - sums.shape[0]], live[b], watch)


@njit(inline="always")
def map_state(
    s: Array, z: Singles, matrix: Array, step: StepArrays, masses: int, pairs: int,
    kick1: bool, kick2: bool, force: Any, slope: Any,
) -> None:  # fmt: skip
    """Apply the random linear map, after the contact kicks that are fused with it."""
    if masses == 1 and pairs == 1:
        if kick1:
            map_one_mass(row(s, 0, 2), z, matrix, step, kick1, force, slope)
        else:
            map_one_mass(row(s, 0, 2), z, matrix, step, False, no_law, no_law)
    elif masses == 2 and pairs == 2:
        if kick1 or kick2:
            map_two_masses(row(s, 0, 4), z, matrix, step, kick1, kick2, force, slope)
        else:
            map_two_masses(row(s, 0, 4), z, matrix, step, False, False, no_law, no_law)
    else:
        map_any(s, z, pairs, matrix)
