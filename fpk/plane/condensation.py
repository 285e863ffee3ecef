"""Static condensation of tensor elements, and the null vector of the condensed system."""

from functools import lru_cache
from typing import NamedTuple

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


def null_vector(
    matrices: Array, masses: Array, counts: tuple[int, int], degree: int
) -> tuple[Array, float]:
    """Return the null vector of the assembled element ``matrices``, of mass 1, and its residual.

    ``masses`` (elements, m) are the integrals of the shape functions; these and the matrices come
    in ``local_order``, coefficients (elements, m) are returned in that of their products. The
    residual is the largest of the global system relative to the terms that cancel in it. The
    unknowns inside every element are eliminated first. Raises ``LinAlgError`` where the rest is
    singular.
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
    numbers, column = edges.numbers.ravel(), local[:, :, None]
    total = np.bincount(numbers, (outer @ column).ravel())
    terms = np.bincount(numbers, (np.abs(outer) @ np.abs(column)).ravel())
    return coefficients, float(np.max(np.abs(total)) / np.max(terms))


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
        try:
            factors = splu(
                matrix[rest][:, rest].tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=PIVOT,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:  # what SuperLU raises for a singular matrix
            raise np.linalg.LinAlgError(str(error)) from None
        x[rest] = factors.solve(-matrix[rest][:, [vertex]].toarray()[:, 0])
        vertex = int(edges.vertices[np.argmax(np.abs(x[edges.vertices]))])
        if np.abs(x[vertex]) * DWARFED <= 1.0:
            break
    return x
