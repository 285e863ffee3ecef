"""Compiled solution of the stationary FPK equation on one finite element after another.

The null vectors of ``fpk.line.elements``, found by elimination in small dense matrices, and their
scaling to one continuous density of mass one.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiling import FLAGS
from fpk.line.elements import gauss_rule, shape_functions
from fpk.process import Coefficients

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer."""
MORE_POINTS = 8
"""Points by which integrals over an element that begins where contact does exceed the others."""
NO_WEIGHT = 1e-200
"""Pivot, relative to its row, of a direction of u that has no weight in any equation: it is left
at zero. So it goes where T spans hundreds of decades in one element (n = 50 masses near H = 0)."""


class Rule(NamedTuple):
    """Points of an element and what shape functions are there.

    ``share`` and ``weight`` (points,) are Gauss points of [0, 1], those of the answer before those
    of its twin; ``phi``, ``dphi`` (points, degree + 1) are shape functions and slopes of the answer
    at its own, ``twin_phi``, ``twin_dphi`` of the twin at its own, ``seen`` of the twin at those of
    the answer.
    """

    share: Array
    weight: Array
    phi: Array
    dphi: Array
    twin_phi: Array
    twin_dphi: Array
    seen: Array


class Solved(NamedTuple):
    """Null vectors of elements and their enriched twins; every array is indexed by element first.

    ``u`` (elements, degree + 1), ``twin`` (elements, degree + 3) are coefficients of the shape
    functions for the mass 1, ``log_factor`` and ``twin_log_factor`` ln of what p = factor·T·u has
    to be multiplied by, ``values`` and ``twin_values`` (elements, points) p at the answer's points
    for integrals, whose ``weights`` are. ``residual`` is relative to the terms that cancel in
    it; ``net_flux`` is the mean of |J| and ``one_way`` that of its two parts.
    """

    u: Array
    twin: Array
    log_factor: Array
    twin_log_factor: Array
    values: Array
    twin_values: Array
    weights: Array
    residual: Array
    net_flux: Array
    one_way: Array


class Assembled(NamedTuple):
    """The elements scaled to one density of mass 1, beside their enriched twin.

    ``u``, ``log_scale`` (and the same of the twin) as in ``StationarySolution``; ``share`` the mass
    of each element, ``p`` (elements, points) the density at the Gauss points; ``distance``
    ∫|p − p_twin| of each element, and ``indicator`` what of it is its own making.
    """

    u: Array
    log_scale: Array
    twin: Array
    twin_log_scale: Array
    share: Array
    p: Array
    distance: Array
    indicator: Array


class Work(NamedTuple):
    """What one null vector takes: a matrix and its factors (m, m), a vector and pivots (m,)."""

    A: Array
    B: Array
    r: Array
    pivot: Integers


@lru_cache
def element_rule(degree: int) -> Rule:
    """Return the points of elements of ``degree``: each degree has Gauss points of its own."""
    return _rule(degree, *zip(*map(gauss_rule, (degree, degree + ENRICHMENT)), strict=True))


@lru_cache
def contact_rule(degree: int) -> Rule:
    """Return the points for integrals over an element that begins where contact does.

    Gauss points in (H − H_c)^⅓: in √(H − H_c) T is smooth, but stiff contact leaves a layer just
    above H_c, which asks for more points there. Slopes are not needed.
    """
    count = degree + MORE_POINTS
    rules = [gauss_rule(d) for d in (count, count + ENRICHMENT)]
    cubed = [(t**3, 3.0 * t**2 * w) for t, w in rules]
    return _rule(degree, *zip(*cubed, strict=True))


def _rule(degree: int, points: tuple[Array, ...], weights: tuple[Array, ...]) -> Rule:
    own, twin = points
    phi, dphi = _shapes(degree, own)
    twin_phi, twin_dphi = _shapes(degree + ENRICHMENT, twin)
    seen, _ = _shapes(degree + ENRICHMENT, own)
    share, weight = np.concatenate(points), np.concatenate(weights)
    return Rule(share, weight, phi, dphi, twin_phi, twin_dphi, seen)


def _shapes(degree: int, share: Array) -> tuple[Array, Array]:
    value, slope = shape_functions(degree, share)
    return np.ascontiguousarray(value.T), np.ascontiguousarray(slope.T)


SUMS = FLAGS | {"reassoc"}
"""Here nothing depends on the order of a sum: elimination is backward stable in any."""

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


@_inner
def _null_vector(
    alpha: Array, beta: Array, mass: Array, phi: Array, dphi: Array, inner: Array, work: Work,
    u: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Write to ``u`` the solution of ∫J v' = 0, ∫p = 1; J = alpha u + beta u', p = mass u.

    ``alpha``, ``beta`` and ``mass`` (points,) have the weights in them. Returns the residual
    relative to the terms that cancel in it, |∫J| and the sum of the integrals of its two parts.
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
        drift, diffusion = 0.0, 0.0
        for j in range(m):
            drift += phi[g, j] * u[j]
            diffusion += dphi[g, j] * u[j]
        net += alpha[g] * drift + beta[g] * diffusion
        parts += abs(alpha[g] * drift) + abs(beta[g] * diffusion)
    return left / terms, abs(net), parts


@_inner
def _flux_terms(
    c: Coefficients, e: int, first: int, h: float, weight: Array, flux: bool, alpha: Array,
    beta: Array,
) -> float:  # fmt: skip
    """Write α and β of J = α u + β u' with weights, and return ln of the factor left out.

    "drift-diffusion": u = p, J = s p − ½ (b p)'. "flux": u = p/T is the phase-space density and
    J = T (F u − ½ b u') with F the part of the drift due to damping; the noise part of the drift,
    ½ (bT)'/T, has cancelled, so that no derivative of b is needed, and u is smooth where T is not.
    """
    top = 0.0
    if flux:
        top = -np.inf
        for g in range(alpha.size):
            top = max(top, c.log_density_of_states[e, first + g])
    for g in range(alpha.size):
        k, w = first + g, weight[first + g]
        if flux:
            w *= np.exp(c.log_density_of_states[e, k] - top)
            alpha[g] = c.dissipation[e, k] * h * w
        else:
            alpha[g] = (c.drift[e, k] - 0.5 * c.diffusion_slope[e, k]) * h * w
        beta[g] = -0.5 * c.diffusion[e, k] * w
    return top


@njit(fastmath=SUMS, error_model="numpy", cache=True, nogil=True)
def solved_elements(
    c: Coefficients, lengths: Array, row: Integers, log_states: Array, rule: Rule, contact: Rule,
    flux: bool,
) -> Solved:  # fmt: skip
    """Solve elements from their coefficients (elements, points) at the points of ``rule``.

    ``row`` says which row of ``log_states``, ln T at the points of ``contact``, belongs to an
    element that begins where contact does; it is −1 for the others.
    """
    count, (p, m), (p2, m2) = lengths.size, rule.phi.shape, rule.twin_phi.shape
    most = contact.phi.shape[0]
    found = Solved(
        np.empty((count, m)), np.empty((count, m2)), np.empty(count), np.empty(count),
        np.empty((count, most)), np.empty((count, most)), np.empty((count, most)),
        np.empty(count), np.empty(count), np.empty(count),
    )  # fmt: skip
    alpha, beta = np.empty(p2), np.empty(p2)
    mass, T = np.empty(contact.share.size), np.ones(contact.share.size)
    own_work = Work(np.empty((m, m)), np.empty((m, m)), np.empty(m), np.empty(m, np.int64))
    work = Work(np.empty((m2, m2)), np.empty((m2, m2)), np.empty(m2), np.empty(m2, np.int64))
    for e in range(count):
        h, begins = lengths[e], row[e] >= 0
        inner = contact if begins else rule
        log_T = log_states[row[e]] if begins else c.log_density_of_states[e]
        points = inner.phi.shape[0]
        own = _flux_terms(c, e, 0, h, rule.weight, flux, alpha[:p], beta[:p])
        for g in range(inner.share.size):
            mass[g] = h * inner.weight[g]
        if flux:
            for g in range(points):
                T[g] = np.exp(log_T[g] - own)
                mass[g] *= T[g]
        residual, net, parts = _null_vector(
            alpha[:p], beta[:p], mass, rule.phi, rule.dphi, inner.phi, own_work, found.u[e]
        )
        found.residual[e], found.net_flux[e], found.one_way[e] = residual, net / h, parts / h
        top = _flux_terms(c, e, p, h, rule.weight, flux, alpha, beta)
        if flux:
            for g in range(points, inner.share.size):
                mass[g] *= np.exp(log_T[g] - top)
        _null_vector(
            alpha, beta, mass[points:], rule.twin_phi, rule.twin_dphi, inner.twin_phi, work,
            found.twin[e],
        )  # fmt: skip
        found.log_factor[e], found.twin_log_factor[e] = own, top
        for k in range(most):
            # Where there are fewer points the last one fills up, without weight.
            g = min(k, points - 1)
            value, other = 0.0, 0.0
            for j in range(m):
                value += inner.phi[g, j] * found.u[e, j]
            for j in range(m2):
                other += inner.seen[g, j] * found.twin[e, j]
            found.weights[e, k] = h * inner.weight[g] if k < points else 0.0
            found.values[e, k] = value * T[g]
            found.twin_values[e, k] = other * T[g] * np.exp(own - top)
    return found


@_inner
def _chained(u: Array, log_factor: Array, sign: Array, log_scale: Array, log_mass: Array) -> None:
    """Write signs and logs of the elements' scales of u, and logs of their masses.

    The scales make u continuous, the masses sum to one, and where mass is most u is positive.
    """
    count, tiny = log_factor.size, 2.2250738585072014e-308
    sign[0], log_scale[0], top = 1.0, 0.0, 0
    for e in range(count):
        if e:
            leaving, entering = u[e - 1, 1], u[e, 0]
            log_scale[e] = (
                log_scale[e - 1]
                + np.log(max(abs(leaving), tiny))
                - np.log(max(abs(entering), tiny))
            )
            sign[e] = -sign[e - 1] if (leaving < 0.0) != (entering < 0.0) else sign[e - 1]
        log_mass[e] = log_scale[e] + log_factor[e]
        top = e if log_mass[e] > log_mass[top] else top
    total, turned, most = 0.0, sign[top], log_mass[top]
    for e in range(count):
        sign[e] *= turned
        total += sign[e] * np.exp(log_mass[e] - most)
    total = most + np.log(total)
    for e in range(count):
        log_scale[e] -= total
        log_mass[e] -= total


@njit(fastmath=SUMS, error_model="numpy", cache=True, nogil=True)
def assembled(s: Solved) -> Assembled:
    """Scale the elements, ascending, to a global solution."""
    count, points = s.values.shape
    sign, twin_sign = np.empty(count), np.empty(count)
    log_mass, twin_log_mass = np.empty(count), np.empty(count)
    found = Assembled(
        np.empty(s.u.shape), np.empty(count), np.empty(s.twin.shape), np.empty(count),
        np.empty(count), np.empty(s.values.shape), np.empty(count), np.empty(count),
    )  # fmt: skip
    _chained(s.u, s.log_factor, sign, found.log_scale, log_mass)
    _chained(s.twin, s.twin_log_factor, twin_sign, found.twin_log_scale, twin_log_mass)
    below = 0.0
    for e in range(count):
        found.u[e] = sign[e] * s.u[e]
        found.twin[e] = twin_sign[e] * s.twin[e]
        share = sign[e] * np.exp(log_mass[e])
        twin_share = twin_sign[e] * np.exp(twin_log_mass[e])
        found.share[e] = share
        distance, shape = 0.0, 0.0
        for g in range(points):
            found.p[e, g] = share * s.values[e, g]
            distance += s.weights[e, g] * abs(found.p[e, g] - twin_share * s.twin_values[e, g])
            shape += s.weights[e, g] * abs(s.values[e, g] - s.twin_values[e, g])
        found.distance[e] = distance
        found.indicator[e] = abs(share) * shape
        if e:
            # A wrong step between two neighbours moves the smaller of the masses on its sides.
            gap = (log_mass[e] - log_mass[e - 1]) - (twin_log_mass[e] - twin_log_mass[e - 1])
            moved = abs(gap) * min(below, max(1.0 - below, 0.0))
            found.indicator[e - 1] += moved
            found.indicator[e] += moved
        below += abs(share)
    return found


class Checks(NamedTuple):
    """What an assembled solution is judged by.

    ``distance`` ∫|p − p_twin|, ``mass`` ∫p, ``least`` the smallest and ``most`` the largest p,
    ``residual`` the largest; ``net_flux`` the largest relative to the largest one-way flux;
    ``coefficient_error`` Σ share · relative error of the coefficients.
    """

    distance: float
    mass: float
    least: float
    most: float
    residual: float
    net_flux: float
    coefficient_error: float


@njit(fastmath=SUMS, error_model="numpy", cache=True, nogil=True)
def checks(s: Solved, a: Assembled, relative_error: Array) -> Checks:
    """Sum up the elements, each with the largest relative error of its coefficients."""
    distance, mass, residual, net, one_way, error = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    least, most = np.inf, -np.inf
    for e in range(a.share.size):
        share = abs(a.share[e])
        distance += a.distance[e]
        error += share * relative_error[e]
        residual = max(residual, s.residual[e])
        net, one_way = max(net, share * s.net_flux[e]), max(one_way, share * s.one_way[e])
        for g in range(a.p.shape[1]):
            mass += s.weights[e, g] * a.p[e, g]
            least, most = min(least, a.p[e, g]), max(most, a.p[e, g])
    return Checks(distance, mass, least, most, residual, net / one_way, error)
