"""Compiled solution of the stationary FPK equation on one finite element after another.

These are the null vectors of ``fpk.line.elements``, found by elimination in small dense matrices.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiling import SUMS, cached_njit
from fpk.line.rules import ContactRule, Rule
from fpk.process import Coefficients

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

NO_WEIGHT = 1e-200
"""Pivot, relative to its row, of a direction of u that has no weight in any equation: it is left
at zero. So it goes where T spans hundreds of decades in one element (n = 50 masses near H = 0)."""


class Solved(NamedTuple):
    """Null vectors of elements, and of the same in the enriched degree; elements run first.

    ``u`` (elements, degree + 1), ``enriched`` (elements, degree + 3) are coefficients of the shape
    functions for the mass 1, ``log_factor`` ln of what p = factor·T·u has to be multiplied by,
    ``values`` and ``enriched_values`` (elements, points) p at the answer's points for integrals,
    ``weights`` those of the points. ``residual`` is relative to the terms that cancel in it;
    ``net_flux`` is the mean of J and ``one_way`` that of its parts, each way, and of what diffusion
    would drive if u fell to nothing over the element.
    """

    u: Array
    enriched: Array
    log_factor: Array
    values: Array
    enriched_values: Array
    weights: Array
    residual: Array
    net_flux: Array
    one_way: Array


class Work(NamedTuple):
    """What one null vector takes: a matrix and its factors (m, m), a vector and pivots (m,)."""

    A: Array
    B: Array
    r: Array
    pivot: Integers


_inner = njit(fastmath=SUMS, error_model="numpy", forceinline=True)


@_inner
def _factored(A: Array, pivot: Integers) -> None:
    """Factor A (m, m) in place, L U = P A, with row pivoting."""
    m = pivot.size
    for k in range(m):
        best = k
        for i in range(k + 1, m):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        pivot[k] = best
        if best != k:
            for j in range(m):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        if abs(A[k, k]) < NO_WEIGHT:
            A[k, k] = np.inf
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, m):
            factor = A[i, k] * inverse
            A[i, k] = factor
            for j in range(k + 1, m):
                A[i, j] -= factor * A[k, j]


@_inner
def _back_substituted(A: Array, pivot: Integers, x: Array) -> None:
    """Solve with the factors: x becomes A⁻¹ x."""
    m = pivot.size
    for k in range(m):
        x[k], x[pivot[k]] = x[pivot[k]], x[k]
    for i in range(m):
        for j in range(i):
            x[i] -= A[i, j] * x[j]
    for k in range(m - 1, -1, -1):
        for j in range(k + 1, m):
            x[k] -= A[k, j] * x[j]
        x[k] /= A[k, k]


@njit(fastmath=SUMS, error_model="numpy")
def _null_vector(
    alpha: Array, beta: Array, mass: Array, phi: Array, dphi: Array, inner: Array, work: Work,
    u: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Write to ``u`` the solution of ∫J v' = 0, ∫p = 1; J = alpha u + beta u', p = mass u.

    ``alpha``, ``beta`` and ``mass`` (points,) have the weights in them. Returns the residual
    relative to the terms that cancel in it, |∫J|, and the integral of its two parts and of what
    diffusion would drive if u fell to nothing over the element.
    """
    A, B, r, pivot = work.A, work.B, work.r, work.pivot
    points, m = phi.shape
    # Test functions are the slopes of all shape functions but the first (the sum rule of the two
    # vertex functions makes that one redundant); the row in its place sets the mass.
    for i in range(m):
        for j in range(m):
            A[i, j] = 0.0
    for g in range(inner.shape[0]):
        for j in range(m):
            A[0, j] += mass[g] * inner[g, j]
    for g in range(points):
        for j in range(m):
            r[j] = alpha[g] * phi[g, j] + beta[g] * dphi[g, j]
        for i in range(1, m):
            slope = dphi[g, i]
            for j in range(m):
                A[i, j] += slope * r[j]
    unit = 1.0
    for i in range(m):
        scale = 0.0
        for j in range(m):
            scale = max(scale, abs(A[i, j]))
        scale = 1.0 / scale if scale > 0.0 else 1.0
        for j in range(m):
            A[i, j] *= scale
            B[i, j] = A[i, j]
        u[i] = 0.0
        unit = scale if i == 0 else unit
    u[0] = unit
    _factored(B, pivot)
    _back_substituted(B, pivot, u)
    for i in range(m):
        r[i] = unit if i == 0 else 0.0
        for j in range(m):
            r[i] -= A[i, j] * u[j]
    _back_substituted(B, pivot, r)
    left, terms = 0.0, 0.0
    for j in range(m):
        u[j] += r[j]
    for i in range(m):
        total, size = unit if i == 0 else 0.0, 0.0
        for j in range(m):
            total -= A[i, j] * u[j]
            size += abs(A[i, j] * u[j])
        left, terms = max(left, abs(total)), max(terms, size)
    net, parts = 0.0, 0.0
    for g in range(points):
        value, change = 0.0, 0.0
        for j in range(m):
            value += phi[g, j] * u[j]
            change += dphi[g, j] * u[j]
        net += alpha[g] * value + beta[g] * change
        # In a short element both parts are small beside the terms that make up u'.
        parts += abs(alpha[g] * value) + abs(beta[g] * change) + abs(beta[g] * value)
    return left / terms, abs(net), parts


@_inner
def _flux_terms(
    c: Coefficients,
    e: int,
    h: float,
    weight: Array,
    flux: bool,
    alpha: Array,
    beta: Array,
    T: Array,
) -> float:
    """Write α and β of J = α u + β u' with weights, and T; return ln of the factor left out.

    "drift-diffusion": u = p, J = s p − ½ (b p)', T = 1. "flux": u = p/T, the phase-space density,
    J = T (F u − ½ b u') with F the part of the drift due to damping; the noise part of the drift,
    ½ (bT)'/T, has cancelled, so that no derivative of b is needed, and u is smooth where T is not.
    """
    top = 0.0
    if flux:
        top = -np.inf
        for g in range(weight.size):
            top = max(top, c.log_density_of_states[e, g])
    for g in range(weight.size):
        w = weight[g]
        if flux:
            T[g] = np.exp(c.log_density_of_states[e, g] - top)
            w *= T[g]
            alpha[g] = c.dissipation[e, g] * h * w
        else:
            alpha[g] = (c.drift[e, g] - 0.5 * c.divergence[e, g]) * h * w
        beta[g] = -0.5 * c.diffusion[e, g] * w
    return top


@cached_njit(SUMS)
def solved_elements(
    c: Coefficients, lengths: Array, row: Integers, log_states: Array, rule: Rule,
    contact: ContactRule, flux: bool,
) -> Solved:  # fmt: skip
    """Solve elements from their coefficients (elements, points) at the points of ``rule``.

    ``row`` says which row of ``log_states``, ln T at the points of ``contact``, belongs to an
    element that begins where contact does; it is −1 for the others.
    """
    count, (p, m), m2 = lengths.size, rule.phi.shape, rule.enriched_phi.shape[1]
    most = contact.phi.shape[0]
    out = Solved(
        np.empty((count, m)), np.empty((count, m2)), np.empty(count),
        np.empty((count, most)), np.empty((count, most)), np.empty((count, most)),
        np.empty(count), np.empty(count), np.empty(count),
    )  # fmt: skip
    alpha, beta = np.empty(p), np.empty(p)
    mass, T = np.empty(contact.share.size), np.ones(contact.share.size)
    own_work = Work(np.empty((m, m)), np.empty((m, m)), np.empty(m), np.empty(m, np.int64))
    work = Work(np.empty((m2, m2)), np.empty((m2, m2)), np.empty(m2), np.empty(m2, np.int64))
    for e in range(count):
        h, begins = lengths[e], row[e] >= 0
        top = _flux_terms(c, e, h, rule.weight, flux, alpha, beta, T)
        if begins and flux:
            for g in range(contact.share.size):
                T[g] = np.exp(log_states[row[e], g] - top)
        weight, points = (contact.weight, most) if begins else (rule.weight, p)
        enriched_weight = contact.weight[most:] if begins else rule.enriched_weight
        enriched_T = T[most:] if begins else T
        phi = contact.phi if begins else rule.phi
        enriched_phi = contact.enriched_phi if begins else rule.enriched_phi
        compared = contact.compared if begins else rule.enriched_phi
        for g in range(points):
            mass[g] = h * weight[g] * T[g]
        residual, net, parts = _null_vector(
            alpha, beta, mass[:points], rule.phi, rule.dphi, phi, own_work, out.u[e]
        )
        out.residual[e], out.net_flux[e], out.one_way[e] = residual, net / h, parts / h
        for g in range(enriched_weight.size):
            mass[g] = h * enriched_weight[g] * enriched_T[g]
        _null_vector(
            alpha, beta, mass[: enriched_weight.size], rule.enriched_phi, rule.enriched_dphi,
            enriched_phi, work, out.enriched[e],
        )  # fmt: skip
        out.log_factor[e] = top
        for k in range(most):
            # Where there are fewer points the last one fills up, without weight.
            g = min(k, points - 1)
            value, other = 0.0, 0.0
            for j in range(m):
                value += phi[g, j] * out.u[e, j]
            for j in range(m2):
                other += compared[g, j] * out.enriched[e, j]
            out.weights[e, k] = h * weight[g] if k < points else 0.0
            out.values[e, k] = value * T[g]
            out.enriched_values[e, k] = other * T[g]
    return out
