"""The stationary FPK equation of one energy on one finite element at a time.

Zero flux makes the one-dimensional stationary problem local. The Galerkin equations
``∫ J(u) v' dH = 0`` for all continuous piecewise polynomials v of degree p say that the flux J is
orthogonal, element by element, to all polynomials of degree p − 1: the derivatives v' are just
those. So static condensation is exact, every element has a one-dimensional null space of its
own, and the solution of the global system is these, scaled to match at the vertices. As there is
nothing else to match, the basis is that of Legendre polynomials.

u = p/T is the phase-space density, and J = T (F u − ½ b u') with F the part of the drift due to
damping; the noise part of the drift, ½ (bT)'/T, has cancelled, so that no derivative of b is
needed, and u is smooth where T is not. The exact solution has J = 0 at every point, so that any
points serve the Galerkin equations. Integrals of p are another matter: above an energy where
contact begins T has half-integer powers, and the element that begins there has points of its own.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legder, legvander

from fpk.numeric.arrays import SMALLEST, Array
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.process import Coefficients, Process, log_density_slope_error

ENRICHMENT = 2
"""Degrees by which the enriched solution, of the error estimate, exceeds the answer."""
ELEMENT_POINTS = 4
"""Points of an element beyond its degree. Twice as many where T ~ H^(n−1) is steep, n > 2: with
fewer the answer and the enriched solution share an error (n from 7 to 40: up to four times their
distance). With more where it is not, their distance no longer shows what a root of H in T costs:
an error of 8 times the stated one for a stop that touches from rest."""
CONTACT_POINTS = 10
"""Points beyond the degree of an element that begins where contact does."""
NullVectors = Callable[[Process, Array, int, int], tuple[Array, float]]
"""Solver on nodes, of a degree, by a number of Gauss points: Legendre series of u, residual."""


class Rule(NamedTuple):
    """Points of an element in [0, 1], and the Legendre polynomials P_j there.

    ``P`` (degree + 3, points) are values at the Gauss points ``share`` of ``weight``, ``tested``
    (2 · points, tests · (degree + 3)) values and derivatives times the degree + 2 test functions.
    ``enriched_weight`` interpolates at all points but one: its distance exceeds the Gauss error.

    ``contact_…`` are Gauss points in (H − H_c)^⅓ where contact begins, of the answer's mass first.
    In √(H − H_c) T is smooth, but stiff contact leaves a layer just above H_c; with little or no
    clearance T has other roots and both rules converge algebraically: twice as many points keep
    less than half of the error for any power of H − H_c from ½ on.
    """

    share: Array
    weight: Array
    enriched_weight: Array
    P: Array
    tested: Array
    contact_share: Array
    contact_weight: Array
    contact_P: Array


@lru_cache
def element_rule(degree: int, degrees_of_freedom: int = 1) -> Rule:
    """Return the points of elements of ``degree`` where T ~ H^(n−1), n = ``degrees_of_freedom``."""
    points = degree + (2 if degrees_of_freedom > 2 else 1) * ELEMENT_POINTS
    count, highest = degree + CONTACT_POINTS, degree + ENRICHMENT
    x, w = gauss_legendre(points)
    rules = gauss_legendre(count), gauss_legendre(2 * count - 2)
    t, contact_w = (0.5 * np.concatenate(both) for both in zip(*rules, strict=True))
    t += 0.5
    # All points but the middle one, exact for as many degrees as are left.
    interpolation, used = np.zeros(points), np.arange(points) != points // 2
    every = legvander(x[used], points - 2)
    interpolation[used] = np.linalg.solve(every.T, np.eye(points - 1)[0])
    value = np.asarray(legvander(x, highest), dtype=float)
    slope = 2.0 * value[:, :-1] @ legder(np.eye(highest + 1))
    tests = value[:, :-1, None]
    return Rule(
        share=0.5 * (1.0 + x),
        weight=0.5 * w,
        enriched_weight=interpolation,
        P=value.T,
        tested=np.concatenate([(tests * f[:, None]).reshape(points, -1) for f in (value, slope)]),
        contact_share=t**3,
        contact_weight=3.0 * t**2 * contact_w,
        contact_P=np.asarray(legvander(2.0 * t**3 - 1.0, highest).T, dtype=float),
    )


class Elements(NamedTuple):
    """Solutions of single elements, each of mass 1; every array (elements, …).

    ``u`` (elements, degree + 1) and ``enriched`` (elements, degree + 3) are Legendre series of
    p e^(−log_factor)/T; ``values`` and ``enriched_values`` are p at the points ``x`` with
    ``weights``. ``residual`` is relative to its terms, ``one_way`` are those of the mean
    ``net_flux`` of J. ``coefficient_error`` is the largest relative error of the coefficients,
    ``slope_error`` the error that it leaves in ln p from one end to the other.
    """

    coefficient_error: Array
    slope_error: Array
    u: Array
    enriched: Array
    log_factor: Array
    x: Array
    weights: Array
    values: Array
    enriched_values: Array
    residual: Array
    net_flux: Array
    one_way: Array


def solve_elements(
    process: Process, nodes: Array, degree: int, null_vectors: NullVectors | None = None
) -> Elements:
    """Solve the elements between ``nodes`` in ``degree`` and in the enriched one.

    ``null_vectors(process, nodes, degree, points)`` gives u of all elements and the residual by
    another solver of the same equations.
    """
    rule, left, h = element_rule(degree, process.degrees_of_freedom), nodes[:-1], np.diff(nodes)
    contact, h = np.flatnonzero([H in process.nonsmooth for H in left.tolist()]), h[:, None]
    x, points = left[:, None] + h * rule.share, rule.share.size
    inner = left[contact, None] + h[contact] * rule.contact_share
    flat = process.coefficients(np.concatenate([x.ravel(), inner.ravel()]))
    c = Coefficients(*(a[: x.size].reshape(x.shape) for a in flat))
    error = c.relative_error.max(axis=1)
    log_factor = c.log_density_of_states.max(axis=1)
    T = np.exp(c.log_density_of_states - log_factor[:, None])
    # J h = factors · (u, du/dt) at the Gauss points, t from 0 to 1 over the element.
    weighted = rule.weight * T
    factors = np.hstack([h * c.dissipation * weighted, -0.5 * c.diffusion * weighted])
    A = (factors @ rule.tested).reshape(left.size, degree + 2, degree + 3)
    largest = np.maximum(np.abs(A).max(axis=2, keepdims=True), SMALLEST)
    A /= largest
    degrees = degree, degree + ENRICHMENT
    if null_vectors is None:
        u, enriched = (_element_null_vectors(A, m) for m in degrees)
    else:
        (u, own), (enriched, _) = (null_vectors(process, nodes, m, points) for m in degrees)
    residual, net_flux, one_way = _residuals(A, u)
    values, better = (T * (f @ rule.P[: f.shape[1]]) for f in (u, enriched))
    weights, better_mass = np.broadcast_to(rule.weight, T.shape), better @ rule.enriched_weight
    if len(process.nonsmooth):
        of_T, of_error = (a[x.size :].reshape(inner.shape) for a in flat[-2:])
        error[contact] = np.maximum(error[contact], of_error.max(axis=1, initial=0.0))
        inner_T = np.exp(of_T - log_factor[contact, None])
        own_values, finer = (
            inner_T * (f[contact] @ rule.contact_P[: f.shape[1]]) for f in (u, enriched)
        )
        # Elements without contact have fewer points: the last stands for the rest, of no weight.
        count = degree + CONTACT_POINTS
        places = np.minimum(np.arange(count), points - 1)
        x, values, better = (f[:, places] for f in (x, values, better))
        weights = np.where(np.arange(count) < points, weights[:, places], 0.0)
        x[contact], weights[contact] = inner[:, :count], rule.contact_weight[:count]
        values[contact], better[contact] = own_values[:, :count], finer[:, :count]
        better_mass[contact] = finer[:, count:] @ rule.contact_weight[count:]
    mass = (weights * values).sum(axis=1)
    # The first equation, of the test function 1, is the mean of J. h² may be less than any number.
    scale = np.abs(largest[:, 0, 0] / h[:, 0] / mass / h[:, 0])
    mass, better_mass = h * mass[:, None], h * better_mass[:, None]
    slope_error = np.zeros(left.size)
    if null_vectors is not None:
        # Solved for together, elements keep a net flux by round-off, which tilts u by 2 J/A_01.
        slope_error = 2.0 * net_flux / np.maximum(np.abs(A[:, 0, 1]), SMALLEST)
    if process.state_damping:
        slope_error += (h * rule.weight * log_density_slope_error(c)).sum(axis=1)
    return Elements(
        coefficient_error=error,
        slope_error=slope_error,
        u=u / mass,
        enriched=enriched / better_mass,
        log_factor=log_factor,
        x=x,
        weights=h * weights,
        values=values / mass,
        enriched_values=better / better_mass,
        residual=residual if null_vectors is None else np.full(left.size, own),
        net_flux=scale * net_flux,
        one_way=scale * one_way,
    )


def _residuals(A: Array, u: Array) -> tuple[Array, Array, Array]:
    """Residual of A u = 0 relative to its terms; residual and terms of the first equation."""
    # All terms are zero where an element is so short that the damping in it underflows.
    terms = A[:, : u.shape[1] - 1, : u.shape[1]] * u[:, None]
    residual, size = np.abs(terms.sum(axis=2)), np.abs(terms).sum(axis=2)
    return residual.max(axis=1) / np.maximum(size.max(axis=1), SMALLEST), residual[:, 0], size[:, 0]


def _element_null_vectors(A: Array, degree: int) -> Array:
    """Return u (elements, ``degree`` + 1), u_0 = 1, that the first rows of A map to zero.

    u_0 is the mean of u over the element, which is not zero as u does not change sign. Where T
    spans hundreds of decades in one element some directions of u have no weight in any equation,
    and elimination comes upon a zero: the least u is taken.
    """
    B, right = A[:, :degree, 1 : degree + 1], -A[:, :degree, :1]
    try:
        rest = np.linalg.solve(B, right)
    except np.linalg.LinAlgError:
        rest = np.linalg.pinv(B) @ right
    return np.hstack([np.ones((len(A), 1)), rest[:, :, 0]])
