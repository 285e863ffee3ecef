"""Microcanonical average of the power that state-dependent damping takes out, Eq. (10)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import lgamma

import numpy as np
from numpy.typing import NDArray

from averaging.shell.energy_shell import EnergyShell, energy_shell
from averaging.shell.monomials import PowerPolynomial, power_polynomials
from averaging.shell.sums import TARGET, shell_integrals
from averaging.shell.table import ShellTable
from fpk.equivalent import dissipated_power
from fpk.system import System

Array = NDArray[np.float64]
Averages = Callable[[Array], tuple[Array, Array]]

TARGETS = (8e-13, 3e-14)
"""Disagreement of two levels, for n = 1 and more, that ends the refinement for one contact mass:
the power cancels against the noise, so that its error adds up in ln p. Twice and ten times what
round-off leaves (``averaging.shell.sums``)."""
ROUND_OFF = 1e-14
"""Relative error, to the sum of absolute values, of some dozens of Gaussian moments and factors."""


@dataclass(frozen=True, eq=False)
class TermPower:
    """⟨Σ c_ij v_i v_j⟩_H of the damping terms of one system, without the constant matrix.

    It is Σ_d g_d(H) H^(1 + d/2) over the ``degrees`` d of the terms; below the first contact
    energy ``begins`` g_d is the constant ``free``. ``size`` is the like of Σ|c_ij v_i v_j|.
    ``integrals`` gives g_d and their errors, both (energies, degrees), above ``begins``.
    """

    degrees: Array
    free: Array
    size: Array
    begins: float
    integrals: Averages

    def __call__(self, energy: Array) -> tuple[Array, Array]:
        """The power and its error at energies > 0 of shape (energies,), in energy/time."""
        g = np.tile(self.free, (energy.size, 1))
        error = np.zeros_like(g)
        touching = np.flatnonzero(energy > self.begins)
        if touching.size and self.degrees.size:
            g[touching], error[touching] = self.integrals(energy[touching])
        error = error + ROUND_OFF * self.size
        powers = energy[:, None] ** (1.0 + 0.5 * self.degrees)
        return np.sum(g * powers, axis=1), np.sum(error * powers, axis=1)


def term_power(system: System) -> TermPower:
    """Return the averaged power of the damping terms of ``system``, Eq. (10) for c_ij(q, v).

    Momenta and displacements without contact are averaged in closed form; what is left are
    integrals of polynomials over the contact masses, along rays and over directions, refined until
    two rules agree. V and the polynomial look the same at −y where ``EnergyShell.mirror`` holds, as
    terms of odd degree end it.
    """
    return system.fact(_term_power)


def _term_power(system: System) -> TermPower:
    shell = energy_shell(system)
    polynomials = power_polynomials(shell)
    n = system.n
    gibbs = dissipated_power(system)
    free = np.zeros(len(polynomials))
    for k, polynomial in enumerate(polynomials):
        s = 1 + polynomial.degree // 2
        # On a shell H is H: its powers in the Gibbs state of temperature 1 are taken out.
        if polynomial.degree % 2 == 0 and s < gibbs.size:
            free[k] = gibbs[s] * np.exp(lgamma(n) - lgamma(n + s))
    size = np.array([polynomial.free_size(n) for polynomial in polynomials])
    integrals: Averages = partial(_averages, shell, polynomials)
    if shell.count > 1 and polynomials:
        integrals = _tabulated(integrals, size, shell)
    begins = min(shell.contact_energies, default=np.inf)
    degrees = np.array([float(polynomial.degree) for polynomial in polynomials])
    return TermPower(degrees, free, size, begins, integrals)


def _averages(
    shell: EnergyShell, polynomials: Sequence[PowerPolynomial], energy: Array
) -> tuple[Array, Array]:
    """g_d and their errors (energies, degrees), by quadrature."""
    orders = sorted(set().union(*(polynomial.orders for polynomial in polynomials)))
    column = {order: 3 + k for k, order in enumerate(orders)}

    def combine(directions: Array, integrals: Array) -> Array:
        parts = [integrals[..., 0]]
        for polynomial in polynomials:
            radial = integrals[..., [column[o] for o in polynomial.orders]] * polynomial.coefficient
            power = np.sum(radial * _monomials(directions, polynomial.alpha), axis=-1)
            most = np.sum(np.abs(radial) * _majorants(directions, polynomial.alpha), axis=-1)
            # Positive, so that no error is relative to nothing.
            parts += [power + 2.0 * most, most]
        return np.stack(parts, axis=-1)

    sums, errors = shell_integrals(
        shell,
        energy,
        np.abs,
        orders=np.array(orders, dtype=np.int64),
        combine=combine,
        target=TARGETS[min(shell.system.n, 2) - 1] if shell.count == 1 else TARGET,
    )
    states, shifted, most = sums[:, :1], sums[:, 1::2], sums[:, 2::2]
    # The errors of shifted (at most 3 of most), of 2 most and of states (g is at most most).
    return (shifted - 2.0 * most) / states, 6.0 * errors.max(axis=1)[:, None] * most / states


def _monomials(directions: Array, alpha: NDArray[np.int64]) -> Array:
    """Π e_k^alpha_k of every part, (rays, parts)."""
    return np.asarray(np.prod(directions[:, None, :] ** alpha, axis=2))


def _majorants(directions: Array, alpha: NDArray[np.int64]) -> Array:
    """Smooth bounds of |Π e_k^alpha_k|, by |e| <= ½ (1 + e²): a kink would spoil the rules."""
    odd = alpha % 2
    square = 0.5 * (1.0 + directions[:, None, :] ** 2)
    return np.asarray(np.prod(directions[:, None, :] ** (alpha - odd) * square**odd, axis=2))


def _tabulated(direct: Averages, size: Array, shell: EnergyShell) -> Averages:
    """Piecewise polynomials of g_d/size, for two or more contact masses."""

    def evaluate(energy: Array) -> Array:
        g, error = direct(energy)
        return np.column_stack([g / size, np.max(error / size, axis=1)])

    table = ShellTable(evaluate, shell)

    def integrals(energy: Array) -> tuple[Array, Array]:
        values = table(energy)
        return values[:, :-1] * size, values[:, -1:] * size

    return integrals
