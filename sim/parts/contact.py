"""Forces and energies of contact, lane by lane; laws come as compiled functions."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiled_laws import of_law
from fpk.compiling import FLAGS
from sim.arrays import LANES, StepArrays
from sim.lanes import fill, row

Array = NDArray[np.float64]
W = LANES
Stop = tuple[float, float, float, float, int, float]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def contact_forces(
    s: Array, g0: int, step: StepArrays, force: Any, slope: Any, width: int = W
) -> None:
    """Write g and g' of every slot at the displacements of the state to the rows from ``g0``."""
    for stop in range(step.stop_slot.size):
        slot, law = step.stop_slot[stop], step.stop_law[stop]
        q = row(s, step.slot_mass[slot], 1, width)
        g = row(s, g0 + 2 * slot, 2, width)
        clearance, sign = step.stop_clearance[stop], step.stop_sign[stop]
        B, e = step.stop_stiffness[stop], step.stop_exponent[stop]
        if step.stop_fresh[stop]:
            fill(g, 0.0, width)
            fill(g[width:], 0.0, width)
        if sign != 0.0:
            for k in range(width):
                o = max(sign * q[k] - clearance, 0.0)
                g[k] += sign * B * of_law(force, law, o, e)
                g[width + k] += B * of_law(slope, law, o, e) if o > 0.0 else 0.0
        else:
            for k in range(width):
                o = max(abs(q[k]) - clearance, 0.0)
                g[k] += np.copysign(B, q[k]) * of_law(force, law, o, e)
                g[width + k] += B * of_law(slope, law, o, e) if o > 0.0 else 0.0


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def no_law(law: int, overlap: float, exponent: float) -> float:
    """Stand for a law where there is no contact."""
    return 0.0


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def only_stop(step: StepArrays, mass: int) -> Stop:
    """Return the numbers of the only stop of a mass, the last its share of the modified kick."""
    slot = 1 if step.slot_mass[0] != mass else 0
    for stop in range(step.stop_slot.size):
        if step.stop_slot[stop] == slot:
            return (
                step.stop_sign[stop],
                step.stop_clearance[stop],
                step.stop_stiffness[stop],
                step.stop_exponent[stop],
                step.stop_law[stop],
                step.slot_shift[slot],
            )
    return 0.0, np.inf, 0.0, 1.0, 0, 0.0


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def modified_force(q: float, stop: Stop, force: Any, slope: Any) -> float:
    """Return ``g (1 − a g')`` of one stop at the displacement ``q`` of one lane."""
    sign, clearance, B, e, law, a = stop
    d = sign if sign != 0.0 else np.copysign(1.0, q)
    o = max(d * q - clearance, 0.0)
    g_slope = B * of_law(slope, law, o, e) if o > 0.0 else 0.0
    g: float = d * (B * of_law(force, law, o, e))
    return g * (1.0 - a * g_slope)


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def add_contact_forces(s: Array, q0: int, f0: int, step: StepArrays, force: Any) -> None:
    """Add g at the displacements from row ``q0`` to the rows of its masses from ``f0``."""
    for stop in range(step.stop_slot.size):
        i, law = step.slot_mass[step.stop_slot[stop]], step.stop_law[stop]
        q, f = row(s, q0 + i), row(s, f0 + i)
        clearance, sign = step.stop_clearance[stop], step.stop_sign[stop]
        B, e = step.stop_stiffness[stop], step.stop_exponent[stop]
        for k in range(W):
            d = sign if sign != 0.0 else np.copysign(1.0, q[k])
            f[k] += d * B * of_law(force, law, max(d * q[k] - clearance, 0.0), e)


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def add_contact_energy(s: Array, q0: int, H0: int, step: StepArrays, potential: Any) -> None:
    """Add U at the displacements from row ``q0`` to row ``H0``."""
    for stop in range(step.stop_slot.size):
        i, law = step.slot_mass[step.stop_slot[stop]], step.stop_law[stop]
        q, H = row(s, q0 + i), row(s, H0)
        clearance, sign = step.stop_clearance[stop], step.stop_sign[stop]
        B, e = step.stop_stiffness[stop], step.stop_exponent[stop]
        for k in range(W):
            d = sign if sign != 0.0 else np.copysign(1.0, q[k])
            H[k] += B * of_law(potential, law, max(d * q[k] - clearance, 0.0), e)
