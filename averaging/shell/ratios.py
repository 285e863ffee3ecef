"""Density of states and phase volume of a system with contacts, relative to the one without.

Without contact ``T ~ H^(n−1)`` and the phase volume is ``T H / n``. Contact multiplies both by
ratios between 0 and 1, exactly 1 below the energy where contact begins.
"""

from math import gamma, lgamma, pi
from typing import NamedTuple

import numpy as np
from scipy.special import beta

from averaging.shell.energy_shell import EnergyShell
from averaging.shell.laplace import PartitionLines, by_lines
from averaging.shell.sums import shell_integrals
from averaging.shell.table import ShellTable
from fpk.arrays import Array
from fpk.system import System

ROUNDED = 0.5 * float(np.finfo(float).eps)
"""For n = 1 the part beyond a stop is ~ √(H − V), V at the stop: a rounding of H is relative to T
ε √(H/(H − V)), of either sign, half of it to be expected."""


class ShellRatios(NamedTuple):
    """Ratios of the energy shell at some energies; each array has the energies' shape.

    ``states`` = T(H)/T_lin(H) with T the density of states ∫δ(H − H(q,p)) dq dp (twice the T of
    (10), which integrates over ∂H/∂p_1 > 0 only; for n = 1 it is the period), ``volume`` the same
    of the phase volume Φ = ∫T dH, ``log_slope`` = H T'/T. ``error`` is the relative error of the
    first two.
    """

    states: Array
    volume: Array
    log_slope: Array
    error: Array


def log_linear_states(system: System, energy: Array | float) -> Array:
    """Return ln T_lin(H) of the chain without contacts, (2π)^n √(Π m / det K) H^(n−1)/Γ(n)."""
    n = system.n
    # det K of a chain that is fixed at one end is the product of its springs.
    prefactor = n * np.log(2.0 * pi) + 0.5 * np.sum(np.log(system.mass / system.stiffness))
    return np.asarray(prefactor - lgamma(n) + (n - 1) * np.log(energy))


def shell_ratios(system: System, energy: Array) -> ShellRatios:
    """Return the ratios at energies > 0 (energies,), Eqs. (10), (25), (28) for any contacts.

    The (2n−1)-fold integrals of (10) are reduced to the c contact masses: momenta and the other
    displacements are integrated out exactly, which leaves ∫(H − V_red)^(n − c/2 − 1) dq_c. For one
    contact mass it is integrated afresh, for two it is interpolated, for more it follows from the
    partition function of the chain.
    """
    shell = system.fact(EnergyShell)
    rows = np.ones((4, energy.size))
    rows[2], rows[3] = system.n - 1.0, 0.0
    first = shell.contact_energies[0] if shell.contact_energies else np.inf
    touching = (energy > first).nonzero()[0]
    if touching.size:
        above = energy[touching]
        if shell.count == 1:
            rows[:, touching] = _integrated(shell, above)
        elif by_lines(shell):
            rows[:, touching] = system.fact(PartitionLines)(above, _alone)
        else:
            rows[:, touching] = system.fact(_table)(above).T
    return ShellRatios(*rows)


def _alone(system: System, energy: Array) -> Array:
    return np.array(shell_ratios(system, energy))


def _table(system: System) -> ShellTable:
    shell = system.fact(EnergyShell)

    def evaluate(energy: Array) -> Array:
        return _integrated(shell, energy).T

    return ShellTable(evaluate, shell)


def _integrated(shell: EnergyShell, energy: Array) -> Array:
    """The rows of ``ShellRatios`` above the first contact energy, by quadrature."""
    n, c = shell.system.n, shell.count
    # H T' may vanish where T does not: its error is relative to T there.
    last = np.array([0.0, 0.0, 1.0])
    both = shell_integrals(shell, energy, lambda x: np.maximum(np.abs(x), x[:, :1] * last))
    sums, errors = (x.T for x in both)
    a = n - 0.5 * c - 1.0
    flat = (2.0 * pi) ** (0.5 * c) * float(beta(a + 1.0, 0.5 * c)) / gamma(0.5 * c)
    error = np.maximum(errors[0], errors[1])
    if n == 1:
        rises = energy[:, None] - shell.potential(shell.stops.clearance[:, None] / shell.stops.rows)
        least = np.where(rises > 0.0, rises, np.inf).min(axis=1)
        error = error + ROUNDED * np.sqrt(energy / least)
    states, volume = sums[0] / flat, sums[1] / (flat * (a + 1.0) / n)
    return np.array([states, volume, sums[2] / sums[0], error])
