"""Static condensation of tensor elements, and the null vector of what is left."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

DENSE_UNKNOWNS = 1500
"""Unknowns of the skeleton up to which a dense factorisation is the faster one."""


@lru_cache
def split(degree: int) -> tuple[Integers, Integers]:
    """Return the local numbers on the element's boundary and those of the bubbles inside."""
    k = degree + 1
    i, j = np.divmod(np.arange(k * k), k)
    inside = (i >= 2) & (j >= 2)
    return np.flatnonzero(~inside), np.flatnonzero(inside)


def axis_numbers(elements: int, degree: int) -> Integers:
    """Global numbers (elements, degree + 1) of the shape functions of one axis: vertices first."""
    vertex = np.arange(elements)[:, None] + np.array([0, 1])
    bubbles = elements + 1 + np.arange(elements * (degree - 1)).reshape(elements, degree - 1)
    return np.hstack([vertex, bubbles])


def skeleton_numbers(counts: tuple[int, int], degree: int) -> tuple[Integers, int, Integers]:
    """Return the numbers of the boundary unknowns of each element, their count and the vertices'.

    The first array is (elements, boundary unknowns of one), the last lists all vertices.
    """
    first, second = (axis_numbers(count, degree) for count in counts)
    width = counts[1] * degree + 1
    flat = first[:, None, :, None] * width + second[None, :, None, :]
    boundary, _ = split(degree)
    used, numbers = np.unique(
        flat.reshape(counts[0] * counts[1], -1)[:, boundary], return_inverse=True
    )
    vertices = (np.arange(counts[0] + 1)[:, None] * width + np.arange(counts[1] + 1)).ravel()
    return (
        numbers.reshape(counts[0] * counts[1], -1),
        used.size,
        np.searchsorted(used, vertices),
    )


@dataclass(frozen=True, eq=False)
class NullVector:
    """Coefficients (elements, (degree+1)²) of the stationary density with mass 1.

    ``residual`` is the largest entry of the global system relative to the terms that cancel in it.
    """

    coefficients: Array
    residual: float


def null_vector(matrices: Array, masses: Array, counts: tuple[int, int], degree: int) -> NullVector:
    """Return the null vector of the assembled element ``matrices``, scaled by ``masses``.

    ``masses`` (elements, m) are the integrals of the shape functions. The bubbles of every element
    are eliminated; of the skeleton's equations one vertex's is redundant (the vertex functions of
    all sum to one) and gives way to the mass. Raises ``LinAlgError`` where the rest is singular.
    """
    boundary, inside = split(degree)
    outer: Array = np.asarray(matrices[:, boundary[:, None], boundary])
    mass: Array = np.asarray(masses[:, boundary])
    fold: Array = np.zeros((matrices.shape[0], inside.size, boundary.size))
    if inside.size:
        inner = matrices[:, inside[:, None], inside]
        fold = np.asarray(-np.linalg.solve(inner, matrices[:, inside[:, None], boundary]))
        outer = np.asarray(outer + matrices[:, boundary[:, None], inside] @ fold)
        mass = np.asarray(mass + (masses[:, None, inside] @ fold)[:, 0])
    numbers, size, vertices = skeleton_numbers(counts, degree)
    row = int(vertices[0])
    u = _solve(outer, mass, numbers, size, row)
    coefficients = np.empty(masses.shape)
    coefficients[:, boundary] = u[numbers]
    coefficients[:, inside] = (fold @ u[numbers][:, :, None])[:, :, 0]
    return NullVector(coefficients, _residual(outer, u, numbers, size))


def _solve(outer: Array, mass: Array, numbers: Integers, size: int, row: int) -> Array:
    right = np.zeros(size)
    right[row] = 1.0
    weights = np.bincount(numbers.ravel(), mass.ravel(), minlength=size)
    rows = np.repeat(numbers, numbers.shape[1], axis=1).ravel()
    columns = np.tile(numbers, (1, numbers.shape[1])).ravel()
    if size <= DENSE_UNKNOWNS:
        flat = np.bincount(rows * size + columns, outer.ravel(), minlength=size * size)
        dense = flat.reshape(size, size)
        dense[row] = weights
        return np.asarray(np.linalg.solve(dense, right))
    keep = rows != row
    data = np.concatenate([outer.ravel()[keep], weights])
    rows = np.concatenate([rows[keep], np.full(size, row)])
    columns = np.concatenate([columns[keep], np.arange(size)])
    matrix = coo_array((data, (rows, columns)), shape=(size, size)).tocsc()
    return np.asarray(splu(matrix, permc_spec="COLAMD").solve(right))


def _residual(outer: Array, u: Array, numbers: Integers, size: int) -> float:
    local = u[numbers][:, :, None]
    total = np.bincount(numbers.ravel(), (outer @ local).ravel(), minlength=size)
    terms = np.bincount(numbers.ravel(), (np.abs(outer) @ np.abs(local)).ravel(), minlength=size)
    return float(np.max(np.abs(total)) / np.max(terms))
