"""The random linear map ``x <- matrix @ (x, z)`` of a block; z are rows of normals.

Pair j of z is a row of cosines at ``j · pair`` and one of sines ``sines`` behind it, for columns 2j
and 2j + 1. The map goes by pairs of rows and ``COLUMNS`` columns through scratch rows.
"""

from fpk.arrays import Array
from fpk.compiling import inlined
from sim.arrays import COLUMNS
from sim.arrays import LANES as W
from sim.lanes import copy, row
from sim.random import Singles


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


@inlined
def map_state(
    s: Array, z: Singles, A: Array, pairs: int, width: int = W, sines: int = W, pair: int = 2 * W
) -> None:
    """Apply the random linear map to the first rows of ``s``."""
    n = A.shape[0]
    for i in range(pairs):
        copy(row(s, n + 2 * i, 1, width), z[i * pair :], width)
        copy(row(s, n + 2 * i + 1, 1, width), z[i * pair + sines :], width)
    map_by_pairs(s, A, A.shape[1], width)
