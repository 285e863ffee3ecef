"""Tensor elements of two energies: matrices by sum factorisation, condensation, null vector.

The weak form of (19) with zero flux at infinity is ``∫ J · ∇v = 0`` for all test functions v, with
``J_i = (s_i − ½ ∂_j b_ij) p − ½ b_ij ∂_j p``. Shape functions are products of scikit-fem's line
elements; sums over two-dimensional quadrature points are done one direction at a time.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from fpk.numeric.arrays import SMALLEST, Array, Integers
from fpk.numeric.errors import NotCertified
from fpk.numeric.piecewise import PiecewiseTensor, projection
from fpk.numeric.quadrature import gauss_grid, gauss_legendre
from fpk.solvers.plane.weight import Weight
from fpk.system.process import Process

Nodes = tuple[Array, Array]


@lru_cache
def local_order(degree: int) -> Integers:
    """Return the numbers of an element's functions, the 4 ``degree`` on its boundary first: φ_i(H1)
    φ_j(H2), i and j from 0 to ``degree``, has the number i (``degree`` + 1) + j."""
    i, j = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    return np.argsort((i >= 2) & (j >= 2), kind="stable")


def axis_numbers(elements: int, degree: int) -> Integers:
    """Return the global numbers (``elements``, ``degree`` + 1) of each element's functions along an
    axis, its two vertices first: vertices have lower numbers than functions inside elements."""
    vertex = np.arange(elements)[:, None] + np.array([0, 1])
    bubbles = elements + 1 + np.arange(elements * (degree - 1)).reshape(elements, degree - 1)
    return np.hstack([vertex, bubbles])


def local_numbers(nodes: Nodes, degree: int) -> Integers:
    """Return global numbers (elements, (degree + 1)²) of each element's functions. ``nodes`` ascend
    along both axes; the functions of ``degree`` are in ``local_order``."""
    first, second = (axis_numbers(x.size - 1, degree) for x in nodes)
    flat = first[:, None, :, None] * (len(second) * degree + 1) + second[None, :, None, :]
    return flat.reshape(len(first) * len(second), -1)[:, local_order(degree)]


def assemble(matrices: Array, numbers: Integers) -> csc_array:
    """Return the sparse sum of element ``matrices`` (elements, m, m). ``numbers`` (elements, m) are
    the global numbers of the functions."""
    m, size = numbers.shape[1], int(numbers.max()) + 1
    places = np.repeat(numbers, m, axis=1).ravel(), np.tile(numbers, (1, m)).ravel()
    return csc_array((matrices.ravel(), places), shape=(size, size))


def lu_factors(
    matrix: csc_array, refusal: str = "the equations of a step in time have no unique solution"
) -> SuperLU:
    """Return the LU factors of ``matrix`` in a symmetric ordering, with pivots on the diagonal.

    Without row exchanges the accuracy does not depend on the scales of rows and columns, which vary
    by many decades. Raises ``NotCertified(refusal)`` if the matrix is singular.
    """
    symmetric = {"SymmetricMode": True}
    try:
        return splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    except RuntimeError:  # what SuperLU raises for a singular matrix
        raise NotCertified(refusal) from None


def null_vector(matrix: csc_array, vertices: Integers) -> tuple[Array, float]:
    """Return the null vector of a ``matrix`` whose columns add up to 0, and its relative residual.

    The vertex functions sum to 1, so that the equation of one vertex is redundant; its unknown is
    set to 1. ``vertices`` are the numbers of all vertex unknowns. The first is tried, and then, if
    it is less than 1e-3 of the largest, the largest, as a small pivot costs its digits. Raises
    ``NotCertified`` if the null vector is not unique.
    """
    held, starts, rows = int(vertices[0]), matrix.indptr, matrix.indices
    for _ in range(2):
        entries, own = matrix.data.copy(), slice(starts[held], starts[held + 1])
        scale = float(np.abs(entries[own]).max())
        right = np.zeros(matrix.shape[0])
        right[rows[own]] = -entries[own]
        entries[rows == held] = entries[own] = 0.0
        entries[own][rows[own] == held], right[held] = scale, scale
        pinned = csc_array((entries, rows, starts))
        factors = lu_factors(pinned, "the stationary equation has no unique solution on this mesh")
        y = factors.solve(right)
        y += factors.solve(right - pinned @ y)
        largest = int(vertices[np.argmax(np.abs(y[vertices]))])
        if not np.abs(y[largest]) > 1e3:
            break
        held = largest
    return y, float(np.max(np.abs(matrix @ y)) / np.max(abs(matrix) @ np.abs(y)))


def null_function(
    process: Process, nodes: Nodes, degree: int, points: int, weight: Weight
) -> tuple[PiecewiseTensor, float]:
    """Return u of the stationary density p = w u, up to a factor, and the relative residual.

    u has the ``degree`` along each axis between ``nodes``; w is the ``weight``; ``points`` is the
    number of Gauss points of an element along each axis. Raises as ``null_vector`` does.
    """
    (x, y), _ = gauss_grid(nodes, points=points)
    matrices = element_matrices(flux_coefficients(process, x, y, weight)[1:], nodes, degree)
    # The unknowns inside every element are eliminated first.
    order, n, k = local_order(degree), 4 * degree, degree + 1
    fold = -np.linalg.solve(matrices[:, n:, n:], matrices[:, n:, :n])
    _, numbers = np.unique(local_numbers(nodes, degree)[:, :n], return_inverse=True)
    numbers = numbers.reshape(-1, n)
    vertices = np.unique(numbers[:, [0, 1, degree + 1, degree + 2]])
    outer = assemble(matrices[:, :n, :n] + matrices[:, :n, n:] @ fold, numbers)
    y, residual = null_vector(outer, vertices)
    null = np.empty((len(matrices), k * k))
    null[:, order[:n]] = own = y[numbers]
    null[:, order[n:]] = (fold @ own[:, :, None])[:, :, 0]
    # Shape functions as Legendre series.
    values, _ = shape_functions(degree, 0.5 * (1.0 + gauss_legendre(points)[0]))
    series = values @ projection(points - 1)[:k].T
    u = (series.T @ null.reshape(-1, k, k) @ series).reshape(nodes[0].size - 1, -1, k, k)
    return PiecewiseTensor(nodes, u), residual


def shape_functions(degree: int, t: Array) -> tuple[Array, Array]:
    """Return hierarchical shape functions and slopes (``degree`` + 1, points) at ``t`` in [0, 1].

    The first two belong to the left and right vertex. The others vanish at both; they are
    (P_j − P_(j−2))/√(4j − 2), P_j Legendre polynomials, as in scikit-fem.
    """
    P = legvander(2.0 * t - 1.0, degree).T
    j = np.arange(2.0, degree + 1.0)[:, None]
    scale, one = 1.0 / np.sqrt(4.0 * j - 2.0), np.ones_like(t)
    values = np.concatenate([[1.0 - t, t], (P[2:] - P[:-2]) * scale])
    return values, np.concatenate([[-one, one], (4.0 * j - 2.0) * scale * P[1:-1]])


def by_element(values: Array, counts: tuple[int, int]) -> Array:
    """Return ``values`` (…, along H1, along H2) by element (…, elements, q, q), H2 fastest.
    ``counts`` are the numbers of elements along H1 and H2."""
    *more, first, second = values.shape
    blocks = values.reshape(*more, counts[0], first // counts[0], counts[1], second // counts[1])
    blocks = np.moveaxis(blocks, -3, -2)
    return np.ascontiguousarray(blocks).reshape(*more, -1, *blocks.shape[-2:])


def flux_coefficients(
    process: Process, H1: Array, H2: Array, weight: Weight, *, balanced: bool = False
) -> Array:
    """Return w, w a_1, w a_2, w b_11, w b_12, w b_22 (6, ...) at ``H1``, ``H2`` that broadcast.

    With p = w u the flux is ``J_i = w (a_i u − ½ b_ij ∂_j u)``, a = s − ½ ∇·b + ½ b ∇ ln w.
    ``balanced``: the ``weight`` without its floor is the density of zero flux, and
    s − ½ ∇·b = ½ b ∇Φ is not computed from s.
    """
    shape = np.broadcast_shapes(H1.shape, H2.shape)
    points = np.empty((*shape, 2))
    points[..., 0], points[..., 1] = H1, H2
    c = process.coefficients(points.reshape(-1, 2))
    out, b = np.zeros((6, *shape)), c.diffusion.reshape(*shape, 2, 2)
    out[3], out[4], out[5] = b[..., 0, 0], b[..., 0, 1], b[..., 1, 1]
    if not balanced:
        out[1:3] = (c.drift - 0.5 * c.divergence).T.reshape(2, *shape)
    out[0] = weight(H1, H2)
    # Without a floor w may underflow: floor/w is then 0/SMALLEST = 0, and w a = 0.
    floor = weight.floor / np.maximum(out[0], SMALLEST)
    share = -0.5 * floor if balanced else 0.5 - 0.5 * floor
    first, second = (share * slope for slope in weight.slopes(H1, H2))
    out[1] += out[3] * first + out[4] * second
    out[2] += out[4] * first + out[5] * second
    out[1:] *= out[0]
    return out


@lru_cache
def _quadrature_products(degree: int, points: int) -> tuple[Array, Array, Array, Array, Integers]:
    """Weighted products of test and trial functions at Gauss ``points``, (points, (degree+1)²).

    They are value·value, slope·value, value·slope and slope·slope, test first, on the unit
    interval. The last array are the places of an element matrix in ``local_order`` in the product
    matrix with pairs (test, trial) along H1 as rows and along H2 as columns.
    """
    t, w = gauss_legendre(points)
    phi, dphi = shape_functions(degree, 0.5 * (1.0 + t))
    pairs = [(phi, phi), (dphi, phi), (phi, dphi), (dphi, dphi)]
    vv, sv, vs, ss = (np.einsum("q,iq,jq->qij", 0.5 * w, *f).reshape(points, -1) for f in pairs)
    k = degree + 1
    i, m = np.divmod(local_order(degree), k)
    places = (i[:, None] * k + i) * k * k + m[:, None] * k + m
    return vv, sv, vs, ss, places.ravel()


def element_matrices(coefficients: Array, nodes: Nodes, degree: int) -> Array:
    """Return element matrices (elements, m, m), test functions φ_i first, in ``local_order``.

    ``coefficients`` (…, along H1, along H2) on the grid of Gauss points are the five w a and w b of
    ``flux_coefficients`` for ∫ w (a φ_j − ½ b ∇φ_j)·∇φ_i, or w alone for ∫ w φ_i φ_j. ``nodes``
    ascend; ``degree`` is the same along both axes.
    """
    # Lengths (elements, 1, 1) of the elements.
    h1, h2 = (h.reshape(-1, 1, 1) for h in np.meshgrid(*map(np.diff, nodes), indexing="ij"))
    first, *more = by_element(coefficients, (nodes[0].size - 1, nodes[1].size - 1))
    vv, sv, vs, ss, places = _quadrature_products(degree, first.shape[-1])
    # Sums over H2 first: for every Gauss point of H1 a small matrix over (k, l).
    if not more:
        outer, inner = [vv], [(h1 * h2 * first) @ vv]
    else:
        a2, b11, b12, b22 = more
        slope_slope = (-0.5 * h2 / h1 * b11) @ vv
        value_value = (h1 * a2) @ sv + (-0.5 * h1 / h2 * b22) @ ss
        outer, inner = [ss, sv, vv], [slope_slope, (h2 * first) @ vv, value_value]
        if np.any(b12):
            inner[1] += (-0.5 * b12) @ vs
            outer.append(vs)
            inner.append((-0.5 * b12) @ sv)
    factors = np.concatenate(outer).T
    m = (degree + 1) ** 2
    matrices = np.empty((h1.size, m, m))
    for matrix, *parts in zip(matrices, *inner, strict=True):
        np.take((factors @ np.concatenate(parts)).ravel(), places, out=matrix.reshape(-1))
    return matrices
