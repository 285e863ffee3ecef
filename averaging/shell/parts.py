"""The power that damping terms take out, as a polynomial in the contact displacements."""

from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from averaging.shell.energy_shell import Combine, EnergyShell
from fpk.numeric.arrays import Array, Integers
from fpk.system.damping import gaussian_moment
from fpk.system.equivalent import power_given
from fpk.system.system import System

ROUND_OFF = 1e-14
"""Relative error, to the sum of absolute values, of some dozens of Gaussian moments and factors."""


class Parts(NamedTuple):
    """Σ c_ij v_i v_j of the damping terms, averaged given the contact displacements q_c.

    With momenta and the other displacements Gaussian at the temperature 1/β, a part is
    H^energy · coefficient · β^(−j) · Π q_c^powers. The order is Σ powers + 2 j, the same for all
    parts of a term, whose degree is order − 2 + 2 energy. Without contact the power is
    Σ_d g_d H^(1 + d/2), d one of ``degrees``.
    """

    powers: Integers  # (parts, c)
    coefficient: Array  # (parts,)
    size: Array  # (parts,), the sum of the absolute values that the coefficient is a sum of
    orders: Integers  # (groups,), of the terms of one degree and order
    of_group: Array  # (parts, groups), 1 where a part is of a group and 0 elsewhere
    mean: Array  # (groups,), the mean without contact at β = 1
    spread: Array  # (groups,), a bound of the size of the mean
    degrees: Integers  # of the damping terms, ascending
    of_degree: Array  # (groups, degrees), Γ(n)/Γ(n + order/2) where a group is of a degree, else 0
    free: Array  # (degrees,), g_d
    scale: Array  # (degrees,), the same of the spread: the size of g_d


def parts_of(system: System) -> Parts:
    """Return the parts of all damping terms."""
    if not system.damping_terms:
        no, none, square = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 0))
        powers = np.zeros((0, len(system.contact_masses)), dtype=np.int64)
        return Parts(powers, none, none, no, square, none, none, no, square, none, none)
    keys, values = power_given(system, system.damping_terms)
    groups, group = np.unique(keys[:, :2], axis=0, return_inverse=True)
    of_group = np.eye(len(groups))[group.ravel()]
    powers, (coefficient, size) = keys[:, 2:], values.T
    # What is left where terms cancel is their round-off, which ``size`` still states.
    coefficient = np.where(np.abs(coefficient) > ROUND_OFF * size, coefficient, 0.0)
    L = system.fact(EnergyShell).L
    mean, square = (
        np.array([gaussian_moment(L @ L.T, tuple(row)) for row in (k * powers).tolist()])
        for k in (1, 2)
    )
    mean, spread = (coefficient * mean) @ of_group, (size * square**0.5) @ of_group
    degree, orders = groups.T
    degrees = np.unique(degree)
    rest = np.exp(gammaln(system.n) - gammaln(system.n + 0.5 * orders))
    of_degree = rest[:, None] * (degree[:, None] == degrees)
    free, scale = mean @ of_degree, spread @ of_degree
    free = np.where(np.abs(free) > ROUND_OFF * scale, free, 0.0)
    return Parts(
        powers, coefficient, size, orders, of_group, mean, spread, degrees, of_degree, free, scale
    )


def parts_along_rays(system: System) -> tuple[Integers, Combine]:
    """Return the orders (k, j) of integrals along rays for the power, and their combination.

    The quantities after T, phase volume and H T' are T g_d plus twice a bound of it, so that it is
    positive, and the bound, for all degrees d.

    Given y the N = 2n − c numbers (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a
    moment of degree 2j is (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times that of Gaussian ones.
    """
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    if not system.damping_terms:
        return np.empty((0, 2), dtype=np.int64), lambda directions, integrals: integrals
    total, odd = parts.powers.sum(axis=1), parts.powers % 2
    both = np.stack([total, (parts.of_group @ parts.orders - total).astype(int) // 2], axis=1)
    orders, column = np.unique(both, axis=0, return_inverse=True)
    half_n = system.n - 0.5 * shell.count
    rest = np.exp(gammaln(half_n) - gammaln(half_n + both[:, 1]))
    largest = np.linalg.norm(shell.L, axis=1)
    of_degree = parts.of_group @ (parts.of_degree > 0.0)

    def combine(directions: Array, integrals: Array) -> Array:
        radial = integrals[..., 3 + column.ravel()] * rest
        q = (directions @ shell.L.T)[:, None, :]
        # |q| <= ½ (f + q²/f), f the largest |q|: smooth, as a kink would spoil the rules.
        bound = 0.5 * (largest + q * q / largest)
        power = (parts.coefficient * radial * np.prod(q**parts.powers, axis=2)) @ of_degree
        most = np.prod(q ** (parts.powers - odd) * bound**odd, axis=2)
        most = (parts.size * radial * most) @ of_degree
        # Positive, so that no error is relative to nothing.
        return np.concatenate([integrals[..., :3], power + 2.0 * most, most], axis=-1)

    return orders, combine
