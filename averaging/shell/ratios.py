"""Density of states and phase volume of a system with contacts, relative to the one without.

Without contact ``T ~ H^(n−1)`` and the phase volume is ``T H / n``. Contact multiplies both by
ratios between 0 and 1 that depend on H only; they are all that quadrature is needed for, they are
well scaled for any number of masses, and they are exactly 1 below the energy where contact begins.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from averaging.shell.contact_energies import contact_energies
from averaging.shell.one_mass.ratios import OneMassShell
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

    ``ratios`` gives the rows of ``ShellRatios``, (5, energies).
    """

    potential: ReducedPotential
    contact_energies: tuple[float, ...]
    ratios: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class ShellRatios:
    """Ratios of the energy shell at some energies; each array has the energies' shape.

    ``states`` = T(H)/T_lin(H) with T the density of states ∫δ(H − H(q,p)) dq dp (twice the T of
    (10), which integrates over ∂H/∂p_1 > 0 only; for n = 1 it is the period), ``volume`` the same
    of the phase volume Φ = ∫T dH, ``log_slope`` = H T'/T. ``error`` is the relative error of the
    first two, ``slope_error`` that of the third, relative to 1 at least.
    """

    states: Array
    volume: Array
    log_slope: Array
    error: Array
    slope_error: Array


def energy_shell(system: System) -> EnergyShell:
    """Return the shells of ``system``, held by the system: they remember what they integrated.

    One contact mass is cheap and evaluated afresh; more are kept as piecewise polynomials.
    """
    return system.fact(_energy_shell)


def _energy_shell(system: System) -> EnergyShell:
    potential = reduced_potential(system)
    energies = contact_energies(potential)
    if not potential.count:
        return EnergyShell(potential, energies, partial(_untouched, potential))
    if potential.count == 1:
        return EnergyShell(potential, energies, OneMassShell(potential))
    resolution = Resolution()
    if potential.count > 2:
        energies, resolution = contact_energies(potential, at_once=1), COARSE
    table = ShellTable(partial(integrated_ratios, potential), energies, resolution)
    return EnergyShell(potential, energies, partial(_beyond_contact, potential, energies[0], table))


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
    return ShellRatios(*shell.ratios(energy))


def _untouched(potential: ReducedPotential, energy: Array) -> Array:
    """The ratios where nothing is touched: exact."""
    found = np.ones((5, energy.size))
    found[2], found[3:] = potential.n - 1.0, 0.0
    return found


def _beyond_contact(
    potential: ReducedPotential, first: float, table: ShellTable, energy: Array
) -> Array:
    """The ratios, from ``table`` where the energy exceeds the first contact energy."""
    found = _untouched(potential, energy)
    touching = np.flatnonzero(energy > first)
    if touching.size:
        found[:4, touching] = table(energy[touching]).T
        found[4] = found[3]
    return found


def integrated_ratios(potential: ReducedPotential, energy: Array) -> Array:
    """Return columns states, volume, log_slope and their relative error, by quadrature.

    For energies above the first contact energy and any number of contact masses.
    """
    n, c = potential.n, potential.count
    sums, error = refined_sums(potential, energy, partial(shell_ray_integrals, potential), np.abs)
    a = n - 0.5 * c - 1.0
    flat = (2.0 * pi) ** (0.5 * c) * float(np.exp(gammaln(a + 1.0) - gammaln(n)))
    states, volume = sums[:, 0] / flat, sums[:, 1] / (flat * (a + 1.0) / n)
    return np.column_stack([states, volume, sums[:, 2] / sums[:, 0], error])
