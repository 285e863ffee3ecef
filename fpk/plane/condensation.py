"""Static condensation of tensor elements, and the null vector of the condensed system."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

PIVOT = 0.01
"""Least diagonal pivot relative to its column: lower than 1 keeps the symmetric ordering; the
residual is measured on every solution."""
DWARFED = 1e-3
"""Least size of the unknown set to 1 relative to the largest: smaller costs as many digits."""


@lru_cache
def local_order(degree: int) -> tuple[Integers, int]:
    """Return the local numbers, those of the element's boundary first, and how many these are."""
    k = degree + 1
    i, j = np.divmod(np.arange(k * k), k)
    inside = (i >= 2) & (j >= 2)
    return np.argsort(inside, kind="stable"), int(np.count_nonzero(~inside))


class Skeleton(NamedTuple):
    """Unknowns on the boundaries of elements, counted from 0 to ``size``.

    ``numbers`` (elements, boundary unknowns of one); ``vertices`` those of all vertices.
    """

    numbers: Integers
    size: int
    vertices: Integers


@lru_cache(maxsize=32)
def skeleton(counts: tuple[int, int], degree: int) -> Skeleton:
    """Return the skeleton of a mesh of ``counts`` elements along each axis."""
    first, second = (_axis_numbers(count, degree) for count in counts)
    width = counts[1] * degree + 1
    flat = first[:, None, :, None] * width + second[None, :, None, :]
    order, boundary = local_order(degree)
    used, numbers = np.unique(
        flat.reshape(counts[0] * counts[1], -1)[:, order[:boundary]], return_inverse=True
    )
    vertices = (np.arange(counts[0] + 1)[:, None] * width + np.arange(counts[1] + 1)).ravel()
    numbers = numbers.reshape(counts[0] * counts[1], -1)
    return Skeleton(numbers, used.size, np.searchsorted(used, vertices))


def _axis_numbers(elements: int, degree: int) -> Integers:
    """Global numbers (elements, degree + 1) of the shape functions of one axis: vertices first."""
    vertex = np.arange(elements)[:, None] + np.array([0, 1])
    bubbles = elements + 1 + np.arange(elements * (degree - 1)).reshape(elements, degree - 1)
    return np.hstack([vertex, bubbles])


@dataclass(frozen=True, eq=False)
class NullVector:
    """Coefficients (elements, (degree+1)²) of the stationary density with mass 1.

    ``residual`` is the largest entry of the global system relative to the terms that cancel in it.
    """

    coefficients: Array
    residual: float


def null_vector(matrices: Array, masses: Array, counts: tuple[int, int], degree: int) -> NullVector:
    """Return the null vector of the assembled element ``matrices``, scaled by ``masses``.

    ``masses`` (elements, m) are the integrals of the shape functions; these and the matrices come
    in ``local_order``, coefficients are returned in that of their products. The unknowns inside
    every element are eliminated first. Raises ``LinAlgError`` where the rest is singular.
    """
    order, n = local_order(degree)
    outer, mass = matrices[:, :n, :n], masses[:, :n]
    fold: Array = np.zeros((len(matrices), order.size - n, n))
    if order.size > n:
        fold = np.asarray(-np.linalg.solve(matrices[:, n:, n:], matrices[:, n:, :n]))
        outer = np.asarray(outer + matrices[:, :n, n:] @ fold)
        mass = np.asarray(mass + (masses[:, None, n:] @ fold)[:, 0])
    edges = skeleton(counts, degree)
    local = _solve(outer, edges)[edges.numbers]
    local = local / np.sum(mass * local)
    coefficients = np.empty(masses.shape)
    coefficients[:, order[:n]] = local
    coefficients[:, order[n:]] = (fold @ local[:, :, None])[:, :, 0]
    return NullVector(coefficients, _residual(outer, local[:, :, None], edges))


def _solve(outer: Array, edges: Skeleton) -> Array:
    """The null vector up to a factor: one vertex is set to 1 and its equation left out.

    The vertex functions sum to one, so that their equations add up to 0 = 0 and each is redundant.
    Solved again with the largest vertex set to 1 where the first one turns out too small.
    """
    numbers, size = edges.numbers, edges.size
    rows = np.repeat(numbers, numbers.shape[1], axis=1).ravel()
    columns = np.tile(numbers, (1, numbers.shape[1])).ravel()
    matrix = coo_array((outer.ravel(), (rows, columns)), shape=(size, size)).tocsr()
    vertex = int(edges.vertices[0])
    for _ in range(2):
        rest = np.delete(np.arange(size), vertex)
        x = np.ones(size)
        x[rest] = _sparse_solve(matrix[rest], rest, vertex)
        vertex = int(edges.vertices[np.argmax(np.abs(x[edges.vertices]))])
        if np.abs(x[vertex]) * DWARFED <= 1.0:
            break
    return x


def _sparse_solve(matrix: Any, rest: Integers, vertex: int) -> Array:
    right = -matrix[:, [vertex]].toarray()[:, 0]
    try:
        factors = splu(
            matrix[:, rest].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=PIVOT,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:  # what SuperLU raises for a singular matrix
        raise np.linalg.LinAlgError(str(error)) from None
    return np.asarray(factors.solve(right))


def _residual(outer: Array, local: Array, edges: Skeleton) -> float:
    numbers, size = edges.numbers.ravel(), edges.size
    total = np.bincount(numbers, (outer @ local).ravel(), minlength=size)
    terms = np.bincount(numbers, (np.abs(outer) @ np.abs(local)).ravel(), minlength=size)
    return float(np.max(np.abs(total)) / np.max(terms))
