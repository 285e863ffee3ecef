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
from skfem import ElementLineP1, ElementLineP2, ElementLinePp

from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]
Form = Literal["flux", "drift-diffusion"]


def shape_functions(degree: int, t: Array) -> tuple[Array, Array]:
    """Return the hierarchical shape functions and derivatives (degree + 1, points) at t in [0, 1].

    The first two belong to the left and right vertex, the others vanish there.
    """
    # A fresh element each time: ElementLinePp keeps values for a given number of points only.
    special = {1: ElementLineP1, 2: ElementLineP2}
    element = special[degree]() if degree in special else ElementLinePp(degree)
    values, slopes = zip(*(element.lbasis(t[None, :], i) for i in range(degree + 1)), strict=True)
    return np.array(values), np.array([slope.reshape(-1) for slope in slopes])


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
