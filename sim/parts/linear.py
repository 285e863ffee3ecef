"""The random linear map ``x <- matrix @ (x, z)`` of a block; z are rows of normals.

Pair j of z is a row of cosines at ``j · pair`` and one of sines ``sines`` behind it, for columns 2j
and 2j + 1. These are lower trapezoidal: row i takes the normals 0..i only. One or two masses are
one loop each, in place; more go by pairs of rows and ``COLUMNS`` columns through scratch rows.
"""

from typing import Any

import numpy as np
from numba import njit

from fpk.arrays import Array
from fpk.compiling import inlined
from sim.arrays import COLUMNS, StepArrays
from sim.arrays import LANES as W
from sim.lanes import copy, row
from sim.parts.contact import modified_force, only_stop
from sim.random import Singles

ONE_LOOP = ((1, 1), (2, 2))
"""Masses and pairs of normals that have a loop of their own."""


@inlined
def map_one_mass(
    x: Array, z: Singles, A: Array, step: StepArrays, kick1: bool, force: Any, slope: Any,
    width: int, sines: int,
) -> None:  # fmt: skip
    """Map (q, p) of one mass with one pair of normals, after the kick of its stop if any."""
    h = step.dt
    stop1 = only_stop(step, 0)
    a, b, c = A[0, 0], A[0, 1], A[0, 2]
    d, e, f, g = A[1, 0], A[1, 1], A[1, 2], A[1, 3]
    for k in range(width):
        q, p, z0 = x[k], x[width + k], np.float64(z[k])
        if kick1:
            p -= h * modified_force(q, stop1, force, slope)
        x[k] = a * q + b * p + c * z0
        x[width + k] = d * q + e * p + f * z0 + g * np.float64(z[sines + k])


@inlined
def map_two_masses(
    x: Array, z: Singles, A: Array, step: StepArrays, kick1: bool, kick2: bool, force: Any,
    slope: Any, width: int, sines: int, pair: int,
) -> None:  # fmt: skip
    """Map (q1, q2, p1, p2) with two pairs of normals, after the kicks of stops if any."""
    h = step.dt
    stop1 = only_stop(step, 0)
    stop2 = only_stop(step, 1)
    a0, a1, a2, a3, a4 = A[0, 0], A[0, 1], A[0, 2], A[0, 3], A[0, 4]
    b0, b1, b2, b3, b4, b5 = A[1, 0], A[1, 1], A[1, 2], A[1, 3], A[1, 4], A[1, 5]
    c0, c1, c2, c3, c4, c5, c6 = A[2, 0], A[2, 1], A[2, 2], A[2, 3], A[2, 4], A[2, 5], A[2, 6]
    d0, d1, d2, d3, d4, d5, d6 = A[3, 0], A[3, 1], A[3, 2], A[3, 3], A[3, 4], A[3, 5], A[3, 6]
    d7 = A[3, 7]
    for k in range(width):
        x0, x1, x2, x3 = x[k], x[width + k], x[2 * width + k], x[3 * width + k]
        if kick1:
            x2 -= h * modified_force(x0, stop1, force, slope)
        if kick2:
            x3 -= h * modified_force(x1, stop2, force, slope)
        z0, z1 = np.float64(z[k]), np.float64(z[sines + k])
        z2, z3 = np.float64(z[pair + k]), np.float64(z[pair + sines + k])
        x[k] = a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3 + a4 * z0
        x[width + k] = b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3 + b4 * z0 + b5 * z1
        x[2 * width + k] = c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3 + c4 * z0 + c5 * z1 + c6 * z2
        y = d0 * x0 + d1 * x1 + d2 * x2 + d3 * x3 + d4 * z0 + d5 * z1
        x[3 * width + k] = y + d6 * z2 + d7 * z3


@inlined
def map_by_pairs(s: Array, matrix: Array, scratch: int, width: int) -> None:
    """Map the first rows of ``s`` with the normals in the rows behind them."""
    for i in range(0, matrix.shape[0], 2):
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
    for i in range(matrix.shape[0]):
        copy(row(s, i, 1, width), row(s, scratch + i, 1, width), width)


@njit(inline="always")
def map_state(
    s: Array, z: Singles, A: Array, step: StepArrays, loop: int, kicks: tuple[bool, bool],
    pairs: int, force: Any, slope: Any, width: int = W, sines: int = W, pair: int = 2 * W,
) -> None:  # fmt: skip
    """Apply the random linear map, after the contact kicks that are fused with it.

    ``loop`` 1 or 2 is the loop of one or two masses, 0 that of any number. Inlined before types
    are inferred, so that a constant ``loop`` compiles one of the three.
    """
    if loop == 1:
        map_one_mass(s, z, A, step, kicks[0], force, slope, width, sines)
    elif loop == 2:
        map_two_masses(s, z, A, step, kicks[0], kicks[1], force, slope, width, sines, pair)
    else:
        n = A.shape[0]
        for i in range(pairs):
            copy(row(s, n + 2 * i, 1, width), z[i * pair :], width)
            copy(row(s, n + 2 * i + 1, 1, width), z[i * pair + sines :], width)
        map_by_pairs(s, A, A.shape[1], width)
