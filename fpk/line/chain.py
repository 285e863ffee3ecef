"""Compiled scaling of the elements of one energy to one continuous density of mass one."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiling import SUMS, cached_njit
from fpk.line.null_vectors import Solved

Array = NDArray[np.float64]


class Assembled(NamedTuple):
    """The elements scaled to one density of mass 1, beside the enriched solution.

    ``u``, ``log_scale`` (and of the enriched one) as in ``StationarySolution``; ``share`` the mass
    of each element, ``p`` (elements, points) the density at the Gauss points; ``distance``
    ∫|p − p_enriched| of each element, and ``indicator`` what of it is its own making.
    """

    u: Array
    log_scale: Array
    enriched: Array
    enriched_log_scale: Array
    share: Array
    p: Array
    distance: Array
    indicator: Array


class Checks(NamedTuple):
    """What an assembled solution is judged by.

    ``distance`` ∫|p − p_enriched|, ``mass`` ∫p, ``least`` the smallest and ``most`` the largest p,
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


@njit(fastmath=SUMS, error_model="numpy", forceinline=True)
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


@cached_njit(SUMS)
def assembled(s: Solved) -> Assembled:
    """Scale the elements, ascending, to a global solution."""
    count, points = s.values.shape
    sign, other_sign = np.empty(count), np.empty(count)
    log_mass, other_log_mass = np.empty(count), np.empty(count)
    out = Assembled(
        np.empty(s.u.shape), np.empty(count), np.empty(s.enriched.shape), np.empty(count),
        np.empty(count), np.empty(s.values.shape), np.empty(count), np.empty(count),
    )  # fmt: skip
    _chained(s.u, s.log_factor, sign, out.log_scale, log_mass)
    _chained(s.enriched, s.log_factor, other_sign, out.enriched_log_scale, other_log_mass)
    below = 0.0
    for e in range(count):
        for j in range(s.u.shape[1]):
            out.u[e, j] = sign[e] * s.u[e, j]
        for j in range(s.enriched.shape[1]):
            out.enriched[e, j] = other_sign[e] * s.enriched[e, j]
        share = sign[e] * np.exp(log_mass[e])
        other_share = other_sign[e] * np.exp(other_log_mass[e])
        out.share[e] = share
        distance, shape = 0.0, 0.0
        for g in range(points):
            out.p[e, g] = share * s.values[e, g]
            distance += s.weights[e, g] * abs(out.p[e, g] - other_share * s.enriched_values[e, g])
            shape += s.weights[e, g] * abs(s.values[e, g] - s.enriched_values[e, g])
        out.distance[e] = distance
        out.indicator[e] = abs(share) * shape
        if e:
            # A wrong step between two neighbours moves the smaller of the masses on its sides.
            gap = (log_mass[e] - log_mass[e - 1]) - (other_log_mass[e] - other_log_mass[e - 1])
            moved = abs(gap) * min(below, max(1.0 - below, 0.0))
            out.indicator[e - 1] += moved
            out.indicator[e] += moved
        below += abs(share)
    return out


@cached_njit(SUMS)
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
