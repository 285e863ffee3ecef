"""Dissipated powers given the contact masses: what is left when all else is averaged out."""

from collections import defaultdict
from dataclasses import dataclass
from math import exp, lgamma, pi

import numpy as np
from numpy.typing import NDArray

from averaging.conditional import bridge_covariance, conditional
from averaging.shell.energy_shell import EnergyShell
from fpk.damping import DampingTerm
from fpk.moments import gaussian_moment

Array = NDArray[np.float64]
Powers = tuple[int, ...]
Polynomial = dict[Powers, float]


@dataclass(frozen=True, eq=False)
class PowerPolynomial:
    """⟨c_ij v_i v_j⟩ of all terms of one degree d, given the whitened coordinates y of contact.

    ``H^(1+d/2) Σ coefficient · (y/√H)^alpha · v^kinetic`` with v = 1 − V_red(y)/H: ``alpha``
    (parts, c), ``kinetic`` and ``coefficient`` (parts,).
    """

    degree: int
    alpha: NDArray[np.int64]
    kinetic: NDArray[np.int64]
    coefficient: Array

    @property
    def orders(self) -> list[tuple[int, int]]:
        """Power of the radius and of v of each part."""
        return [(int(a), int(j)) for a, j in zip(self.alpha.sum(axis=1), self.kinetic, strict=True)]

    def free_size(self, n: int) -> float:
        """Average of Σ|part| over a shell without contact, H^(1+d/2) aside: y/√H is Gaussian there.

        A sum of 2n squares ½x² that is H instead of Gamma(n) loses Γ(n + s)/Γ(n) in degree 2s.
        """
        free = n - 0.5 * self.alpha.shape[1]
        total = 0.0
        for alpha, j, C in zip(self.alpha, self.kinetic, self.coefficient, strict=True):
            y = [2.0 ** (0.5 * a) * exp(lgamma(0.5 * (a + 1))) / np.sqrt(pi) for a in alpha]
            s = 0.5 * int(alpha.sum()) + int(j)
            log_rest = lgamma(free + j) - lgamma(free) + lgamma(n) - lgamma(n + s)
            total += abs(C) * float(np.prod(y)) * exp(log_rest)
        return total


def power_polynomials(shell: EnergyShell) -> tuple[PowerPolynomial, ...]:
    """Return the averages of all damping terms of a system, one polynomial per degree.

    The other displacements are linear in those of the contact masses plus ξ, V = V_red + ½ ξᵀKξ.
    Given y, the N = 2n − c numbers (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a
    moment of degree 2r is (H − V_red)^r Γ(N/2)/Γ(N/2 + r) times that of Gaussian ones.
    """
    found: dict[int, dict[tuple[Powers, int], float]] = defaultdict(lambda: defaultdict(float))
    for term in shell.system.damping_terms:
        for key, value in _averaged(shell, term).items():
            found[term.degree][key] += value
    result = []
    for degree, parts in sorted(found.items()):
        kept = {key: value for key, value in parts.items() if value != 0.0}
        if kept:
            result.append(
                PowerPolynomial(
                    degree,
                    np.array([alpha for alpha, _ in kept]).reshape(len(kept), shell.count),
                    np.array([r for _, r in kept]),
                    np.array(list(kept.values())),
                )
            )
    return tuple(result)


def _averaged(shell: EnergyShell, term: DampingTerm) -> dict[tuple[Powers, int], float]:
    """Coefficients of y^alpha (H − V_red)^r in the average of one term; (alpha, r) are the keys."""
    system, n, c = shell.system, shell.system.n, shell.count
    v = list(term.powers("v", n))
    v[term.row] += 1
    v[term.column] += 1
    velocities = gaussian_moment(np.diag(1.0 / system.mass), tuple(v))
    if velocities == 0.0:
        return {}
    kept = list(shell.masses)
    free = [i for i in range(n) if i not in kept]
    covariance = bridge_covariance(system, free, kept)
    follow = np.zeros((n, c))
    follow[kept] = shell.L
    for i in free:
        follow[i] = conditional(system, i, kept).weights @ shell.L
    polynomial: Polynomial = {(0,) * (c + len(free)): 1.0}
    for mass, power in enumerate(term.powers("q", n)):
        one = {_unit(k, c + len(free)): float(x) for k, x in enumerate(follow[mass]) if x != 0.0}
        if mass in free:
            one[_unit(c + free.index(mass), c + len(free))] = 1.0
        for _ in range(power):
            polynomial = _product(polynomial, one)
    half_n = n - 0.5 * c
    result: dict[tuple[Powers, int], float] = defaultdict(float)
    for powers, coefficient in polynomial.items():
        alpha, beta = powers[:c], powers[c:]
        displacements = gaussian_moment(covariance, beta)
        if displacements != 0.0:
            r = (sum(beta) + sum(v)) // 2
            sphere = exp(lgamma(half_n) - lgamma(half_n + r))
            result[alpha, r] += term.coefficient * coefficient * velocities * displacements * sphere
    return result


def _unit(index: int, size: int) -> Powers:
    return tuple(int(k == index) for k in range(size))


def _product(a: Polynomial, b: Polynomial) -> Polynomial:
    result: Polynomial = defaultdict(float)
    for p, x in a.items():
        for q, y in b.items():
            result[tuple(i + j for i, j in zip(p, q, strict=True))] += x * y
    return result
