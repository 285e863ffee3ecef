"""Microcanonical average of the power that state-dependent damping takes out, Eq. (10)."""

from collections.abc import Callable
from itertools import product
from math import comb, exp, lgamma, prod
from typing import NamedTuple

import numpy as np

from averaging.conditional import bridge_covariance, conditional
from averaging.shell.energy_shell import EnergyShell
from averaging.shell.sums import TARGET, shell_integrals
from averaging.shell.table import ShellTable
from fpk.arrays import Array, Integers
from fpk.moments import gaussian_moment
from fpk.system import System

Power = Callable[[Array], tuple[Array, Array]]

TARGETS = (8e-13, 3e-14)
"""Disagreement of two rules, for n = 1 and more, that ends the refinement for one contact mass,
near round-off: the power cancels against the noise, so that its error adds up in ln p."""
ROUND_OFF = 1e-14
"""Relative error, to the sum of absolute values, of some dozens of Gaussian moments and factors."""


class Parts(NamedTuple):
    """⟨Σ c_ij v_i v_j⟩ given the whitened coordinates y = r e of the contact masses, in monomials.

    A part is H^(1 + degree/2) · coefficient · (r/√H)^k · v^j · Π s_i^powers_i, v = 1 − V_red/H,
    where s_i = ``follow`` @ e is the mean displacement of mass i per r; k and j are its ``orders``.
    """

    degree: Integers  # (parts,) of the damping term
    orders: Integers  # (parts, 2)
    coefficient: Array  # (parts,)
    powers: Integers  # (parts, n)
    follow: Array  # (n, c)


def term_power(system: System) -> Power:
    """Return ⟨Σ c_ij v_i v_j⟩_H of the damping terms alone, Eq. (10) for c_ij(q, v).

    What is returned takes energies > 0 (energies,) to the power and its error, in energy/time.
    Momenta and displacements without contact are averaged in closed form; what is left are
    integrals of polynomials over the contact masses, along rays and over directions.
    """
    # The power is Σ_d g_d(H) H^(1 + d/2) over the degrees d; without contact g_d is constant.
    shell = system.fact(EnergyShell)
    parts = _parts(shell)
    degrees, row = np.unique(parts.degree, return_inverse=True)
    free, size = np.zeros((2, degrees.size))
    for k, (average, bound) in zip(row, _free_averages(parts, system.n), strict=True):
        free[k] += average
        size[k] += bound
    # What cancels between two terms is their round-off.
    free[np.abs(free) <= ROUND_OFF * size] = 0.0
    begins = min(shell.contact_energies, default=np.inf)

    def relative(energy: Array) -> Array:
        g, error = _averages(shell, parts, energy)
        return np.column_stack([g / size, np.max(error / size, axis=1)])

    table = ShellTable(relative, shell) if shell.count > 1 else None

    def power(energy: Array) -> tuple[Array, Array]:
        g, error = np.tile(free, (energy.size, 1)), np.zeros((energy.size, 1))
        touching = np.flatnonzero(energy > begins)
        if touching.size and degrees.size:
            if table is None:
                g[touching], own = _averages(shell, parts, energy[touching])
                error[touching] = np.max(own / size, axis=1, keepdims=True)
            else:
                values = table(energy[touching])
                g[touching], error[touching] = values[:, :-1] * size, values[:, -1:]
        powers = energy[:, None] ** (1.0 + 0.5 * degrees)
        return np.sum(g * powers, axis=1), np.sum((error + ROUND_OFF) * size * powers, axis=1)

    return power


def _parts(shell: EnergyShell) -> Parts:
    """Return the parts of all damping terms.

    A displacement is q_i = s_i r + ξ_i, V = V_red + ½ ξᵀKξ. Given y, the N = 2n − c numbers
    (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a moment of degree 2j is
    (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times that of Gaussian ones.
    """
    system, n, masses = shell.system, shell.system.n, list(shell.masses)
    follow, covariance = np.zeros((n, shell.count)), bridge_covariance(system, masses)
    follow[masses] = shell.L
    for i in set(range(n)) - set(masses):
        follow[i] = conditional(system, i, masses).weights @ shell.L
    half_n = n - 0.5 * shell.count
    rows = []
    for term in system.damping_terms:
        v, q = np.array(term.powers("v", n)), term.powers("q", n)
        np.add.at(v, [term.row, term.column], 1)
        velocities = gaussian_moment(np.diag(1.0 / system.mass), tuple(v.tolist()))
        for about in product(*(range(power + 1) for power in q)):  # the powers of ξ
            left = tuple(power - b for power, b in zip(q, about, strict=True))
            moment = velocities * gaussian_moment(covariance, about)
            if moment == 0.0 or (not masses and any(left)):
                continue
            j = (sum(about) + int(v.sum())) // 2
            choices = prod(comb(power, b) for power, b in zip(q, about, strict=True))
            sphere = exp(lgamma(half_n) - lgamma(half_n + j))
            value = term.coefficient * choices * moment * sphere
            rows.append((term.degree, (sum(left), j), value, left))
    degree, orders, coefficient, powers = zip(*rows, strict=True) if rows else ((), (), (), ())
    return Parts(
        np.array(degree, dtype=np.int64),
        np.array(orders, dtype=np.int64).reshape(-1, 2),
        np.array(coefficient, dtype=float),
        np.array(powers, dtype=np.int64).reshape(-1, n),
        follow,
    )


def _free_averages(parts: Parts, n: int) -> list[tuple[float, float]]:
    """Average of each part over a shell without contact, H^(1 + degree/2) aside, and its bound.

    y is Gaussian there. A sum of 2n squares ½x² that is H instead of Gamma(n) loses Γ(n + s)/Γ(n)
    in degree 2s. The bound is that of |part|, by its mean square.
    """
    covariance, half_n = parts.follow @ parts.follow.T, n - 0.5 * parts.follow.shape[1]
    averages = []
    for (k, j), C, powers in zip(parts.orders, parts.coefficient, parts.powers, strict=True):
        log_rest = lgamma(half_n + j) - lgamma(half_n) + lgamma(n) - lgamma(n + 0.5 * k + j)
        mean, square = (gaussian_moment(covariance, tuple(i * p for p in powers)) for i in (1, 2))
        averages.append((C * mean * exp(log_rest), abs(C) * square**0.5 * exp(log_rest)))
    return averages


def _averages(shell: EnergyShell, parts: Parts, energy: Array) -> tuple[Array, Array]:
    """g_d and their errors (energies, degrees), by quadrature."""
    orders, column = np.unique(parts.orders, axis=0, return_inverse=True)
    of_degree = (parts.degree[:, None] == np.unique(parts.degree)).astype(float)
    largest = np.linalg.norm(parts.follow, axis=1)
    odd = parts.powers % 2

    def combine(directions: Array, integrals: Array) -> Array:
        radial = integrals[..., 3 + column.ravel()] * parts.coefficient
        s = (directions @ parts.follow.T)[:, None, :]
        # A smooth bound of |s| by its largest value f: |s| <= ½ (f + s²/f). A kink would spoil the
        # rules.
        bound = 0.5 * (largest + s * s / np.where(largest > 0.0, largest, 1.0))
        power = (radial * np.prod(s**parts.powers, axis=2)) @ of_degree
        most = np.abs(radial) * np.prod(s ** (parts.powers - odd) * bound**odd, axis=2)
        # Positive, so that no error is relative to nothing.
        return np.concatenate(
            [integrals[..., :1], power + 2.0 * most @ of_degree, most @ of_degree], axis=-1
        )

    one = shell.count == 1
    target = TARGETS[min(shell.system.n, 2) - 1] if one else TARGET
    sums, errors = shell_integrals(
        shell, energy, np.abs, orders=orders, combine=combine, target=target
    )
    states, shifted, most = np.split(sums, [1, 1 + of_degree.shape[1]], axis=1)
    # The errors of shifted (at most 3 of most), of 2 most and of states (g is at most most).
    return (shifted - 2.0 * most) / states, 6.0 * errors.max(axis=1)[:, None] * most / states
