"""Loops over lanes that every step is made of; rows of a block lie one after the other.

A loop is over ``width`` lanes, a constant at each call: by default a whole block.
Each loop works on views of neighbouring rows, one group that is read and one that is written: an
index into a view cannot be negative, and two groups need one overlap check, so that the
compiler turns the loop into vector instructions whatever the number of masses. All are inlined
into the kernel.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiling import FLAGS
from sim.arrays import LANES

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

W = LANES


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def aligned_rows(rows: int) -> Array:
    """Return rows of zeros that begin at a cache line: no vector of 64 bytes lies across two."""
    memory = np.zeros(rows * W + 8)
    first = (-memory.ctypes.data % 64) // 8
    return memory[first : first + rows * W]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def row(s: Array, first: int, rows: int = 1, width: int = W) -> Array:
    """Return a view of ``rows`` rows from ``first`` on."""
    return s[first * width : (first + rows) * width]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def kick(p: Array, g: Array, h: float, a: float, width: int = W) -> None:
    """Take ``h g (1 − a g')`` from p; g holds the rows of g and of g'."""
    for k in range(width):
        p[k] -= h * g[k] * (1.0 - a * g[width + k])


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def fill(target: Array, value: float, width: int = W) -> None:
    """Set a row to one value."""
    for k in range(width):
        target[k] = value


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def copy(target: Array, source: NDArray[Any], width: int = W) -> None:
    """Copy one row, of normals in single precision too."""
    for k in range(width):
        target[k] = source[k]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def add(target: Array, source: Array, factor: float) -> None:
    """Add ``factor`` times one row to another; no work where the factor is 0."""
    if factor != 0.0:
        for k in range(W):
            target[k] += factor * source[k]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def add_matrix(s: Array, to: int, source: int, matrix: Array, factor: float) -> None:
    """Add ``factor`` times ``matrix`` times the rows from ``source`` to the rows from ``to``."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            add(row(s, to + i), row(s, source + j), factor * matrix[i, j])


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def grow(target: Array, source: Array, factor: float) -> None:
    """Multiply one row by ``1 + factor · source``."""
    for k in range(W):
        target[k] *= 1.0 + factor * source[k]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def multiply(target: Array, source: Array) -> None:
    """Multiply one row by another."""
    for k in range(W):
        target[k] *= source[k]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def add_product(target: Array, a: Array, b: Array, factor: float, width: int = W) -> None:
    """Add ``factor`` times the product of two rows to another; no work where it is 0."""
    if factor != 0.0:
        for k in range(width):
            target[k] += factor * a[k] * b[k]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def bin_of(x: Array, low: float, scale: float, bins: int, index: Integers) -> None:
    """Write the bin of every lane into ``index``; ``bins`` stands for outside and for NaN."""
    for k in range(W):
        t = (x[k] - low) * scale
        index[k] = np.int64(t) if (t >= 0.0) & (t < bins) else np.int64(bins)


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def join_bins(index: Integers, second: Integers, rows: int, columns: int) -> None:
    """Replace ``index`` by the bin of a pair; rows · columns stands for outside."""
    for k in range(W):
        inside = (index[k] < rows) & (second[k] < columns)
        index[k] = index[k] * columns + second[k] if inside else rows * columns


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def count(counts: Integers, index: Integers, live: int) -> None:
    """Add one to the bin of each of the first ``live`` lanes."""
    for k in range(live):
        counts[index[k]] += 1
