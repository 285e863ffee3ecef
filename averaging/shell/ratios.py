"""Density of states and phase volume of a system with contacts, relative to the one without.

Without contact ``T ~ H^(n−1)`` and the phase volume is ``T H / n``. Contact multiplies both by
ratios between 0 and 1 that depend on H only; they are all that quadrature is needed for, they are
well scaled for any number of masses, and they are exactly 1 below the energy where contact begins.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from averaging.shell.contact_energies import contact_energies
from averaging.shell.radial import shell_ray_integrals
from averaging.shell.reduced import ReducedPotential, reduced_potential
from averaging.shell.sums import refined_sums
from averaging.shell.table import Resolution, ShellTable
from fpk.system import System

Array = NDArray[np.float64]

COARSE = Resolution(points=8, layers=1, target=1e-5, deepest=2)
"""Resolution of the table then: what lies below the tolerance is not worth its minutes."""


@dataclass(frozen=True, eq=False)
class EnergyShell:
    """Shells of constant energy of one system: its reduced potential and contact energies.

    ``integrals`` gives the three ratios and their relative error (energies, 4) at energies above
    the first contact energy.
    """

    potential: ReducedPotential
    contact_energies: tuple[float, ...]
    integrals: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class ShellRatios:
    """Ratios of the energy shell at some energies; each array has the energies' shape.

    ``states`` = T(H)/T_lin(H) with T the density of states ∫δ(H − H(q,p)) dq dp (twice the T of
    (10), which integrates over ∂H/∂p_1 > 0 only; for n = 1 it is the period), ``volume`` the same
    of the phase volume Φ = ∫T dH, ``log_slope`` = H T'/T, ``error`` the relative error of each.
    """

    states: Array
    volume: Array
    log_slope: Array
    error: Array


@lru_cache(maxsize=16)
def energy_shell(system: System) -> EnergyShell:
    """Return the shells of ``system``, the same ones each time: they remember what they integrated.

    One contact mass is cheap and evaluated afresh; more are kept as piecewise polynomials.
    """
    potential = reduced_potential(system)
    energies = contact_energies(potential)
    direct = partial(_integrated_ratios, potential)
    if potential.count < 2:
        return EnergyShell(potential, energies, direct)
    if potential.count == 2:
        return EnergyShell(potential, energies, ShellTable(direct, energies, Resolution()))
    single = contact_energies(potential, at_once=1)
    return EnergyShell(potential, single, ShellTable(direct, single, COARSE))


def log_linear_states(system: System, energy: Array) -> Array:
    """Return ln T_lin(H) of the chain without contacts, (2π)^n √(Π m / det K) H^(n−1)/Γ(n)."""
    n = system.n
    # det K of a chain that is fixed at one end is the product of its springs.
    prefactor = n * np.log(2.0 * pi) + 0.5 * np.sum(np.log(system.mass / system.stiffness))
    return np.asarray(prefactor - gammaln(n) + (n - 1) * np.log(energy))


def shell_ratios(shell: EnergyShell, energy: Array) -> ShellRatios:
    """Return the ratios at energies > 0, Eqs. (10), (25), (28) for any n and any contacts.

    The (2n−1)-fold integrals of (10) are reduced to the contact masses: momenta and the other
    displacements are integrated out exactly, which leaves ∫(H − V_red)^(n − c/2 − 1) dq_c.
    """
    n = shell.potential.n
    ones = np.ones_like(energy)
    result = ShellRatios(ones.copy(), ones.copy(), (n - 1.0) * ones, np.zeros_like(energy))
    touching = np.flatnonzero(energy > min(shell.contact_energies, default=np.inf))
    if touching.size:
        found = shell.integrals(energy[touching])
        result.states[touching] = found[:, 0]
        result.volume[touching] = found[:, 1]
        result.log_slope[touching] = found[:, 2]
        result.error[touching] = found[:, 3]
    return result


def _integrated_ratios(potential: ReducedPotential, energy: Array) -> Array:
    """Columns states, volume, log_slope and their relative error, by quadrature."""
    n, c = potential.n, potential.count
    sums, error = refined_sums(potential, energy, partial(shell_ray_integrals, potential), np.abs)
    a = n - 0.5 * c - 1.0
    flat = (2.0 * pi) ** (0.5 * c) * float(np.exp(gammaln(a + 1.0) - gammaln(n)))
    states, volume = sums[:, 0] / flat, sums[:, 1] / (flat * (a + 1.0) / n)
    return np.column_stack([states, volume, sums[:, 2] / sums[:, 0], error])
