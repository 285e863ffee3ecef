"""Element matrices of the stationary FPK equation of two energies, by sum factorisation.

The weak form of (19) with zero flux at infinity is ``∫ J · ∇v = 0`` for all test functions, with
``J_i = (s_i − ½ ∂_j b_ij) p − ½ b_ij ∂_j p``. Shape functions are products of scikit-fem's line
elements; every sum over two-dimensional quadrature points is done one direction at a time.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fpk.plane.condensation import local_order
from fpk.plane.mesh import Nodes
from fpk.plane.weight import Weight
from fpk.process import Process
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]


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


def gauss_rule(degree: int) -> tuple[Array, Array]:
    """Return the Gauss points and weights on [0, 1] that go with elements of ``degree``."""
    x, w = gauss_legendre(degree + 2)
    return 0.5 * (1.0 + x), 0.5 * w


@lru_cache
def shapes_at_gauss(degree: int, rule: int) -> tuple[Array, Array]:
    """Return the shape functions of ``degree`` and slopes at the Gauss points of ``rule``."""
    return shape_functions(degree, gauss_rule(rule)[0])


@dataclass(frozen=True, eq=False)
class PlaneCoefficients:
    """``J_i = a_i u − ½ b_ij ∂_j u`` at the Gauss points of all elements.

    Each (elements, points, points), the points along H1 first.
    """

    a1: Array
    a2: Array
    b11: Array
    b12: Array
    b22: Array


def gauss_energies(nodes: Nodes, rule: int) -> tuple[Array, Array]:
    """Return the Gauss energies of the elements along each axis, (elements, points) each."""
    t, _ = gauss_rule(rule)
    first, second = (x[:-1, None] + np.diff(x)[:, None] * t for x in nodes)
    return first, second


def by_element(values: Array, first: int, second: int) -> Array:
    """Return values on the grid of the Gauss energies of (first, second) elements by element.

    (points of all elements along H1, along H2) becomes (elements, points, points), the elements
    running along H2 fastest.
    """
    blocks = values.reshape(first, len(values) // first, second, -1).transpose(0, 2, 1, 3)
    return np.asarray(blocks.reshape(first * second, *blocks.shape[2:]))


def coefficients_at(
    process: Process, nodes: Nodes, rule: int, weight: Weight | None
) -> tuple[PlaneCoefficients, Array]:
    """Return the coefficients of the equation for u, and w, at the Gauss points of ``rule``.

    With p = w u, w = exp(−Φ), the flux is ``J_i = w (s_i − ½ ∂_j b_ij + ½ b_ij ∂_j Φ) u
    − ½ w b_ij ∂_j u``; w = 1 without a ``weight``.
    """
    energies = gauss_energies(nodes, rule)
    counts = len(energies[0]), len(energies[1])
    H1, H2 = (H.ravel() for H in energies)
    shape = H1.size, H2.size
    points = np.empty((*shape, 2))
    points[..., 0], points[..., 1] = H1[:, None], H2
    c = process.coefficients(points.reshape(-1, 2))
    drift = (c.drift - 0.5 * c.divergence).reshape(*shape, 2)
    b = c.diffusion.reshape(*shape, 2, 2)
    a1, a2, b11, b12, b22 = drift[..., 0], drift[..., 1], b[..., 0, 0], b[..., 0, 1], b[..., 1, 1]
    w = np.ones(shape)
    if weight is not None:
        w, first, second = weight.on_grid(H1, H2)
        a1 = w * (a1 + 0.5 * (b11 * first + b12 * second))
        a2 = w * (a2 + 0.5 * (b12 * first + b22 * second))
        b11, b12, b22 = w * b11, w * b12, w * b22
    at_gauss = (by_element(x, *counts) for x in (a1, a2, b11, b12, b22))
    return PlaneCoefficients(*at_gauss), by_element(w, *counts)


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
    """Positions of the entries of an element matrix in ``local_order`` in the sum factorisation.

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
