"""Element matrices of the stationary FPK equation of two energies, by sum factorisation.

The weak form of (19) with zero flux at infinity is ``∫ J · ∇v = 0`` for all test functions, with
``J_i = (s_i − ½ ∂_j b_ij) p − ½ b_ij ∂_j p``. Shape functions are products of scikit-fem's line
elements; every sum over two-dimensional quadrature points is done one direction at a time.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fpk.line.elements import gauss_rule, shapes_at_gauss
from fpk.plane.condensation import local_order
from fpk.process import Process

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlaneCoefficients:
    """Coefficients at the Gauss points of all elements, each (elements, points, points).

    ``a1``, ``a2`` are s_i − ½ ∂_j b_ij; the points run along H1 first, then along H2.
    """

    a1: Array
    a2: Array
    b11: Array
    b12: Array
    b22: Array


def gauss_energies(nodes: tuple[Array, Array], rule: int) -> tuple[Array, Array]:
    """Return the Gauss energies of the elements along each axis, (elements, points) each."""
    t, _ = gauss_rule(rule)
    first, second = (x[:-1, None] + np.diff(x)[:, None] * t for x in nodes)
    return first, second


def coefficients_at(process: Process, nodes: tuple[Array, Array], rule: int) -> PlaneCoefficients:
    """Evaluate the process at the Gauss points; elements run along H2 fastest."""
    first, second = gauss_energies(nodes, rule)
    shape = (first.shape[0], second.shape[0], first.shape[1], second.shape[1])
    H1 = np.broadcast_to(first[:, None, :, None], shape)
    H2 = np.broadcast_to(second[None, :, None, :], shape)
    points = np.stack([H1.ravel(), H2.ravel()], axis=1)
    c = process.coefficients(points)
    a, b = c.drift - 0.5 * c.divergence, c.diffusion
    grid = (-1, first.shape[1], second.shape[1])
    return PlaneCoefficients(
        a[:, 0].reshape(grid),
        a[:, 1].reshape(grid),
        b[:, 0, 0].reshape(grid),
        b[:, 0, 1].reshape(grid),
        b[:, 1, 1].reshape(grid),
    )


def weighted(c: PlaneCoefficients, w: Array, slopes: tuple[Array, Array]) -> PlaneCoefficients:
    """Return the coefficients of u in p = w u, w = exp(−Φ), from Φ's slopes at the same points.

    ``J_i = w (a_i + ½ b_ij ∂_j Φ) u − ½ w b_ij ∂_j u``.
    """
    first, second = slopes
    return PlaneCoefficients(
        w * (c.a1 + 0.5 * (c.b11 * first + c.b12 * second)),
        w * (c.a2 + 0.5 * (c.b12 * first + c.b22 * second)),
        w * c.b11,
        w * c.b12,
        w * c.b22,
    )


@lru_cache
def _products(degree: int, rule: int) -> tuple[Array, Array, Array, Array]:
    """Weighted products of test and trial functions at Gauss points, (points, (degree+1)²) each.

    Order: value·value, slope·value, value·slope, slope·slope (test first), on the unit interval.
    """
    _, w = gauss_rule(rule)
    phi, dphi = shapes_at_gauss(degree, rule)
    pairs = [(phi, phi), (dphi, phi), (phi, dphi), (dphi, dphi)]
    vv, sv, vs, ss = (
        np.einsum("q,iq,jq->qij", w, test, trial).reshape(w.size, -1) for test, trial in pairs
    )
    return vv, sv, vs, ss


@lru_cache
def _places(degree: int) -> NDArray[np.int64]:
    """Where the entries of an element matrix in ``local_order`` come in the sum factorisation.

    There rows are pairs (i, j) of test and trial functions along H1, columns those along H2.
    """
    k = degree + 1
    i, m = np.divmod(local_order(degree)[0], k)
    return np.asarray((i[:, None] * k + i) * k * k + m[:, None] * k + m).ravel()


def element_matrices(c: PlaneCoefficients, sizes: Array, degree: int, rule: int) -> Array:
    """Return the element matrices (elements, m, m), m = (degree+1)², test functions first.

    ``sizes`` (elements, 2) are the lengths along H1 and H2, ``rule`` the one of ``c``. The local
    number of φ_i ψ_k is i(degree+1)+k; they come in ``local_order``.
    """
    vv, sv, vs, ss = _products(degree, rule)
    h1, h2 = sizes[:, 0, None, None], sizes[:, 1, None, None]
    # Along H2 first: for every Gauss point of H1 a small matrix over (k, l).
    slope_slope = (-0.5 * h2 / h1 * c.b11) @ vv
    slope_value = (h2 * c.a1) @ vv
    value_value = (h1 * c.a2) @ sv + (-0.5 * h1 / h2 * c.b22) @ ss
    outer, inner = [ss, sv, vv], [slope_slope, slope_value, value_value]
    if np.any(c.b12):
        inner[1] += (-0.5 * c.b12) @ vs
        outer.append(vs)
        inner.append((-0.5 * c.b12) @ sv)
    factors, places = np.concatenate(outer).T, _places(degree)
    m = (degree + 1) ** 2
    matrices = np.empty((len(sizes), m, m))
    for matrix, *parts in zip(matrices, *inner, strict=True):
        np.take((factors @ np.concatenate(parts)).ravel(), places, out=matrix.reshape(-1))
    return matrices
