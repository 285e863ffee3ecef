"""Averages over the energy shell, relative to those without contact, Eqs. (10), (25), (28).

Without contact the density of states is ``T ~ H^(n−1)``, the phase volume ``T H / n`` and the power
of a damping term of degree d ``~ H^(1 + d/2)``. Contact multiplies the first two by ratios between
0 and 1, and lets the factor of the last depend on H; below the first contact energy it does not.
"""

from collections.abc import Callable
from math import gamma, lgamma, pi
from typing import NamedTuple

import numpy as np
from scipy.special import beta

from averaging.shell.energy_shell import EnergyShell
from averaging.shell.laplace import PartitionLines, by_lines
from averaging.shell.parts import ROUND_OFF, parts_of
from averaging.shell.sums import TARGET, shell_integrals
from averaging.shell.table import ShellTable
from fpk.arrays import EPS, Array
from fpk.system import System

ROUNDED = 4.0 * EPS
"""Bound of H − V at a stop by a few roundings of H and of V, relative to H."""
TARGETS = (8e-13, 3e-14)
"""Disagreement of two rules, for n = 1 and more, that ends the refinement of the power over one
contact mass, near round-off: the power cancels against the noise, and its error adds up in ln p."""


class ShellAverages(NamedTuple):
    """Averages over the energy shell at some energies; each array has the energies' shape.

    ``states`` = T(H)/T_lin(H) with T the density of states ∫δ(H − H(q,p)) dq dp (twice the T of
    (10), which integrates over ∂H/∂p_1 > 0 only; for n = 1 it is the period), ``volume`` the same
    of the phase volume Φ = ∫T dH, ``log_slope`` = H T'/T. ``error`` is the relative error of the
    first two. ``power`` is ⟨Σ c_ij v_i v_j⟩_H of the damping terms, energy/time, Eq. (10) for
    c_ij(q, v), and ``power_error`` its error.
    """

    states: Array
    volume: Array
    log_slope: Array
    error: Array
    power: Array
    power_error: Array


def log_linear_states(system: System, energy: Array | float) -> Array:
    """Return ln T_lin(H) of the chain without contacts, (2π)^n √(Π m / det K) H^(n−1)/Γ(n)."""
    n = system.n
    # det K of a chain that is fixed at one end is the product of its springs.
    prefactor = n * np.log(2.0 * pi) + 0.5 * np.sum(np.log(system.mass / system.stiffness))
    return np.asarray(prefactor - lgamma(n) + (n - 1) * np.log(energy))


def shell_averages(system: System, energy: Array) -> ShellAverages:
    """Return the averages at energies > 0 (energies,), for any contacts and damping terms.

    The (2n−1)-fold integrals of (10) are reduced to the c contact masses: momenta and the other
    displacements are integrated out exactly, which leaves ∫(H − V_red)^(n − c/2 − 1) dq_c, times
    polynomials for the power. For one contact mass it is integrated afresh, for two it is
    interpolated, for more it follows from the partition function of the chain.
    """
    columns = shell_columns(system, energy)
    states, volume, log_slope, error = columns[:, :4].T.copy()
    if not system.damping_terms:
        nothing = np.zeros(energy.size)
        return ShellAverages(states, volume, log_slope, error, nothing, nothing)
    powers = energy[:, None] ** (1.0 + 0.5 * system.fact(parts_of).degrees)
    power, power_error = (np.sum(powers * x, axis=1) for x in np.split(columns[:, 4:], 2, axis=1))
    return ShellAverages(states, volume, log_slope, error, power, power_error)


def shell_columns(system: System, energy: Array) -> Array:
    """Return T/T_lin, the same of the phase volume, H T'/T, the error of the first two, g, its own.

    An array (energies, 4 + 2 degrees): Σ_d g_d H^(1 + d/2) is the power of the damping terms.
    """
    shell = system.fact(EnergyShell)
    without = system.fact(_without_contact)
    columns = np.empty((energy.size, without.size))
    columns[:] = without
    first = shell.contact_energies[0] if shell.contact_energies else np.inf
    slack = ROUNDED if system.n == 1 else 0.0
    touching = (energy > first * (1.0 - slack)).nonzero()[0]
    if touching.size:
        above = energy[touching]
        if shell.count == 1:
            columns[touching] = _along_rays(system, above)
        elif by_lines(shell):
            columns[touching] = system.fact(PartitionLines)(above, shell_columns)
        else:
            columns[touching] = system.fact(_table)(above)
        if system.damping_terms:  # whose parts have their round-off whatever is integrated of them
            g_errors = slice(2 + without.size // 2, None)
            columns[touching, g_errors] += without[g_errors]
    return columns


def _without_contact(system: System) -> Array:
    ratios = np.array([1.0, 1.0, system.n - 1.0, 0.0])
    if not system.damping_terms:
        return ratios
    free, size = system.fact(parts_of).free_power(system)
    return np.concatenate([ratios, free, ROUND_OFF * size])


def _table(system: System) -> Callable[[Array], Array]:
    """The columns over two contact masses, interpolated in units of the sizes of the power."""
    size = system.fact(parts_of).free_power(system)[1]
    unit = np.concatenate([np.ones(4), *2 * [np.where(size > 0.0, size, 1.0)]])
    errors = np.r_[3, 4 + size.size : unit.size]
    table = ShellTable(
        lambda energy: _along_rays(system, energy) / unit, system.fact(EnergyShell), errors
    )
    return lambda energy: table(energy) * unit


def _along_rays(system: System, energy: Array) -> Array:
    """The columns above the first contact energy, by quadrature over one or two contact masses."""
    shell = system.fact(EnergyShell)
    n, c = system.n, shell.count
    if not system.damping_terms:
        sums, errors = shell_integrals(shell, energy)
    else:
        target = TARGETS[min(n, 2) - 1] if c == 1 else TARGET
        orders, combine = system.fact(parts_of).along_rays(shell)
        sums, errors = shell_integrals(shell, energy, orders=orders, combine=combine, target=target)
    a = n - 0.5 * c - 1.0
    flat = (2.0 * pi) ** (0.5 * c) * float(beta(a + 1.0, 0.5 * c)) / gamma(0.5 * c)
    error, states = np.maximum(errors[:, 0], errors[:, 1]), sums[:, 0]
    if n == 1:
        rises = energy[:, None] - shell.potential(shell.stops.clearance[:, None] / shell.stops.rows)
        # The part of T_lin beyond a stop is up to √(1 − V/H)/π, V at the stop.
        rises = rises / energy[:, None] + np.array([-ROUNDED, ROUNDED])[:, None, None]
        parts = np.diff(np.sqrt(np.maximum(rises, 0.0)), axis=0)[0].sum(axis=1) / pi
        error = error + parts * flat / states
    ratios = states / flat, sums[:, 1] / (flat * (a + 1.0) / n), sums[:, 2] / states, error
    if not system.damping_terms:
        return np.array(ratios).T
    # T again, refined with the power.
    shifted, most = np.split(sums[:, 4:], 2, axis=1)
    # The errors of shifted (at most 3 of most), of 2 most and of T (g is at most most).
    g_error = 6.0 * errors[:, 3:].max(axis=1)[:, None] * most / sums[:, 3:4]
    return np.column_stack([*ratios, (shifted - 2.0 * most) / sums[:, 3:4], g_error])
