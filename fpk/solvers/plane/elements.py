"""Tensor elements of two energies: matrices by sum factorisation, condensation, the null vector.

The weak form of (19) with zero flux at infinity is ``∫ J · ∇v = 0`` for all test functions, with
``J_i = (s_i − ½ ∂_j b_ij) p − ½ b_ij ∂_j p``. Shape functions are products of scikit-fem's line
elements; every sum over two-dimensional quadrature points is done one direction at a time.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import NotCertified
from fpk.numeric.quadrature import gauss_legendre
from fpk.solvers.plane.weight import Weight
from fpk.system.process import Process


@lru_cache
def local_order(degree: int) -> tuple[Integers, int]:
    """Return the local numbers, those of the element's boundary first, and how many these are."""
    k = degree + 1
    i, j = np.divmod(np.arange(k * k), k)
    inside = (i >= 2) & (j >= 2)
    return np.argsort(inside, kind="stable"), int(np.count_nonzero(~inside))


def axis_numbers(elements: int, degree: int) -> Integers:
    """Return the global numbers (elements, degree + 1) of one axis's functions: vertices first."""
    vertex = np.arange(elements)[:, None] + np.array([0, 1])
    bubbles = elements + 1 + np.arange(elements * (degree - 1)).reshape(elements, degree - 1)
    return np.hstack([vertex, bubbles])


@lru_cache(maxsize=32)
def _skeleton(counts: tuple[int, int], degree: int) -> tuple[Integers, ...]:
    """Return the numbers of the unknowns on boundaries of elements, and their matrix's pattern.

    ``numbers`` (elements, boundary unknowns of one), ``vertices`` among them; ``indices`` and
    ``starts`` of scipy's CSC format, ``places`` (entries of all element matrices) in it.
    """
    along = [axis_numbers(count, degree) for count in counts]
    width = counts[1] * degree + 1
    flat = along[0][:, None, :, None] * width + along[1][None, :, None, :]
    order, boundary = local_order(degree)
    local = flat.reshape(counts[0] * counts[1], -1)[:, order[:boundary]]
    corners = (np.arange(counts[0] + 1)[:, None] * width + np.arange(counts[1] + 1)).ravel()
    used, numbers = np.unique(local, return_inverse=True)
    size, numbers = used.size, numbers.reshape(local.shape)
    keys = numbers[:, None, :] * size + numbers[:, :, None]
    pattern = np.unique(keys)
    columns, indices = np.divmod(pattern, size)
    starts = np.searchsorted(columns, np.arange(size + 1))
    return numbers, np.searchsorted(used, corners), indices, starts, np.searchsorted(pattern, keys)


def factorised(matrix: csc_array) -> SuperLU:
    """Return the LU factors in a symmetric ordering; the residual of every solution is measured.

    Raises ``NotCertified`` where the matrix is singular.
    """
    try:
        # A diagonal pivot down to 0.01 of its column keeps that ordering.
        return splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.01,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # what SuperLU raises for a singular matrix
        raise NotCertified("the stationary equation has no unique solution on this mesh") from None


def null_vector(matrix: csc_array, vertices: Integers) -> tuple[Array, float]:
    """Return the null vector of a matrix whose columns add up to 0, and its relative residual.

    The vertex functions sum to one: the equation of one of the ``vertices`` is redundant, and its
    value is held at 1; at the vertex of the largest value, as a small one costs its digits. The
    residual is relative to the terms that cancel.
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
        factors = factorised(pinned)
        y = factors.solve(right)
        y += factors.solve(right - pinned @ y)
        largest = int(vertices[np.argmax(np.abs(y[vertices]))])
        if not np.abs(y[largest]) > 1e3:
            break
        held = largest
    return y, float(np.max(np.abs(matrix @ y)) / np.max(abs(matrix) @ np.abs(y)))


def condensed_null_vector(
    matrices: Array, counts: tuple[int, int], degree: int
) -> tuple[Array, float]:
    """Return the coefficients (elements, m) of the null vector of the assembled ``matrices``.

    They come in ``local_order``, the coefficients in that of their products. The unknowns inside
    every element are eliminated first.
    """
    order, n = local_order(degree)
    outer = matrices[:, :n, :n]
    fold: Array = np.zeros((len(matrices), order.size - n, n))
    if order.size > n:
        fold = np.asarray(-np.linalg.solve(matrices[:, n:, n:], matrices[:, n:, :n]))
        outer = np.asarray(outer + matrices[:, :n, n:] @ fold)
    numbers, vertices, indices, starts, places = _skeleton(counts, degree)
    entries = np.bincount(places.ravel(), outer.ravel())
    y, residual = null_vector(csc_array((entries, indices, starts)), vertices)
    coefficients = np.empty((len(matrices), order.size))
    coefficients[:, order[:n]] = local = y[numbers]
    coefficients[:, order[n:]] = (fold @ local[:, :, None])[:, :, 0]
    return coefficients, residual


def shape_functions(degree: int, t: Array) -> tuple[Array, Array]:
    """Return the hierarchical shape functions and derivatives (degree + 1, points) at t in [0, 1].

    The first two belong to the left and right vertex, the others vanish there: integrals of
    Legendre polynomials, (P_j − P_(j−2))/√(4j − 2), of the scale of scikit-fem's.
    """
    P = legvander(2.0 * t - 1.0, degree).T
    j = np.arange(2.0, degree + 1.0)[:, None]
    scale, one = 1.0 / np.sqrt(4.0 * j - 2.0), np.ones_like(t)
    values = np.concatenate([[1.0 - t, t], (P[2:] - P[:-2]) * scale])
    slopes = np.concatenate([[-one, one], (4.0 * j - 2.0) * scale * P[1:-1]])
    return values, slopes


def by_element(values: Array, counts: tuple[int, int]) -> Array:
    """Return values (…, points along H1, along H2) element by element (…, elements, q, q).

    The elements, ``counts`` along each axis, run along H2 fastest.
    """
    *more, first, second = values.shape
    blocks = values.reshape(*more, counts[0], first // counts[0], counts[1], second // counts[1])
    blocks = np.moveaxis(blocks, -3, -2)
    return np.ascontiguousarray(blocks).reshape(*more, -1, *blocks.shape[-2:])


def coefficients_on_grid(process: Process, H1: Array, H2: Array, weight: Weight | None) -> Array:
    """Return a_1, a_2, b_11, b_12, b_22 (5, H1.size, H2.size) of ``J_i = a_i u − ½ b_ij ∂_j u``.

    With p = w u, w = exp(−Φ), the flux is ``J_i = w (s_i − ½ ∂_j b_ij + ½ b_ij ∂_j Φ) u
    − ½ w b_ij ∂_j u``; w = 1 without a ``weight``.
    """
    shape = H1.size, H2.size
    points = np.empty((*shape, 2))
    points[..., 0], points[..., 1] = H1[:, None], H2
    c = process.coefficients(points.reshape(-1, 2))
    out = np.empty((5, *shape))
    out[:2] = (c.drift - 0.5 * c.divergence).T.reshape(2, *shape)
    b = c.diffusion.reshape(*shape, 2, 2)
    out[2], out[3], out[4] = b[..., 0, 0], b[..., 0, 1], b[..., 1, 1]
    if weight is None:
        return out
    w, first, second = weight.on_grid(H1, H2)
    out[0] += 0.5 * (out[2] * first + out[3] * second)
    out[1] += 0.5 * (out[3] * first + out[4] * second)
    return np.asarray(w * out)


@lru_cache
def _products(degree: int, points: int) -> tuple[Array, Array, Array, Array, Integers]:
    """Weighted products of test and trial functions at Gauss points, (points, (degree+1)²) each.

    Order: value·value, slope·value, value·slope, slope·slope (test first), on the unit interval.
    Then the positions of the entries of an element matrix in ``local_order``, where rows are pairs
    (i, j) of test and trial functions along H1, columns those along H2.
    """
    t, w = gauss_legendre(points)
    phi, dphi = shape_functions(degree, 0.5 * (1.0 + t))
    pairs = [(phi, phi), (dphi, phi), (phi, dphi), (dphi, dphi)]
    vv, sv, vs, ss = (
        np.einsum("q,iq,jq->qij", 0.5 * w, test, trial).reshape(points, -1) for test, trial in pairs
    )
    k = degree + 1
    i, m = np.divmod(local_order(degree)[0], k)
    places = (i[:, None] * k + i) * k * k + m[:, None] * k + m
    return vv, sv, vs, ss, places.ravel()


def element_matrices(coefficients: Array, sizes: Array, degree: int) -> Array:
    """Return the element matrices (elements, m, m), m = (degree+1)², test functions first.

    ``coefficients`` (5, elements, q, q) are those of ``coefficients_on_grid`` at Gauss points,
    ``sizes`` (elements, 2) the lengths along H1 and H2. The local number of φ_i ψ_k is
    i(degree+1)+k; they come in ``local_order``.
    """
    a1, a2, b11, b12, b22 = coefficients
    vv, sv, vs, ss, places = _products(degree, a1.shape[-1])
    h1, h2 = sizes[:, 0, None, None], sizes[:, 1, None, None]
    # Along H2 first: for every Gauss point of H1 a small matrix over (k, l).
    slope_slope = (-0.5 * h2 / h1 * b11) @ vv
    slope_value = (h2 * a1) @ vv
    value_value = (h1 * a2) @ sv + (-0.5 * h1 / h2 * b22) @ ss
    outer, inner = [ss, sv, vv], [slope_slope, slope_value, value_value]
    if np.any(b12):
        inner[1] += (-0.5 * b12) @ vs
        outer.append(vs)
        inner.append((-0.5 * b12) @ sv)
    factors = np.concatenate(outer).T
    m = (degree + 1) ** 2
    matrices = np.empty((len(sizes), m, m))
    for matrix, *parts in zip(matrices, *inner, strict=True):
        np.take((factors @ np.concatenate(parts)).ravel(), places, out=matrix.reshape(-1))
    return matrices


def mass_matrices(weights: Array, sizes: Array, degree: int) -> Array:
    """Return ∫ w φ_i φ_j of each element (elements, m, m), in ``local_order``.

    ``weights`` (elements, q, q) is w at Gauss points, ``sizes`` (elements, 2) as above.
    """
    vv, *_, places = _products(degree, weights.shape[-1])
    m = (degree + 1) ** 2
    area = sizes[:, 0, None, None] * sizes[:, 1, None, None]
    matrices = vv.T @ (area * weights) @ vv
    return np.take(matrices.reshape(len(sizes), -1), places, axis=1).reshape(-1, m, m)
