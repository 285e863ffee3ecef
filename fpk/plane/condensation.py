"""Static condensation of tensor elements, and the null vector of the condensed system."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from fpk.arrays import Array, Integers

PIVOT = 0.01
"""Least diagonal pivot relative to its column: lower than 1 keeps the symmetric ordering; the
residual is measured on every solution."""
MASS_SCALE = 1e-6
"""Largest entry of the equation of the mass relative to that of the others: as a pivot before the
last one it would cost digits."""
DWARFED = 1e-3
"""Least value at the vertex whose equation is left out, relative to that of the largest vertex:
smaller costs as many digits."""


@lru_cache
def local_order(degree: int) -> tuple[Integers, int]:
    """Return the local numbers, those of the element's boundary first, and how many these are."""
    k = degree + 1
    i, j = np.divmod(np.arange(k * k), k)
    inside = (i >= 2) & (j >= 2)
    return np.argsort(inside, kind="stable"), int(np.count_nonzero(~inside))


class Skeleton(NamedTuple):
    """Unknowns on the boundaries of elements, and the pattern of their matrix by columns.

    ``numbers`` (elements, boundary unknowns of one) of the unknowns and ``vertices`` those of the
    vertices. ``indices`` and ``starts`` are those of scipy's CSC format, every column with its row
    0; ``places`` (entries of all element matrices) are theirs in it.
    """

    numbers: Integers
    vertices: Integers
    indices: Integers
    starts: Integers
    places: Integers


@lru_cache(maxsize=32)
def skeleton(counts: tuple[int, int], degree: int, first: int = 0) -> Skeleton:
    """Return the skeleton of ``counts`` elements along each axis; vertex ``first`` is unknown 0."""
    along = [axis_numbers(count, degree) for count in counts]
    width = counts[1] * degree + 1
    flat = along[0][:, None, :, None] * width + along[1][None, :, None, :]
    order, boundary = local_order(degree)
    local = flat.reshape(counts[0] * counts[1], -1)[:, order[:boundary]]
    corners = (np.arange(counts[0] + 1)[:, None] * width + np.arange(counts[1] + 1)).ravel()
    local[local == corners[first]] = -1
    corners[first] = -1
    used, numbers = np.unique(local, return_inverse=True)
    size, numbers = used.size, numbers.reshape(local.shape)
    keys = numbers[:, None, :] * size + numbers[:, :, None]
    pattern = np.union1d(keys, np.arange(size) * size)
    columns, indices = np.divmod(pattern, size)
    starts = np.searchsorted(columns, np.arange(size + 1))
    places = np.searchsorted(pattern, keys.ravel())
    return Skeleton(numbers, np.searchsorted(used, corners), indices, starts, places)


def axis_numbers(elements: int, degree: int) -> Integers:
    """Return the global numbers (elements, degree + 1) of one axis's functions: vertices first."""
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
    unknowns inside every element are eliminated first. The vertex functions sum to one, so that
    their equations add up to 0 = 0 and one of them gives way to the mass. Raises ``LinAlgError``
    where the rest is singular.
    """
    order, n = local_order(degree)
    outer, mass = matrices[:, :n, :n], masses[:, :n]
    fold: Array = np.zeros((len(matrices), order.size - n, n))
    if order.size > n:
        fold = np.asarray(-np.linalg.solve(matrices[:, n:, n:], matrices[:, n:, :n]))
        outer = np.asarray(outer + matrices[:, :n, n:] @ fold)
        mass = np.asarray(mass + (masses[:, None, n:] @ fold)[:, 0])
    edges = skeleton(counts, degree)
    x = _solve(outer, mass, edges)
    largest = int(np.argmax(np.abs(x[edges.vertices])))
    if np.abs(x[0]) < DWARFED * np.abs(x[edges.vertices[largest]]):
        edges = skeleton(counts, degree, largest)
        x = _solve(outer, mass, edges)
    local = x[edges.numbers]
    coefficients = np.empty(masses.shape)
    coefficients[:, order[:n]] = local
    coefficients[:, order[n:]] = (fold @ local[:, :, None])[:, :, 0]
    numbers, column = edges.numbers.ravel(), local[:, :, None]
    total = np.bincount(numbers, (outer @ column).ravel())
    terms = np.bincount(numbers, (np.abs(outer) @ np.abs(column)).ravel())
    return coefficients, float(np.max(np.abs(total)) / np.max(terms))


def _solve(outer: Array, mass: Array, edges: Skeleton) -> Array:
    """The null vector of ``mass`` 1, which takes the place of the equation of unknown 0."""
    size = edges.starts.size - 1
    entries = np.bincount(edges.places, outer.ravel())
    shares = np.bincount(edges.numbers.ravel(), mass.ravel())
    scale = MASS_SCALE * np.abs(entries).max() / np.abs(shares).max()
    entries[edges.starts[:-1]] = scale * shares
    try:
        factors = splu(
            csc_array((entries, edges.indices, edges.starts), shape=(size, size)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=PIVOT,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:  # what SuperLU raises for a singular matrix
        raise np.linalg.LinAlgError(str(error)) from None
    return np.asarray(factors.solve(np.append(scale, np.zeros(size - 1))))
