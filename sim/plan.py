"""From a system, a scheme and a step to the arrays that the kernel reads."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fpk.effects import effects_of
from fpk.system import System
from sim.arrays import StepArrays, TermArrays
from sim.scheme import Scheme
from sim.substeps import substep_arrays

Array = NDArray[np.float64]


def step_arrays(system: System, scheme: Scheme, dt: float) -> StepArrays:
    """Return the numbers of one step of ``dt``; a stop equal on both sides counts as one.

    Of a long step they belong to its small ones; ``substeps`` has the long one.
    """
    n, small, H = system.n, scheme.small, dt
    dt = H / small
    linear = scheme.linear_map(system, dt)
    springs = dt * system.stiffness_matrix if scheme.springs_kicked else np.zeros((0, 0))
    terms = term_arrays(system, springs) if system.damping_terms else None
    if springs.size and terms is None:
        one, zero = np.eye(n), np.zeros((n, n))
        kicked = linear.propagator @ np.block([[one, zero], [-springs, one]])
        linear = replace(linear, propagator=kicked)
    pairs = (linear.normals + 1) // 2
    laws, slots = effects_of(system).laws, system.contact_masses
    merged: dict[tuple[int, float, float, float, int], list[float]] = {}
    for stop in system.stops:
        sign = 1.0 if stop.side == "right" else -1.0
        law = laws.index(stop.law)
        key = (slots.index(stop.index), stop.clearance, stop.stiffness, stop.power, law)
        merged.setdefault(key, []).append(sign)
    rows = [
        (*key, sign)
        for key, signs in sorted(merged.items())
        for sign in ([0.0] if sorted(signs) == [-1.0, 1.0] else signs)
    ]
    # A contiguous row each: slot, clearance, stiffness, exponent, law, sign.
    stops = np.ascontiguousarray(np.array(rows, dtype=float).reshape(-1, 6).T)
    slot, masses = stops[0].astype(np.int64), np.array(slots, dtype=np.int64)
    return StepArrays(
        matrix=linear.matrix,
        pairs=pairs,
        dt=float(dt),
        stiffness_matrix=system.stiffness_matrix,
        half_inverse_mass=0.5 / system.mass,
        slot_mass=masses,
        slot_shift=scheme.modified * dt**2 / system.mass[masses],
        stop_slot=slot,
        stop_sign=stops[5],
        stop_clearance=stops[1],
        stop_stiffness=stops[2],
        stop_exponent=stops[3],
        stop_law=stops[4].astype(np.int64),
        terms=terms,
        words=pairs * (small + 1) if small > 1 else pairs,
        substeps=substep_arrays(system, H, small, masses[slot]) if small > 1 else None,
    )


def term_arrays(system: System, springs: Array) -> TermArrays:
    """Return the damping terms as powers of the momenta ``p = m v``; see ``TermArrays``."""
    n, factors, counts, powers, scales = system.n, [], [], [], []
    for term in system.damping_terms:
        v = list(term.powers("v", n))
        v[term.column] += 1
        powers.append(v[term.row])
        scales.append(term.coefficient / float(np.prod(system.mass ** np.array(v))))
        v[term.row] = 0
        rows = [a for a, power in enumerate((*term.powers("q", n), *v)) for _ in range(power)]
        rows += powers[-1] * [n + term.row]
        factors += rows
        counts.append(len(rows))
    return TermArrays(
        target=np.array([n + term.row for term in system.damping_terms], dtype=np.int64),
        power=np.array(powers, dtype=np.int64),
        scale=np.array(scales),
        energy=np.array([term.energy for term in system.damping_terms], dtype=np.int64),
        first=np.cumsum([0, *counts], dtype=np.int64),
        factor=np.array(factors, dtype=np.int64),
        springs=springs,
    )
