"""Microcanonical average of the power that state-dependent damping takes out, Eq. (10)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import lgamma

import numpy as np
from numpy.typing import NDArray

from averaging.shell.monomials import PowerPolynomial, power_polynomials
from averaging.shell.radial import shell_ray_moments
from averaging.shell.ratios import COARSE, energy_shell
from averaging.shell.reduced import ReducedPotential
from averaging.shell.sums import TARGET, refined_sums
from averaging.shell.table import Resolution, ShellTable
from fpk.equivalent import dissipated_power
from fpk.system import System

Array = NDArray[np.float64]

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
    integrals: Callable[[Array], tuple[Array, Array]]

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
    two rules agree. V and the polynomial look the same at −y where ``ReducedPotential.mirror``
    holds, as terms of odd degree end it.
    """
    return system.fact(_term_power)


def _term_power(system: System) -> TermPower:
    shell = energy_shell(system)
    potential = shell.potential
    polynomials = power_polynomials(system, potential)
    n = system.n
    gibbs = dissipated_power(system)
    free = np.zeros(len(polynomials))
    for k, polynomial in enumerate(polynomials):
        s = 1 + polynomial.degree // 2
        # On a shell H is H: its powers in the Gibbs state of temperature 1 are taken out.
        if polynomial.degree % 2 == 0 and s < gibbs.size:
            free[k] = gibbs[s] * np.exp(lgamma(n) - lgamma(n + s))
    size = np.array([polynomial.free_size(n) for polynomial in polynomials])
    direct = partial(_averages, potential, polynomials)
    integrals: Callable[[Array], tuple[Array, Array]] = direct
    if potential.count > 1 and polynomials:
        resolution = Resolution() if potential.count == 2 else COARSE
        integrals = _tabulated(direct, size, shell.contact_energies, resolution)
    begins = min(shell.contact_energies, default=np.inf)
    degrees = np.array([float(polynomial.degree) for polynomial in polynomials])
    return TermPower(degrees, free, size, begins, integrals)


def _averages(
    potential: ReducedPotential, polynomials: Sequence[PowerPolynomial], energy: Array
) -> tuple[Array, Array]:
    """g_d and their errors (energies, degrees), by quadrature."""
    orders = sorted({(0, 0)}.union(*(polynomial.orders for polynomial in polynomials)))
    column = {order: k for k, order in enumerate(orders)}

    def rays(energy: Array, directions: Array, *, rules: Sequence[int]) -> Array:
        moments = shell_ray_moments(potential, energy, directions, orders, rules=rules)
        parts = [moments[..., column[0, 0]]]
        for polynomial in polynomials:
            radial = moments[..., [column[o] for o in polynomial.orders]] * polynomial.coefficient
            power = np.sum(radial * _monomials(directions, polynomial.alpha), axis=-1)
            most = np.sum(np.abs(radial) * _majorants(directions, polynomial.alpha), axis=-1)
            # Positive, so that no error is relative to nothing.
            parts += [power + 2.0 * most, most]
        return np.stack(parts, axis=-1)

    target = TARGETS[min(potential.n, 2) - 1] if potential.count == 1 else TARGET
    sums, error = refined_sums(potential, energy, rays, np.abs, target=target)
    states, shifted, most = sums[:, :1], sums[:, 1::2], sums[:, 2::2]
    # The errors of shifted (at most 3 of most), of 2 most and of states (g is at most most).
    return (shifted - 2.0 * most) / states, 6.0 * error[:, None] * most / states


def _monomials(directions: Array, alpha: NDArray[np.int64]) -> Array:
    """Π e_k^alpha_k of every part, (rays, parts)."""
    return np.asarray(np.prod(directions[:, None, :] ** alpha, axis=2))


def _majorants(directions: Array, alpha: NDArray[np.int64]) -> Array:
    """Smooth bounds of |Π e_k^alpha_k|, by |e| <= ½ (1 + e²): a kink would spoil the rules."""
    odd = alpha % 2
    square = 0.5 * (1.0 + directions[:, None, :] ** 2)
    return np.asarray(np.prod(directions[:, None, :] ** (alpha - odd) * square**odd, axis=2))


def _tabulated(
    direct: Callable[[Array], tuple[Array, Array]],
    size: Array,
    breaks: tuple[float, ...],
    resolution: Resolution,
) -> Callable[[Array], tuple[Array, Array]]:
    """Piecewise polynomials of g_d/size, for two or more contact masses."""

    def evaluate(energy: Array) -> Array:
        g, error = direct(energy)
        return np.column_stack([g / size, np.max(error / size, axis=1)])

    table = ShellTable(evaluate, breaks, resolution)

    def integrals(energy: Array) -> tuple[Array, Array]:
        values = table(energy)
        return values[:, :-1] * size, values[:, -1:] * size

    return integrals
