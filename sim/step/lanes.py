"""Loops over lanes that every step is made of; rows of a block lie one after the other.

A loop is over ``width`` lanes, a constant at each call: by default a whole block. It reads one view
of neighbouring rows and writes another: an index into a view cannot be negative, and two views need
one overlap check, so that the compiler makes vector instructions of the loop.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.numeric.arrays import Array
from fpk.numeric.compiling import njit_inline
from sim.step.arrays import W


@njit_inline
def aligned_rows(rows: int) -> Array:
    """Return rows of zeros that begin at a cache line: no vector of 64 bytes lies across two."""
    memory = np.zeros(rows * W + 8)
    first = (-memory.ctypes.data % 64) // 8
    return memory[first : first + rows * W]


@njit_inline
def row(s: Array, first: int, rows: int = 1, width: int = W) -> Array:
    """Return a view of ``rows`` rows from ``first`` on."""
    return s[first * width : (first + rows) * width]


@njit_inline
def kick(p: Array, g: Array, h: float, a: float, width: int = W) -> None:
    """Take ``h g (1 − a g')`` from p; g holds the rows of g and of g'."""
    for k in range(width):
        p[k] -= h * g[k] * (1.0 - a * g[width + k])


@njit_inline
def fill(target: Array, value: float, width: int = W) -> None:
    """Set a row, or rows of ``width`` lanes together, to one value."""
    for k in range(width):
        target[k] = value


@njit_inline
def copy(target: Array, source: NDArray[Any], width: int = W) -> None:
    """Copy one row, of normals in single precision too."""
    for k in range(width):
        target[k] = source[k]


@njit_inline
def add(target: Array, source: Array, factor: float, width: int = W) -> None:
    """Add ``factor`` times one row to another; no work where the factor is 0."""
    if factor != 0.0:
        for k in range(width):
            target[k] += factor * source[k]


@njit_inline
def add_matrix(
    s: Array, to: int, source: int, matrix: Array, factor: float, width: int = W
) -> None:
    """Add ``factor`` times ``matrix`` times the rows from ``source`` to the rows from ``to``."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            x = row(s, source + j, 1, width)
            add(row(s, to + i, 1, width), x, factor * matrix[i, j], width)


@njit_inline
def multiply(target: Array, source: Array, times: int = 1, width: int = W) -> None:
    """Multiply one row by another, so many ``times``."""
    for _ in range(times):
        for k in range(width):
            target[k] *= source[k]


@njit_inline
def add_product(target: Array, a: Array, b: Array, factor: float, width: int = W) -> None:
    """Add ``factor`` times the product of two rows to another; no work where it is 0."""
    if factor != 0.0:
        for k in range(width):
            target[k] += factor * a[k] * b[k]


@njit_inline
def form_of(
    target: Array, s: Array, first: int, form: Array, factor: float = 1.0, width: int = W
) -> None:
    """Write ``factor`` times xᵀ ``form`` x to a row, x being the rows of ``s`` from ``first``."""
    fill(target, 0.0, width)
    for i in range(form.shape[0]):
        for j in range(form.shape[1]):
            x, y = row(s, first + i, 1, width), row(s, first + j, 1, width)
            add_product(target, x, y, factor * form[i, j], width)
