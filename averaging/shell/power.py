"""Microcanonical average of the power that state-dependent damping takes out, Eq. (10)."""

from collections.abc import Callable

import numpy as np
from scipy.special import gammaln

from averaging.shell.energy_shell import EnergyShell
from averaging.shell.laplace import PartitionLines, by_lines
from averaging.shell.parts import ROUND_OFF, Parts, parts_of
from averaging.shell.ratios import shell_ratios
from averaging.shell.sums import TARGET, shell_integrals
from averaging.shell.table import ShellTable
from fpk.arrays import Array
from fpk.system import System

Power = Callable[[Array], tuple[Array, Array]]

TARGETS = (8e-13, 3e-14)
"""Disagreement of two rules, for n = 1 and more, that ends the refinement for one contact mass,
near round-off: the power cancels against the noise, so that its error adds up in ln p."""


def term_power(system: System) -> Power:
    """Return ⟨Σ c_ij v_i v_j⟩_H of the damping terms alone, Eq. (10) for c_ij(q, v).

    What is returned takes energies > 0 (energies,) to the power and its error, in energy/time.
    Momenta and displacements without contact are averaged in closed form. What is left are
    integrals of polynomials over the contact masses: along rays and over directions, or by the
    partition function of the chain, as in ``shell_ratios``.
    """
    # The power is Σ_d g_d(H) H^(1 + d/2) over the degrees d; without contact g_d is constant.
    shell = system.fact(EnergyShell)
    parts = system.fact(parts_of)
    degrees, row = np.unique(parts.degree, return_inverse=True)
    log_rest = gammaln(system.n) - gammaln(system.n + 0.5 * parts.order)
    free, size = (
        np.bincount(row, x * np.exp(log_rest), degrees.size) for x in parts.gaussian(shell)
    )
    # What cancels between two terms is their round-off.
    free[np.abs(free) <= ROUND_OFF * size] = 0.0
    begins = min(shell.contact_energies, default=np.inf)

    def relative(energy: Array) -> Array:
        g, error = _averages(shell, parts, energy)
        return np.column_stack([g / size, np.max(error / size, axis=1)])

    table = ShellTable(relative, shell) if shell.count == 2 else relative

    def power(energy: Array) -> tuple[Array, Array]:
        powers = energy[:, None] ** (1.0 + 0.5 * degrees)
        value: Array = powers @ free
        error: Array = powers @ (ROUND_OFF * size)
        touching = np.flatnonzero(energy > begins)
        if not touching.size or not degrees.size:
            return value, error
        if by_lines(shell):
            value[touching], own = _by_lines(system, energy[touching])
        else:
            values, sizes = table(energy[touching]), powers[touching] * size
            value[touching] = np.sum(values[:, :-1] * sizes, axis=1)
            own = values[:, -1] * np.sum(sizes, axis=1)
        error[touching] += own
        return value, error

    return power


def _by_lines(system: System, energy: Array) -> tuple[Array, Array]:
    """The power and its error by the partition function."""
    ratios = shell_ratios(system, energy)
    total, error = system.fact(PartitionLines).power(energy, _times_states)
    power = total / ratios.states
    return power, error / ratios.states + np.abs(power) * ratios.error


def _times_states(system: System, energy: Array) -> Array:
    """The power times T/T_lin, and its error, (2, energies)."""
    ratios = shell_ratios(system, energy)
    power, error = system.fact(term_power)(energy)
    return np.stack([power, error + np.abs(power) * ratios.error]) * ratios.states


def _averages(shell: EnergyShell, parts: Parts, energy: Array) -> tuple[Array, Array]:
    """g_d and their errors (energies, degrees), by quadrature along rays.

    Given y the N = 2n − c numbers (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a
    moment of degree 2j is (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times that of Gaussian ones.
    """
    both = np.stack([parts.powers.sum(axis=1), parts.j], axis=1)
    orders, column = np.unique(both, axis=0, return_inverse=True)
    of_degree = (parts.degree[:, None] == np.unique(parts.degree)).astype(float)
    half_n = shell.system.n - 0.5 * shell.count
    rest = np.exp(gammaln(half_n) - gammaln(half_n + parts.j))
    largest = np.linalg.norm(shell.L, axis=1)
    odd = parts.powers % 2

    def combine(directions: Array, integrals: Array) -> Array:
        radial = integrals[..., 3 + column.ravel()] * rest
        q = (directions @ shell.L.T)[:, None, :]
        # A smooth bound of |q| by its largest value f: |q| <= ½ (f + q²/f). A kink would spoil the
        # rules.
        bound = 0.5 * (largest + q * q / largest)
        power = (parts.coefficient * radial * np.prod(q**parts.powers, axis=2)) @ of_degree
        most = parts.size * radial * np.prod(q ** (parts.powers - odd) * bound**odd, axis=2)
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
