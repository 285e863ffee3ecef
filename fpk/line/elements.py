"""The stationary FPK equation of one energy on one finite element at a time.

Zero flux makes the one-dimensional stationary problem local. The Galerkin equations
``∫ J(u) v' dH = 0`` for all continuous piecewise polynomials v of degree p say that the flux J is
orthogonal, element by element, to all polynomials of degree p − 1: the derivatives v' are just
those. So static condensation is exact, every element has a one-dimensional null space of its
own, and the solution of the global system is these, scaled to match at the vertices. The scales
are kept as logarithms, so no density is too steep.
"""

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]
Form = Literal["flux", "drift-diffusion"]


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
def in_legendre(degree: int) -> Array:
    """Return the shape functions (degree + 1, degree + 1) as Legendre series on their interval."""
    t, w = gauss_rule(degree)
    series = shapes_at_gauss(degree, degree)[0] @ (w[:, None] * legvander(2.0 * t - 1.0, degree))
    return np.asarray(series * (2.0 * np.arange(degree + 1) + 1.0))


@lru_cache
def shapes_at_gauss(degree: int, rule: int) -> tuple[Array, Array]:
    """Return the shape functions of ``degree`` and slopes at the Gauss points of ``rule``."""
    return shape_functions(degree, gauss_rule(rule)[0])
