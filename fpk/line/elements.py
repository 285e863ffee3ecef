"""The stationary FPK equation of one energy on one finite element at a time.

Zero flux makes the one-dimensional stationary problem local. The Galerkin equations
``∫ J(u) v' dH = 0`` for all continuous piecewise polynomials v of degree p say that the flux J is
orthogonal, element by element, to all polynomials of degree p − 1: the derivatives v' are just
those. So static condensation is exact, every element has a one-dimensional null space of its
own, and the solution of the global system is these, scaled to match at the vertices. The scales
are kept as logarithms, so no density is too steep.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from skfem import ElementLineP1, ElementLineP2, ElementLinePp

from fpk.process import Coefficients
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
def shapes_at_gauss(degree: int, rule: int) -> tuple[Array, Array]:
    """Return the shape functions of ``degree`` and slopes at the Gauss points of ``rule``."""
    return shape_functions(degree, gauss_rule(rule)[0])


def flux_terms(c: Coefficients, form: Form) -> tuple[Array, Array, Array, Array]:
    """Return (α, β, weight, log_factor) of ``J = factor (α u + β u')`` and ``p = factor weight u``.

    "drift-diffusion": u = p, J = s p − ½ (b p)'. "flux": u = p/T is the phase-space density and
    J = T (F u − ½ b u') with F the part of the drift due to damping; the noise part of the drift,
    ½ (bT)'/T, has cancelled, so that no derivative of b is needed, and u is smooth where T is not.
    The arrays have the shape (elements, points); ``log_factor`` (elements,) keeps T in range.
    """
    if form == "drift-diffusion":
        ones = np.ones_like(c.drift)
        zero = np.zeros(c.drift.shape[0])
        return c.drift - 0.5 * c.diffusion_slope, -0.5 * c.diffusion, ones, zero
    log_factor = c.log_density_of_states.max(axis=1)
    T = np.exp(c.log_density_of_states - log_factor[:, None])
    return T * c.dissipation, -0.5 * T * c.diffusion, T, log_factor


@dataclass(frozen=True, eq=False)
class LocalSolutions:
    """Null vectors of the elements, each scaled to the mass 1, with what they were checked by.

    ``u`` (elements, degree + 1) are coefficients of the shape functions; ``log_factor`` as in
    ``flux_terms``; ``residual`` is relative to the terms that cancel in it; ``net_flux`` is the
    mean of |J| of the net and ``one_way`` that of its two parts, drift and diffusion.
    """

    u: Array
    log_factor: Array
    residual: Array
    net_flux: Array
    one_way: Array


def local_solutions(c: Coefficients, lengths: Array, degree: int, form: Form) -> LocalSolutions:
    """Solve the stationary FPK equation on every element, from its coefficients at Gauss points.

    ``c`` holds arrays (elements, points), ``lengths`` (elements,).
    """
    alpha, beta, weight, log_factor = flux_terms(c, form)
    _, w = gauss_rule(degree)
    phi, dphi = shapes_at_gauss(degree, degree)
    h = lengths[:, None]
    # Test functions are the slopes of all shape functions but the first (the sum rule of the two
    # vertex functions makes that one redundant); the row in its place sets the mass.
    flux = (alpha * h * w)[:, None, :] * phi + (beta * w)[:, None, :] * dphi
    system = np.empty((h.size, degree + 1, degree + 1))
    system[:, 0] = (weight * h * w) @ phi.T
    system[:, 1:] = dphi[1:] @ flux.transpose(0, 2, 1)
    scale = np.abs(system).max(axis=2, keepdims=True)
    unit = np.zeros((h.size, degree + 1, 1))
    unit[:, 0] = 1.0 / scale[:, 0]
    scaled = system / scale
    try:
        u = np.linalg.solve(scaled, unit)
        u += np.linalg.solve(scaled, unit - scaled @ u)
    except np.linalg.LinAlgError:
        # Where T spans hundreds of decades in one element (n = 50 masses near H = 0), directions
        # of u that have no weight in any equation are left at zero.
        u = np.linalg.pinv(scaled) @ unit
    left = np.abs(scaled @ u - unit).max(axis=(1, 2))
    terms = (np.abs(scaled) @ np.abs(u)).max(axis=(1, 2))
    u = u[:, :, 0]
    through = np.abs((flux.sum(axis=2) * u).sum(axis=1))
    one_way = np.abs((alpha * h * w) * (u @ phi)).sum(1) + np.abs((beta * w) * (u @ dphi)).sum(1)
    return LocalSolutions(u, log_factor, left / terms, through / lengths, one_way / lengths)


def local_density(c: Coefficients, local: LocalSolutions, *, rule: int, form: Form) -> Array:
    """Return the density of mass 1 on each element at the Gauss points of degree ``rule``.

    ``c`` holds the coefficients at those points; the shape is (elements, points).
    """
    u = local.u @ shapes_at_gauss(local.u.shape[1] - 1, rule)[0]
    if form == "drift-diffusion":
        return np.asarray(u)
    return np.asarray(u * np.exp(c.log_density_of_states - local.log_factor[:, None]))
