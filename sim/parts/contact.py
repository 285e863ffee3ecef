"""Forces and energies of contact, lane by lane; laws come as compiled functions."""

from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.compiling import inlined, of_law
from sim.arrays import LANES as W
from sim.arrays import StepArrays
from sim.lanes import fill, kick, row

Stop = tuple[float, float, float, float, Any]
"""Sign, clearance, stiffness, exponent and law of a stop."""


@inlined
def numbers_of(step: StepArrays, stop: int) -> Stop:
    """Return the numbers of one stop."""
    s = step.stops[stop]
    return s[0], s[1], s[2], s[3], np.int64(s[4])


@inlined
def overlap_of(q: float, sign: float, clearance: float) -> tuple[float, float]:
    """Return the side on which the displacement ``q`` lies and its overlap with the stop there."""
    d = sign if sign != 0.0 else np.copysign(1.0, q)
    return d, max(d * q - clearance, 0.0)


@inlined
def contact_forces(
    s: Array, g0: int, step: StepArrays, force: Any, slope: Any, width: int = W
) -> None:
    """Write g and g' of every slot at the displacements of the state to the rows from ``g0``."""
    rows = 2 * step.slot_mass.size
    fill(row(s, g0, rows, width), 0.0, rows * width)
    for stop in range(step.stop_slot.size):
        slot = step.stop_slot[stop]
        q = row(s, step.slot_mass[slot], 1, width)
        g = row(s, g0 + 2 * slot, 2, width)
        sign, clearance, B, e, law = numbers_of(step, stop)
        for k in range(width):
            d, o = overlap_of(q[k], sign, clearance)
            g[k] += d * B * of_law(force, law, o, e)
            g[width + k] += B * of_law(slope, law, o, e) if o > 0.0 else 0.0


@inlined
def kick_by_contact(s: Array, g0: int, step: StepArrays, n: int, width: int = W) -> None:
    """Take the modified contact forces in the rows from ``g0`` times dt from the momenta."""
    for slot in range(step.slot_mass.size):
        p, g = row(s, n + step.slot_mass[slot], 1, width), row(s, g0 + 2 * slot, 2, width)
        kick(p, g, step.dt, step.slot_shift[slot], width)


@inlined
def add_contact(
    s: Array, q0: int, to: int, step: StepArrays, law_part: Any, forces: bool, width: int = W
) -> None:
    """Add g at the displacements from row ``q0`` to the rows of its masses from ``to``.

    If not ``forces`` it is U, by the laws' energy as ``law_part``, and all goes to row ``to``.
    """
    for stop in range(step.stop_slot.size):
        i = step.slot_mass[step.stop_slot[stop]]
        q, f = row(s, q0 + i, 1, width), row(s, to + i if forces else to, 1, width)
        sign, clearance, B, e, law = numbers_of(step, stop)
        for k in range(width):
            d, o = overlap_of(q[k], sign, clearance)
            size = d * B if forces else B
            f[k] += size * of_law(law_part, law, o, e)
