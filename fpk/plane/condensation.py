"""Static condensation of tensor elements, and the null vector of what is left."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from fpk.plane.merging import Plan, plan_of, solve_by_merging

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_MERGED = 4
"""Degree from which on elements are merged: below, there is little work in much bookkeeping."""
MOST_MERGED = 1024
"""Elements up to which they are."""


@lru_cache
def local_order(degree: int) -> tuple[Integers, int]:
    """Return the local numbers, those of the element's boundary first, and how many these are."""
    k = degree + 1
    i, j = np.divmod(np.arange(k * k), k)
    inside = (i >= 2) & (j >= 2)
    return np.argsort(inside, kind="stable"), int(np.count_nonzero(~inside))


def axis_numbers(elements: int, degree: int) -> Integers:
    """Global numbers (elements, degree + 1) of the shape functions of one axis: vertices first."""
    vertex = np.arange(elements)[:, None] + np.array([0, 1])
    bubbles = elements + 1 + np.arange(elements * (degree - 1)).reshape(elements, degree - 1)
    return np.hstack([vertex, bubbles])


class Skeleton(NamedTuple):
    """The unknowns on the boundaries of elements, and how to merge these.

    ``numbers`` (elements, boundary unknowns of one) counts them globally from 0 to ``size``,
    ``vertices`` lists those of all vertices.
    """

    numbers: Integers
    size: int
    vertices: Integers
    plan: Plan | None


@lru_cache(maxsize=32)
def skeleton(counts: tuple[int, int], degree: int) -> Skeleton:
    """Return the skeleton of a mesh of ``counts`` elements along each axis."""
    first, second = (axis_numbers(count, degree) for count in counts)
    width = counts[1] * degree + 1
    flat = first[:, None, :, None] * width + second[None, :, None, :]
    order, boundary = local_order(degree)
    used, numbers = np.unique(
        flat.reshape(counts[0] * counts[1], -1)[:, order[:boundary]], return_inverse=True
    )
    vertices = (np.arange(counts[0] + 1)[:, None] * width + np.arange(counts[1] + 1)).ravel()
    numbers = numbers.reshape(counts[0] * counts[1], -1)
    merging = degree >= LEAST_MERGED and len(numbers) <= MOST_MERGED
    plan = plan_of(numbers, counts) if merging else None
    return Skeleton(numbers, used.size, np.searchsorted(used, vertices), plan)


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
    in ``local_order``, coefficients are returned in that of their products. The bubbles of every
    element are eliminated; of the skeleton's equations one vertex's is redundant (the vertex
    functions of all sum to one) and gives way to the mass. Raises ``LinAlgError`` where the rest is
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
    if edges.plan is None:
        local = _solve(outer, mass, edges)[edges.numbers]
    else:
        local = solve_by_merging(outer, mass, edges.plan, edges.vertices)
    coefficients = np.empty(masses.shape)
    coefficients[:, order[:n]] = local
    coefficients[:, order[n:]] = (fold @ local[:, :, None])[:, :, 0]
    return NullVector(coefficients, _residual(outer, local[:, :, None], edges))


def _solve(outer: Array, mass: Array, edges: Skeleton) -> Array:
    numbers, size, row = edges.numbers, edges.size, int(edges.vertices[0])
    right = np.zeros(size)
    right[row] = 1.0
    weights = np.bincount(numbers.ravel(), mass.ravel(), minlength=size)
    rows = np.repeat(numbers, numbers.shape[1], axis=1).ravel()
    columns = np.tile(numbers, (1, numbers.shape[1])).ravel()
    keep = rows != row
    data = np.concatenate([outer.ravel()[keep], weights])
    rows = np.concatenate([rows[keep], np.full(size, row)])
    columns = np.concatenate([columns[keep], np.arange(size)])
    matrix = coo_array((data, (rows, columns)), shape=(size, size)).tocsc()
    return np.asarray(splu(matrix, permc_spec="COLAMD").solve(right))


def _residual(outer: Array, local: Array, edges: Skeleton) -> float:
    numbers, size = edges.numbers.ravel(), edges.size
    total = np.bincount(numbers, (outer @ local).ravel(), minlength=size)
    terms = np.bincount(numbers, (np.abs(outer) @ np.abs(local)).ravel(), minlength=size)
    return float(np.max(np.abs(total)) / np.max(terms))
