"""The random linear map of a block, and small steps of the lanes near a stop only.

``x <- matrix @ (x, z)``, z rows of normals: pair j is a row of cosines at ``j · pair`` and one of
sines ``sines`` behind it, for columns 2j and 2j + 1. The map goes by pairs of rows and ``COLUMNS``
columns through scratch rows.

The lanes that may touch a stop within a long step (``sim.sample.plan``) are gathered, ``NARROW`` to
a group; all lanes are mapped over the long step; then those gathered make the small steps from
where they were and overwrite what the map gave. Their normals belong to the trajectory and the
step, wherever a lane lies in its group: a word's lower half is the radius, the upper the angle.
"""

from typing import Any

import numpy as np
from numba import njit

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import inlined
from sim.step.arrays import COLUMNS, NARROW, StepArrays, W
from sim.step.lanes import copy, fill, row
from sim.step.parts.forces import contact_forces, kick_by_contact
from sim.step.random import GOLDEN, Halves, Singles, Words, box_muller, mixed_word


@inlined
def map_state(
    s: Array, z: Singles, matrix: Array, pairs: int, width: int = W, sines: int = W,
    pair: int = 2 * W,
) -> None:  # fmt: skip
    """Apply the random linear map to the first rows of ``s``."""
    n, scratch = matrix.shape
    for i in range(pairs):
        copy(row(s, n + 2 * i, 1, width), z[i * pair :], width)
        copy(row(s, n + 2 * i + 1, 1, width), z[i * pair + sines :], width)
    for i in range(0, n, 2):
        y = row(s, scratch + i, 2, width)
        for j in range(0, matrix.shape[1], COLUMNS):
            a0, a1, a2, a3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            b0, b1 = matrix[i + 1, j], matrix[i + 1, j + 1]
            b2, b3 = matrix[i + 1, j + 2], matrix[i + 1, j + 3]
            x = row(s, j, COLUMNS, width)
            if j == 0:
                for k in range(width):
                    x0, x1, x2, x3 = x[k], x[width + k], x[2 * width + k], x[3 * width + k]
                    y[k] = a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                    y[width + k] = b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
            else:
                for k in range(width):
                    x0, x1, x2, x3 = x[k], x[width + k], x[2 * width + k], x[3 * width + k]
                    y[k] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                    y[width + k] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
    for i in range(n):
        copy(row(s, i, 1, width), row(s, scratch + i, 1, width), width)


@inlined
def near_lanes(s: Array, work: Array, near: Integers, index: Integers, step: StepArrays) -> int:
    """Write the lanes that may touch a stop to ``index`` and return how many they are.

    ``work``: two rows of scratch, the displacement after the step and the bend of its way.
    """
    after, bend = row(work, 0), row(work, 1)
    for k in range(W):
        near[k] = 0
    for stop in range(step.stop_slot.size):
        fill(work, 0.0, 2 * W)
        for j in range(0, step.after.shape[1], COLUMNS):
            a, b, x = step.after[stop], step.bend[stop], row(s, j, COLUMNS)
            a0, a1, a2, a3 = a[j], a[j + 1], a[j + 2], a[j + 3]
            b0, b1, b2, b3 = b[j], b[j + 1], b[j + 2], b[j + 3]
            for k in range(W):
                x0, x1, x2, x3 = x[k], x[W + k], x[2 * W + k], x[3 * W + k]
                after[k] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                bend[k] += b0 * abs(x0) + b1 * abs(x1) + b2 * abs(x2) + b3 * abs(x3)
        q, reach = row(s, step.slot_mass[step.stop_slot[stop]]), step.reach[stop]
        sign, clearance = step.stops[stop, 0], step.stops[stop, 1]
        for k in range(W):
            x0 = sign * q[k] if sign != 0.0 else abs(q[k])
            x1 = sign * after[k] if sign != 0.0 else abs(after[k])
            near[k] |= np.int64(max(x0, x1 + reach) + bend[k] >= clearance)
    count = 0
    for k in range(W):
        index[count] = k
        count += near[k]
    for k in range(count, -(-count // NARROW) * NARROW):
        index[k] = index[0]
    return count


@inlined
def gather(groups: Array, s: Array, index: Integers, count: int, rows: int, stride: int) -> None:
    """Copy the state of the lanes of ``index`` to their groups; the first of them fills up."""
    for c in range(-(-count // NARROW)):
        for r in range(rows):
            to, source = row(groups[c * stride :], r, 1, NARROW), row(s, r)
            for k in range(NARROW):
                to[k] = source[index[c * NARROW + k]]


@inlined
def scatter(s: Array, groups: Array, index: Integers, count: int, rows: int, stride: int) -> None:
    """Copy the state of the groups back to their lanes."""
    for j in range(count):
        group = groups[(j // NARROW) * stride :]
        for r in range(rows):
            s[r * W + index[j]] = group[r * NARROW + j % NARROW]


@inlined
def places(start: Words, index: Integers, count: int, pairs: int) -> None:
    """Write where the words of a small step of a lane lie, behind its block's first one.

    ``start``: (groups, pairs, NARROW), as the words of one draw are.
    """
    many = pairs * NARROW
    for c in range(-(-count // NARROW)):
        to = start[c * many : (c + 1) * many]
        for k in range(NARROW):
            to[k] = (np.uint64(index[c * NARROW + k]) << np.uint64(40)) * GOLDEN
        for k in range(NARROW, many):
            to[k] = to[k - NARROW] + GOLDEN


@njit(inline="always")
def small_steps(
    groups: Array, stride: int, start: Words, count: int, z: Singles, halves: Halves,
    first: np.uint64, step: StepArrays, at_contact: int, pairs: int, force: Any, slope: Any,
) -> None:  # fmt: skip
    """Advance all groups by the small steps of one long one; ``first`` is their first word."""
    n, many = step.matrix.shape[0] // 2, pairs * NARROW
    for t in range(step.small):
        place = first + np.uint64(t * pairs) * GOLDEN
        for c in range(-(-count // NARROW)):
            # Words (as halves: radii, angles) and normals (cosines, sines) in one long loop each.
            own = start[many * c :]
            for k in range(many):
                word = mixed_word(place + own[k])
                halves[k] = np.uint32(word)
                halves[many + k] = np.uint32(word >> np.uint64(32))
            box_muller(z, halves, many)
            s = groups[c * stride : (c + 1) * stride]
            contact_forces(s, at_contact, step, force, slope, NARROW)
            kick_by_contact(s, at_contact, step, n, NARROW)
            map_state(s, z, step.matrix, pairs, NARROW, many, NARROW)
