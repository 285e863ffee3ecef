"""From a system, a scheme and a step to the arrays that the kernel reads."""

import numpy as np
from numpy.typing import NDArray

from fpk.effects import effects_of
from fpk.system import System
from sim.kernel import StepArrays
from sim.lanes import COLUMNS
from sim.scheme import Scheme

Array = NDArray[np.float64]


def step_arrays(system: System, scheme: Scheme, dt: float) -> StepArrays:
    """Return the numbers of one step of ``dt``; a stop equal on both sides counts as one."""
    n = system.n
    linear = scheme.linear_map(system, dt)
    pairs = (linear.normals + 1) // 2
    columns = -(-(2 * n + 2 * pairs) // COLUMNS) * COLUMNS
    matrix = np.zeros((2 * n, columns))
    matrix[:, : 2 * n] = linear.propagator
    matrix[:, 2 * n : 2 * n + linear.normals] = linear.factor
    laws, slots = effects_of(system).laws, system.contact_masses
    merged: dict[tuple[int, float, float, float, int], list[float]] = {}
    for stop in system.stops:
        sign = 1.0 if stop.side == "right" else -1.0
        law = laws.index(stop.law)
        key = (slots.index(stop.mass), stop.clearance, stop.stiffness, stop.power, law)
        merged.setdefault(key, []).append(sign)
    rows = [
        (*key, sign)
        for key, signs in sorted(merged.items())
        for sign in ([0.0] if sorted(signs) == [-1.0, 1.0] else signs)
    ]
    columns_of = list(zip(*rows, strict=True)) if rows else [()] * 6
    slot = np.array(columns_of[0], dtype=np.int64)
    masses = np.array(slots, dtype=np.int64)
    return StepArrays(
        matrix=matrix,
        pairs=pairs,
        dt=float(dt),
        slot_mass=masses,
        slot_shift=scheme.modified * dt**2 / system.mass[masses],
        stop_slot=slot,
        stop_fresh=np.append(True, np.diff(slot) != 0)[: slot.size],
        stop_sign=np.array(columns_of[5], dtype=float),
        stop_clearance=np.array(columns_of[1], dtype=float),
        stop_stiffness=np.array(columns_of[2], dtype=float),
        stop_exponent=np.array(columns_of[3], dtype=float),
        stop_law=np.array(columns_of[4], dtype=np.int64),
    )
