"""The power that damping terms take out, as a polynomial in the contact displacements."""

from collections import defaultdict
from itertools import product
from math import comb, prod
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from averaging.conditional import bridge_covariance, conditional
from averaging.shell.energy_shell import EnergyShell
from averaging.shell.sums import Combine
from fpk.arrays import Array, Integers
from fpk.damping import gaussian_moment
from fpk.system import System

ROUND_OFF = 1e-14
"""Relative error, to the sum of absolute values, of some dozens of Gaussian moments and factors."""


class Parts(NamedTuple):
    """Σ c_ij v_i v_j of the damping terms, averaged given the contact displacements q_c.

    With momenta and the other displacements Gaussian at the temperature 1/β, a part is
    H^energy · coefficient · β^(−j) · Π q_c^powers. The ``order`` is Σ powers + 2 j, the same for
    all parts of a term, whose ``degree`` is order − 2 + 2 energy.
    """

    degree: Integers  # (parts,)
    order: Integers  # (parts,)
    powers: Integers  # (parts, c)
    coefficient: Array  # (parts,)
    size: Array  # (parts,), the sum of the absolute values that the coefficient is a sum of

    def gaussian(self, shell: EnergyShell) -> tuple[Array, Array]:
        """Mean of each part without contact at β = 1, (parts,), and root of its mean square."""
        covariance = shell.L @ shell.L.T
        mean, square = np.array(
            [
                [gaussian_moment(covariance, tuple(row)) for row in (k * self.powers).tolist()]
                for k in (1, 2)
            ]
        )
        return self.coefficient * mean, self.size * square**0.5

    def free_power(self, system: System) -> tuple[Array, Array]:
        """Return g of the power Σ_d g_d H^(1 + d/2) without contact, and its size, (degrees,)."""
        rest = np.exp(gammaln(system.n) - gammaln(system.n + 0.5 * self.order))
        free, size = (
            np.asarray((x * rest) @ self.of_degree) for x in self.gaussian(system.fact(EnergyShell))
        )
        # What cancels between two terms is their round-off.
        return np.where(np.abs(free) > ROUND_OFF * size, free, 0.0), size

    def along_rays(self, shell: EnergyShell) -> tuple[Integers, Combine]:
        """Return the orders (k, j) of integrals along rays for the power, and what combines them.

        The quantities beside T, phase volume and H T' are T again, T g_d plus twice a bound of it,
        so that it is positive, and the bound, for all degrees d.

        Given y the N = 2n − c numbers (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a
        moment of degree 2j is (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times that of Gaussian ones.
        """
        both = np.stack([self.powers.sum(axis=1), self.j], axis=1)
        orders, column = np.unique(both, axis=0, return_inverse=True)
        half_n = shell.system.n - 0.5 * shell.count
        rest = np.exp(gammaln(half_n) - gammaln(half_n + self.j))
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
            first = [integrals[..., :3], integrals[..., :1]]
            return np.concatenate([*first, power + 2.0 * most, most], axis=-1)

        return orders, combine

    @property
    def degrees(self) -> Integers:
        """Degrees of the damping terms, ascending."""
        return np.unique(self.degree)

    @property
    def of_degree(self) -> Array:
        """1 where a part is of a degree and 0 elsewhere, (parts, degrees)."""
        return np.asarray(self.degree[:, None] == self.degrees, dtype=float)

    @property
    def j(self) -> Integers:
        """Half the number of velocities and Gaussian displacements in each part, (parts,)."""
        return np.asarray((self.order - self.powers.sum(axis=1)) // 2)


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
    sums: dict[tuple[int, int, tuple[int, ...]], Array] = defaultdict(lambda: np.zeros(2))
    for term in system.damping_terms:
        q = term.powers("q", n)
        C = term.coefficient * gaussian_moment(np.diag(1.0 / system.mass), term.velocities(n))
        for about in product(*(range(power + 1) for power in q)):  # the powers of ξ
            left = np.repeat(np.arange(n), np.subtract(q, about))
            moment = gaussian_moment(covariance, about) * prod(map(comb, q, about))
            for masses_of in product(*(np.flatnonzero(weights[i]).tolist() for i in left)):
                share = float(np.prod(weights[left, list(masses_of)]))
                key = tuple(masses_of.count(k) for k in range(len(masses)))
                value = C * moment * share
                sums[term.degree, term.factors, key] += value, abs(value)
    # What is left where terms cancel is their round-off, which ``size`` still states.
    rows = [
        (*key, value if abs(value) > ROUND_OFF * size else 0.0, size)
        for key, (value, size) in sums.items()
    ]
    degree, order, powers, coefficient, size = zip(*rows, strict=True) if rows else ((),) * 5
    return Parts(
        np.array(degree, dtype=np.int64),
        np.array(order, dtype=np.int64),
        np.array(powers, dtype=np.int64).reshape(len(rows), len(masses)),
        np.array(coefficient, dtype=float),
        np.array(size, dtype=float),
    )
