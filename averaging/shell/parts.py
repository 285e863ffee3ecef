"""The power that damping terms take out, as a polynomial in the contact displacements."""

from collections import defaultdict
from itertools import product
from math import comb, prod
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from averaging.conditional import bridge_covariance, conditional
from averaging.shell.energy_shell import Combine, EnergyShell
from fpk.numeric.arrays import Array, Integers
from fpk.system.damping import gaussian_moment
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

    groups: Integers  # (groups, 2), degrees and orders of the terms
    group: Integers  # (parts,), which of them
    powers: Integers  # (parts, c)
    coefficient: Array  # (parts,)
    size: Array  # (parts,), the sum of the absolute values that the coefficient is a sum of
    mean: Array  # (parts,), the mean of each part without contact at β = 1
    spread: Array  # (parts,), the root of its mean square, with the size as coefficient
    degrees: Integers  # of the damping terms, ascending
    of_degree: Array  # (parts, degrees), 1 where a part is of a degree and 0 elsewhere
    free: Array  # (degrees,), g_d
    free_size: Array  # (degrees,), the same of the spread

    def along_rays(self, shell: EnergyShell) -> tuple[Integers, Combine]:
        """Return the orders (k, j) of integrals along rays for the power, and their combination.

        The quantities after T, phase volume and H T' are T g_d plus twice a bound of it, so that it
        is positive, and the bound, for all degrees d.

        Given y the N = 2n − c numbers (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a
        moment of degree 2j is (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times that of Gaussian ones.
        """
        total = self.powers.sum(axis=1)
        both = np.stack([total, (self.groups[self.group, 1] - total) // 2], axis=1)
        orders, column = np.unique(both, axis=0, return_inverse=True)
        half_n = shell.system.n - 0.5 * shell.count
        rest = np.exp(gammaln(half_n) - gammaln(half_n + both[:, 1]))
        largest = np.linalg.norm(shell.L, axis=1)
        odd = self.powers % 2

        def combine(directions: Array, integrals: Array) -> Array:
            radial = integrals[..., 3 + column.ravel()] * rest
            q = (directions @ shell.L.T)[:, None, :]
            # |q| <= ½ (f + q²/f), f the largest |q|: smooth, as a kink would spoil the rules.
            bound = 0.5 * (largest + q * q / largest)
            power = (self.coefficient * radial * np.prod(q**self.powers, axis=2)) @ self.of_degree
            most = self.size * radial * np.prod(q ** (self.powers - odd) * bound**odd, axis=2)
            most = most @ self.of_degree
            # Positive, so that no error is relative to nothing.
            return np.concatenate([integrals[..., :3], power + 2.0 * most, most], axis=-1)

        return orders, combine


def parts_of(system: System) -> Parts:
    """Return the parts of all damping terms.

    A displacement without contact is q_i = Σ w_k q_k + ξ_i, the sum over the contact masses next to
    it, V = V_red + ½ ξᵀKξ.
    """
    n, masses = system.n, list(system.contact_masses)
    weights, covariance = np.zeros((n, len(masses))), bridge_covariance(system, masses)
    weights[masses] = np.eye(len(masses))
    for i in set(range(n)) - set(masses):
        weights[i] = conditional(system, i, masses).weights
    sums: dict[tuple[int, ...], Array] = defaultdict(lambda: np.zeros(2))
    for term in system.damping_terms:
        q = term.powers("q", n)
        C = term.coefficient * gaussian_moment(np.diag(1.0 / system.mass), term.velocities(n))
        for about in product(*(range(power + 1) for power in q)):  # the powers of ξ
            left = np.repeat(np.arange(n), np.subtract(q, about))
            moment = gaussian_moment(covariance, about) * prod(map(comb, q, about))
            for masses_of in product(*(np.flatnonzero(weights[i]).tolist() for i in left)):
                value = C * moment * float(np.prod(weights[left, list(masses_of)]))
                powers_of = map(masses_of.count, range(len(masses)))
                sums[term.degree, term.factors, *powers_of] += value, abs(value)
    keys = np.array(list(sums), dtype=np.int64).reshape(len(sums), 2 + len(masses))
    groups, group = np.unique(keys[:, :2], axis=0, return_inverse=True)
    (degree, order), powers = keys[:, :2].T, keys[:, 2:]
    coefficient, size = np.array(list(sums.values())).reshape(-1, 2).T
    # What is left where terms cancel is their round-off, which ``size`` still states.
    coefficient = np.where(np.abs(coefficient) > ROUND_OFF * size, coefficient, 0.0)
    L = system.fact(EnergyShell).L
    mean, square = (
        np.array([gaussian_moment(L @ L.T, tuple(row)) for row in (k * powers).tolist()])
        for k in (1, 2)
    )
    mean, spread = coefficient * mean, size * square**0.5
    degrees = np.unique(degree)
    of_degree = np.asarray(degree[:, None] == degrees, dtype=float)
    rest = np.exp(gammaln(n) - gammaln(n + 0.5 * order))[:, None] * of_degree
    free, free_size = mean @ rest, spread @ rest
    free = np.where(np.abs(free) > ROUND_OFF * free_size, free, 0.0)
    return Parts(
        groups,
        group.ravel(),
        powers,
        coefficient,
        size,
        mean,
        spread,
        degrees,
        of_degree,
        free,
        free_size,
    )
