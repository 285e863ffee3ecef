"""Loops over the lanes (trajectories) of a block, from which every compiled step is built.

The workspace of a block is one array whose rows of ``width`` lanes follow each other; ``width`` is
a constant at each call, by default a whole block of W. Each loop reads one view of neighbouring
rows and writes another: an index into a view cannot be negative, and two views need one overlap
check, so that the compiler makes vector instructions of the loop.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.numeric.arrays import Array
from fpk.numeric.compiling import njit_inline
from sim.step.arrays import W


@njit_inline
def zero_rows(rows: int) -> Array:
    """Return zeros (``rows`` · W,) whose memory begins at a cache line of 64 bytes."""
    memory = np.zeros(rows * W + 8)
    first = (-memory.ctypes.data % 64) // 8
    return memory[first : first + rows * W]


@njit_inline
def row(s: Array, first: int, rows: int = 1, width: int = W) -> Array:
    """Return a view (``rows`` · ``width``,) of the flat ``s``, from row number ``first`` on."""
    return s[first * width : (first + rows) * width]


@njit_inline
def kick(p: Array, g: Array, h: float, a: float, width: int = W) -> None:
    """Subtract ``h`` g (1 − ``a`` g') from ``p``, rows of ``width`` lanes; ``g``: g, then g'."""
    for k in range(width):
        p[k] -= h * g[k] * (1.0 - a * g[width + k])


@njit_inline
def fill(target: Array, value: float, width: int = W) -> None:
    """Set the first ``width`` numbers of ``target`` to ``value``."""
    for k in range(width):
        target[k] = value


@njit_inline
def copy(target: Array, source: NDArray[Any], width: int = W) -> None:
    """Copy ``width`` numbers of ``source``, of single or double precision, to ``target``."""
    for k in range(width):
        target[k] = source[k]


@njit_inline
def add(target: Array, source: Array, factor: float, width: int = W) -> None:
    """Add ``factor`` · ``source`` to ``target``, ``width`` lanes each; a factor 0 does nothing."""
    if factor != 0.0:
        for k in range(width):
            target[k] += factor * source[k]


@njit_inline
def add_matrix(
    s: Array, to: int, source: int, matrix: Array, factor: float, width: int = W
) -> None:
    """Add ``factor`` · ``matrix`` @ x to the rows of ``s`` from ``to``; x: rows from ``source``."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            x = row(s, source + j, 1, width)
            add(row(s, to + i, 1, width), x, factor * matrix[i, j], width)


@njit_inline
def multiply(target: Array, source: Array, times: int = 1, width: int = W) -> None:
    """Multiply ``target`` by ``source`` to the power ``times`` >= 0, rows of ``width`` lanes."""
    for _ in range(times):
        for k in range(width):
            target[k] *= source[k]


@njit_inline
def add_product(target: Array, a: Array, b: Array, factor: float, width: int = W) -> None:
    """Add ``factor`` · ``a`` · ``b`` to ``target``, ``width`` lanes each; 0 does nothing."""
    if factor != 0.0:
        for k in range(width):
            target[k] += factor * a[k] * b[k]


@njit_inline
def quadratic_form(
    target: Array, s: Array, first: int, form: Array, factor: float = 1.0, width: int = W
) -> None:
    """Write ``factor`` · xᵀ ``form`` x to ``target``; x: rows ``first``… of ``s``."""
    fill(target, 0.0, width)
    for i in range(form.shape[0]):
        for j in range(form.shape[1]):
            x, y = row(s, first + i, 1, width), row(s, first + j, 1, width)
            add_product(target, x, y, factor * form[i, j], width)
