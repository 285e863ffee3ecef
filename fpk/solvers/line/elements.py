"""The stationary FPK equation of one energy on one finite element at a time.

Zero flux makes the one-dimensional stationary problem local. The Galerkin equations
``∫ J(u) v' dH = 0`` for all continuous piecewise polynomials v of degree p say that the flux J is
orthogonal, element by element, to all polynomials of degree p − 1, which are the derivatives v'. So
static condensation is exact: every element has a one-dimensional null space of its own, and the
global solution consists of these null vectors, scaled to match at the vertices.

u = p/T is the phase-space density, and J = T (F u − ½ b u') with F the part of the drift due to
damping; the noise part of the drift, ½ (bT)'/T, has cancelled, so that no derivative of b is
needed, and u is smooth where T is not. The exact solution has J = 0 at every point, so that the
Galerkin equations may use any quadrature points. Integrals of p need special points above an energy
where contact begins, as T has half-integer powers there.
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
"""Degree of the enriched solution minus degree of the answer; their distance gives the error."""
ELEMENT_POINTS = 4
"""Gauss points of an element, less its degree; twice this number if T ~ H^(n−1) is steep, n > 2, as
fewer give answer and enriched solution a common error. For n <= 2 more points hide the error by a
root of H in T: for a stop that touches at rest the error was 8 times the stated error."""
CONTACT_POINTS = 10
"""Gauss points of an element that begins at a contact energy, less its degree."""
NullVectors = Callable[[Process, Array, int, int], tuple[Array, float]]
"""Function of (process, nodes, degree, Gauss points of an element) that returns the Legendre series
(elements, degree + 1) of u = p/T, of mean 1 in each element, and a relative residual."""


class Rule(NamedTuple):
    """Quadrature points t of an element, from 0 to 1 over it, and the Legendre polynomials P_j.

    ``share`` are Gauss points with the ``weight``, of sum 1; ``P`` (degree + 3, points) are the P_j
    there, ``tested`` (2 · points, (degree + 2) · (degree + 3)) the products P_i P_j and then
    P_i dP_j/dt of test functions i and terms j. ``enriched_weight`` is the interpolatory rule
    without the middle point: its distance from the Gauss rule exceeds the error of the latter.

    ``contact_…`` are Gauss points in (H − H_c)^⅓ of an element that begins at a contact energy H_c:
    first the rule for the mass of the answer, then a rule of twice as many points for the enriched
    solution, which has less than half of the error for any power of H − H_c in T from ½ on.
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
    """Return the rule of elements of ``degree``; more points for n = ``degrees_of_freedom`` > 2."""
    points = degree + (2 if degrees_of_freedom > 2 else 1) * ELEMENT_POINTS
    count, highest = degree + CONTACT_POINTS, degree + ENRICHMENT
    x, w = gauss_legendre(points)
    rules = gauss_legendre(count), gauss_legendre(2 * count - 2)
    t, contact_w = (0.5 * np.concatenate(both) for both in zip(*rules, strict=True))
    t += 0.5
    # Interpolation at all points but the middle one.
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
    """Solutions on single elements, each scaled to mass 1; the other arrays are (elements,).

    ``u`` (elements, degree + 1) and ``enriched`` (elements, degree + 3) are Legendre series of
    p e^log_factor/T, ``log_factor`` the largest ln T at the Gauss points. ``values`` and
    ``enriched_values`` are p at the energies ``x`` with ``weights``, (elements, points) each. The
    ``residual`` of the equations is relative to their terms; ``net_flux`` is |mean of J| and
    ``one_way`` the sum of the sizes of its terms. ``coefficient_error`` is the largest relative
    error of the coefficients, ``slope_error`` the resulting error of ln p from one end of the
    element to the other.
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
    """Return the solutions in ``degree`` and ``degree`` + ``ENRICHMENT`` on the elements between
    ascending ``nodes``. ``null_vectors``, if given, replaces elimination in each element."""
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
    # All terms are zero if an element is so short that the damping in it underflows.
    terms = A[:, :degree, : degree + 1] * u[:, None]
    missed, sizes = np.abs(terms.sum(axis=2)), np.abs(terms).sum(axis=2)
    residual = missed.max(axis=1) / np.maximum(sizes.max(axis=1), SMALLEST)
    net_flux, one_way = missed[:, 0], sizes[:, 0]
    values, better = (T * (f @ rule.P[: f.shape[1]]) for f in (u, enriched))
    weights, better_mass = np.broadcast_to(rule.weight, T.shape), better @ rule.enriched_weight
    if len(process.nonsmooth):
        of_T, of_error = (a[x.size :].reshape(inner.shape) for a in flat[-2:])
        error[contact] = np.maximum(error[contact], of_error.max(axis=1, initial=0.0))
        inner_T = np.exp(of_T - log_factor[contact, None])
        own_values, finer = (
            inner_T * (f[contact] @ rule.contact_P[: f.shape[1]]) for f in (u, enriched)
        )
        # Elements without contact have fewer points: the last is repeated with weight 0.
        count = degree + CONTACT_POINTS
        places = np.minimum(np.arange(count), points - 1)
        x, values, better = (f[:, places] for f in (x, values, better))
        weights = np.where(np.arange(count) < points, weights[:, places], 0.0)
        x[contact], weights[contact] = inner[:, :count], rule.contact_weight[:count]
        values[contact], better[contact] = own_values[:, :count], finer[:, :count]
        better_mass[contact] = finer[:, count:] @ rule.contact_weight[count:]
    mass = (weights * values).sum(axis=1)
    # The first equation, of the test function 1, is the mean of J. h² may underflow.
    scale = np.abs(largest[:, 0, 0] / h[:, 0] / mass / h[:, 0])
    mass, better_mass = h * mass[:, None], h * better_mass[:, None]
    slope_error = np.zeros(left.size)
    if null_vectors is not None:
        # A global solver leaves a net flux by round-off, which tilts u by 2 J/A_01.
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


def _element_null_vectors(A: Array, degree: int) -> Array:
    """Return u (elements, ``degree`` + 1), u_0 = 1, with ``A`` u = 0 in the first ``degree`` rows.

    u_0 is the mean of u over the element, which is not 0 as u does not change sign. If T spans
    hundreds of decades in one element, some directions of u have no weight in any equation, and
    elimination meets a zero pivot: then the u of least norm is returned.
    """
    B, right = A[:, :degree, 1 : degree + 1], -A[:, :degree, :1]
    try:
        rest = np.linalg.solve(B, right)
    except np.linalg.LinAlgError:
        rest = np.linalg.pinv(B) @ right
    return np.hstack([np.ones((len(A), 1)), rest[:, :, 0]])
