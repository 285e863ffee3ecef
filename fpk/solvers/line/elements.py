"""The stationary FPK equation of one energy on one finite element at a time.

Zero flux makes the one-dimensional stationary problem local. The Galerkin equations
``∫ J(u) v' dH = 0`` for all continuous piecewise polynomials v of degree p say that the flux J is
orthogonal, element by element, to all polynomials of degree p − 1: the derivatives v' are just
those. So static condensation is exact, every element has a one-dimensional null space of its
own, and the solution of the global system is these, scaled to match at the vertices. As there is
nothing else to match, the basis is that of Legendre polynomials.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legder, legvander
from numpy.typing import NDArray

from fpk.numeric.arrays import SMALLEST, Array
from fpk.numeric.compiling import cached_njit, inlined
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.process import Coefficients, Process

ENRICHMENT = 2
"""Degrees by which the enriched solution, of the error estimate, exceeds the answer."""
STEEP_POINTS = 4
"""Gauss points that an element has more where T ~ H^(n−1) is steep, n > 2: with fewer the answer
and the enriched solution share an error (n from 7 to 40: up to four times their distance)."""
CONTACT_POINTS = 8
"""Points by which integrals over an element that begins where contact does exceed the degree."""
NullVectors = Callable[[Process, Array, int, int], tuple[Array, float]]
"""Solver on nodes, of a degree, by a number of Gauss points: Legendre series of u, residual."""


class Rule(NamedTuple):
    """Points of an element in [0, 1], and the Legendre polynomials P_j there.

    At the Gauss points ``share`` with ``weight`` the flux is tested, for the answer and for the
    enriched solution. ``P`` (degree + 3, points) are the values of the polynomials, and ``tested``
    (2 · points, tests · (degree + 3)) the values and the derivatives, each times the degree + 2
    test functions. The mass of the enriched solution is the sum with ``enriched_weight``, an
    interpolation at all points but one: its distance to that of the answer shows how far T is from
    a polynomial, and exceeds the error of the Gauss rule.

    In elements that begin where contact does both masses have points of their own, at
    ``contact_share`` with ``contact_weight`` and values ``contact_P``: those of the answer first,
    then those of the enriched solution. They are Gauss points in (H − H_c)^⅓: in √(H − H_c) T is
    smooth, but stiff contact leaves a layer just above H_c. Without clearance, or with very little
    beside a stiff stop, T has other roots and both rules converge algebraically: twice as many
    points keep less than half of the error for any power of H − H_c from ½ on.
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
    steep = STEEP_POINTS if degrees_of_freedom > 2 else 0
    share, weight = _gauss(degree + ENRICHMENT + 2 + steep)
    count, highest = degree + 2 + CONTACT_POINTS, degree + ENRICHMENT
    t, w = (np.concatenate(x) for x in zip(_gauss(count), _gauss(2 * count - 2), strict=True))
    value = np.asarray(legvander(2.0 * share - 1.0, highest), dtype=float)
    slope = 2.0 * value[:, :-1] @ legder(np.eye(highest + 1))
    tests = value[:, :-1, None]
    # All points but the middle one, exact for as many degrees as are left.
    enriched_weight, used = np.zeros(share.size), np.arange(share.size) != share.size // 2
    every = legvander(2.0 * share[used] - 1.0, share.size - 2)
    enriched_weight[used] = np.linalg.solve(every.T, np.eye(share.size - 1)[0])
    return Rule(
        share=share,
        weight=weight,
        enriched_weight=enriched_weight,
        P=np.ascontiguousarray(value.T),
        tested=np.concatenate(
            [(tests * f[:, None]).reshape(share.size, -1) for f in (value, slope)]
        ),
        contact_share=t**3,
        contact_weight=3.0 * t**2 * w,
        contact_P=np.ascontiguousarray(legvander(2.0 * t**3 - 1.0, highest).T),
    )


def _gauss(points: int) -> tuple[Array, Array]:
    """Gauss points and weights on [0, 1]."""
    x, w = gauss_legendre(points)
    return 0.5 * (1.0 + x), 0.5 * w


class Elements(NamedTuple):
    """Solutions of single elements, each of mass 1; every array (elements, …).

    ``u`` (elements, degree + 1) and ``enriched`` (elements, degree + 3) are Legendre series of
    p e^(−log_factor)/T; ``values`` and ``enriched_values`` (elements, points) are p at the same
    points, ``weights`` those of the points. ``residual`` is
    relative to the terms that cancel in it; ``net_flux`` is the mean of J and ``one_way`` the terms
    that cancel in that. ``coefficient_error`` is the largest relative error of the coefficients,
    ``at_end`` p at the right end.
    """

    left: Array
    right: Array
    coefficient_error: Array
    u: Array
    enriched: Array
    log_factor: Array
    values: Array
    enriched_values: Array
    weights: Array
    residual: Array
    net_flux: Array
    one_way: Array
    at_end: Array


def solve_elements(
    process: Process,
    left: Array,
    right: Array,
    degree: int,
    null_vectors: NullVectors | None = None,
) -> Elements:
    """Solve the elements between ``left`` and ``right`` in ``degree`` and in the enriched one.

    u = p/T is the phase-space density, and J = T (F u − ½ b u') with F the part of the drift due to
    damping; the noise part of the drift, ½ (bT)'/T, has cancelled, so that no derivative of b is
    needed, and u is smooth where T is not. The exact solution has J = 0 at every point, so that any
    points serve the Galerkin equations. Integrals of p are another matter: above an energy where
    contact begins T has half-integer powers, and the element that begins there has points of its
    own for them. ``null_vectors(process, nodes, degree, points)`` gives u of all elements and the
    residual by another solver of the same equations.
    """
    rule, h = element_rule(degree, process.degrees_of_freedom), (right - left)[:, None]
    above = np.array([k for k, H in enumerate(left.tolist()) if H in process.nonsmooth], np.intp)
    energy = left[:, None] + h * rule.share
    inner = left[above, None] + h[above] * rule.contact_share
    flat = process.coefficients(np.concatenate([energy.ravel(), inner.ravel(), right]))
    c = Coefficients(*(a[: energy.size].reshape(energy.shape) for a in flat))
    error = c.relative_error.max(axis=1)
    log_T = flat.log_density_of_states
    log_factor = np.maximum(c.log_density_of_states.max(axis=1), log_T[-left.size :])
    T = np.exp(c.log_density_of_states - log_factor[:, None])
    T_end = np.exp(log_T[-left.size :] - log_factor)
    inner_T = log_T[energy.size : -left.size].reshape(inner.shape) - log_factor[above, None]
    inner_T = np.exp(inner_T)
    # J h = factors · (u, du/dt) at the Gauss points, t from 0 to 1 over the element.
    factors = np.empty((left.size, 2, rule.share.size))
    factors[:] = (rule.weight * T)[:, None]
    factors[:, 0] *= h * c.dissipation
    factors[:, 1] *= -0.5 * c.diffusion
    A = (factors.reshape(left.size, -1) @ rule.tested).reshape(left.size, -1, degree + 3)
    largest = np.maximum(np.abs(A).max(axis=2, keepdims=True), SMALLEST)
    A /= largest
    degrees = degree, degree + ENRICHMENT
    if null_vectors is None:
        u, enriched = (_null_vectors(A, m) for m in degrees)
    else:
        nodes = np.append(left, right[-1])
        (u, own), (enriched, _) = (
            null_vectors(process, nodes, m, rule.share.size) for m in degrees
        )
    if above.size:
        inner_error = flat.relative_error[energy.size : -left.size].reshape(inner.shape)
        error[above] = np.maximum(error[above], inner_error.max(axis=1))
    points, judged = (left.size, degree + 2 + CONTACT_POINTS), np.empty((4, left.size))
    e = Elements(
        left=left,
        right=right,
        coefficient_error=error,
        u=u,
        enriched=enriched,
        log_factor=log_factor,
        values=np.empty(points),
        enriched_values=np.empty(points),
        weights=np.zeros(points),
        residual=judged[0],
        net_flux=judged[1],
        one_way=judged[2],
        at_end=judged[3],
    )
    _scale_to_mass_one(e, A, largest[:, 0, 0], T, T_end, above, inner_T, rule)
    if null_vectors is not None:
        e.residual[:] = own
    return e


@cached_njit()
def _scale_to_mass_one(
    e: Elements, A: Array, first: Array, T: Array, T_end: Array, above: NDArray[np.intp],
    inner_T: Array, rule: Rule,
) -> None:  # fmt: skip
    """Scale u of each element to mass 1, and write what is measured on it; all in place.

    ``first`` is the factor of the first row of A, which is the equation of the test function 1 and
    so the mean of J. ``above`` are the elements that begin where contact does, with T at their own
    points in ``inner_T``. Values at fewer points than the arrays hold are filled with the last one.
    """
    most, row = e.weights.shape[1], 0
    for k in range(e.left.size):
        u, better, h = e.u[k], e.enriched[k], e.right[k] - e.left[k]
        e.residual[k], e.net_flux[k], e.one_way[k] = _residual(A[k], u)
        contact = row < above.size and above[row] == k
        P, states = (rule.contact_P, inner_T[row]) if contact else (rule.P, T[k])
        row += contact
        own = most if contact else states.size
        for g in range(most):
            m = min(g, own - 1)
            e.values[k, g] = states[m] * _series(u, P, m)
            e.enriched_values[k, g] = states[m] * _series(better, P, m)
        mass, better_mass, end = 0.0, 0.0, 0.0
        for g in range(own):
            e.weights[k, g] = h * (rule.contact_weight[g] if contact else rule.weight[g])
            mass += e.weights[k, g] * e.values[k, g]
        if contact:
            for g in range(own, states.size):
                better_mass += rule.contact_weight[g] * states[g] * _series(better, P, g)
        else:
            for g in range(own):
                better_mass += rule.enriched_weight[g] * e.enriched_values[k, g]
        better_mass *= h
        scale = abs(first[k] / (mass * h))
        e.net_flux[k], e.one_way[k] = scale * e.net_flux[k], scale * e.one_way[k]
        for g in range(most):
            e.values[k, g] /= mass
            e.enriched_values[k, g] /= better_mass
        for j in range(u.size):
            end += u[j]
            u[j] /= mass
        for j in range(better.size):
            better[j] /= better_mass
        e.at_end[k] = T_end[k] * end / mass


@inlined
def _residual(A: Array, u: Array) -> tuple[float, float, float]:
    """Largest residual of A u = 0 relative to the terms in it; residual and terms of row one."""
    # All terms are zero where an element is so short that the damping in it underflows.
    residual, largest, net, one_way = 0.0, SMALLEST, 0.0, 0.0
    for i in range(u.size - 1):
        total, size = 0.0, 0.0
        for j in range(u.size):
            total += A[i, j] * u[j]
            size += abs(A[i, j] * u[j])
        # Of numbers and NaN np.maximum keeps the NaN, unlike max.
        residual = np.maximum(residual, abs(total))
        largest = np.maximum(largest, size)
        if i == 0:
            net, one_way = abs(total), size
    return residual / largest, net, one_way


@inlined
def _series(coefficients: Array, P: Array, point: int) -> float:
    """Σ c_j P_j at one of the points of ``P`` (polynomials, points)."""
    total = 0.0
    for j in range(coefficients.size):
        total += coefficients[j] * P[j, point]
    return total


def _null_vectors(A: Array, degree: int) -> Array:
    """Return u (elements, ``degree`` + 1), u_0 = 1, that the first rows of A map to zero.

    A (elements, m, m + 1) has rows of the size one, each of a test function, of rising degree. u_0
    is the mean of u over the element, which is not zero as u does not change sign. Where T spans
    hundreds of decades in one element some directions of u have no weight in any equation, and
    elimination comes upon a zero: the least u is taken.
    """
    u = np.ones((len(A), degree + 1))
    B, right = A[:, :degree, 1 : degree + 1], -A[:, :degree, :1]
    try:
        rest = np.linalg.solve(B, right)
    except np.linalg.LinAlgError:
        rest = np.linalg.pinv(B) @ right
    u[:, 1:] = rest[:, :, 0]
    return u


def joined(parts: Sequence[Elements]) -> Elements:
    """Return all elements in one record, ascending."""
    order = np.argsort(np.concatenate([part.left for part in parts]))
    return Elements(*(np.concatenate(x)[order] for x in zip(*parts, strict=True)))
