"""Phase averages of monomials in the state as polynomials in the modal energies, section 5."""

from collections.abc import Sequence
from functools import cache
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.damping import DampingTerm

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Polynomial(NamedTuple):
    """Homogeneous polynomial of degree d in the modal energies, Σ_r coefficient_r Π_k H_f(r,k).

    ``factors`` (rows, d): the modes of each monomial, counted from 0, ascending in a row and no row
    twice. ``coefficients`` (rows, ..., 2): the value, and the sum of the sizes of all that was
    added up in it, against which its round-off is measured.
    """

    factors: Integers
    coefficients: Array


class ModeShapes(NamedTuple):
    """What an average needs of the modes: T (n, n), one mode a column; M* and K* (n,)."""

    shapes: Array
    mass: Array
    stiffness: Array


ONE = Polynomial(np.zeros((1, 0), dtype=np.int64), np.ones((1, 2)))


def energy_flow(modes: ModeShapes, term: DampingTerm) -> Polynomial:
    """Return Γ_mk with ⟨F_m Q̇_k⟩ = Γ_mk(H) H_k, coefficients (rows, m, k, 2); no row where it is 0.

    F_m = T_im · coefficient Π q_a^. Π v_a^. v_j · H^energy is the generalised damping force of mode
    m, H = ΣH_m, and the average is over independent uniform phases of Q_m = √(2H_m/K*_m) cos φ_m,
    Q̇_m = −√(2H_m/M*_m) sin φ_m, X = T Q (14). Energies that are exponential with means θ_m make
    the modes Gaussian, and E Π H_m^α_m = Π α_m! θ_m^α_m; so the phase average has the coefficients
    of the Gaussian moment, which Isserlis' theorem gives as a polynomial in θ, over Π α_m!.
    Q̇_k is correlated with velocities alone, by T_bk θ_k/M*_k: the factor H_k of the flow.
    """
    T, n = modes.shapes, modes.mass.size
    q, v = term.powers("q", n), list(term.powers("v", n))
    v[term.column] += 1
    if (sum(q) % 2) or (sum(v) % 2 == 0):
        return Polynomial(np.zeros((0, 0), dtype=np.int64), np.zeros((0, n, n, 2)))
    moment_q = _gaussian_moment(np.einsum("am,bm,m->abm", T, T, 1.0 / modes.stiffness), q)
    covariance = np.einsum("am,bm,m->abm", T, T, 1.0 / modes.mass)
    parts = []
    for b in np.flatnonzero(v):
        lowered = tuple(power - (a == b) for a, power in enumerate(v))
        rest = _product(moment_q, _gaussian_moment(covariance, lowered))
        to_each = _sized(v[b] * T[b] / modes.mass)
        parts.append(Polynomial(rest.factors, rest.coefficients[:, None, :] * to_each))
    flow = added(parts)
    counts = (flow.factors[:, :, None] == np.arange(n)).sum(axis=1)
    factorials = np.array([factorial(k) for k in range(1 + int(counts.max(initial=0)))])
    share = 1.0 / (np.prod(factorials[counts], axis=1)[:, None] * (1.0 + counts))
    flow = Polynomial(flow.factors, flow.coefficients * share[:, :, None])
    total = Polynomial(np.arange(n)[:, None], np.ones((n, 2)))
    for _ in range(term.energy):
        flow = _product(flow, total)
    force = _sized(term.coefficient * T[term.row])
    return Polynomial(flow.factors, force[:, None, :] * flow.coefficients[:, None])


def added(parts: Sequence[Polynomial]) -> Polynomial:
    """Return the sum of polynomials of one degree, every monomial once."""
    factors = np.concatenate([part.factors for part in parts])
    coefficients = np.concatenate([part.coefficients for part in parts])
    unique, place = np.unique(factors, axis=0, return_inverse=True)
    total = np.zeros((unique.shape[0], *coefficients.shape[1:]))
    np.add.at(total, place.ravel(), coefficients)
    return Polynomial(unique, total)


def _product(first: Polynomial, second: Polynomial) -> Polynomial:
    """Product of two polynomials, the second with plain coefficients (rows, 2)."""
    rows, others = first.factors.shape[0], second.factors.shape[0]
    pairs = [np.repeat(first.factors, others, axis=0), np.tile(second.factors, (rows, 1))]
    left = first.coefficients[:, None]
    right = second.coefficients.reshape(1, others, *[1] * (first.coefficients.ndim - 2), 2)
    product = (left * right).reshape(-1, *first.coefficients.shape[1:])
    return added([Polynomial(np.sort(np.concatenate(pairs, axis=1), axis=1), product)])


def _gaussian_moment(covariance: Array, powers: tuple[int, ...]) -> Polynomial:
    """E Π x_a^powers[a] as a polynomial in θ of x ~ N(0, Σ_m covariance[:, :, m] θ_m)."""
    modes = np.arange(covariance.shape[2])[:, None]

    @cache
    def moment(powers: tuple[int, ...]) -> Polynomial:
        if not any(powers):
            return ONE
        a = next(i for i, power in enumerate(powers) if power)
        rest = [power - (i == a) for i, power in enumerate(powers)]
        parts = []
        for b in np.flatnonzero(rest):
            lowered = moment(tuple(power - (i == b) for i, power in enumerate(rest)))
            pair = Polynomial(modes, _sized(rest[b] * covariance[a, b]))
            parts.append(_product(lowered, pair))
        return added(parts)

    return moment(tuple(int(power) for power in powers))


def _sized(values: Array) -> Array:
    return np.stack([values, np.abs(values)], axis=-1)
