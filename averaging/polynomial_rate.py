"""Closed forms for damping that depends on the energy only, u = C exp(−∫h dH), Eqs. (7), (11)."""

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from averaging.energy_density import (
    TAIL,
    EnergyDensity,
    averaged_closed_form,
    closed_form_measured,
    log_density_of,
    log_energy_norm,
)
from averaging.energy_process import damping_and_noise
from averaging.weyl import tabulated
from fpk.errors import NotApplicable
from fpk.probe import probed
from fpk.process import Process
from fpk.system import System

Array = NDArray[np.float64]


def averaged_rate(system: System) -> Array:
    """Return α(H) = Σ c_ii(H)/m_i / Σ D_ii/m_i, coefficients in ascending powers of H, Eq. (11).

    With u = p/T, zero flux in (24) is u' = −α(H) u. Raises ``NotApplicable`` where a damping term
    depends on displacements or velocities: its average is no polynomial times τ then.
    """
    terms = system.damping_terms
    if any(term.q or term.v for term in terms):
        raise NotApplicable(
            "damping that depends on q or v leaves (11) without a closed form; "
            "the solvers fem and quadrature evaluate it"
        )
    damping, noise = damping_and_noise(system)
    rate = np.zeros(1 + max((term.energy for term in terms), default=0))
    rate[0] = damping
    for term in terms:
        if term.row == term.column:
            rate[term.energy] += term.coefficient / system.mass[term.row]
    return rate / noise


def averaged_density(system: System, process: Process) -> EnergyDensity:
    """Return p(H) = C T(H) exp(−∫α dH): (29) for any n and masses and for c(H)."""
    if not system.damping_terms:
        return averaged_closed_form(system, process)
    return density_of_rate(system, process, averaged_rate(system))


def density_of_rate(system: System, process: Process, rate: Array) -> EnergyDensity:
    """Return u = C exp(−∫_0^H h dH) with h(H) = Σ rate_e H^e, normalised over the shells.

    Weyl integrals of u have no closed form for more than one power: they are tabulated, twice.
    """
    integral = polynomial.polyint(rate)

    def decay(energy: Array) -> Array:
        return np.asarray(polynomial.polyval(energy, integral))

    log_norm, error = log_energy_norm(system, process, decay)
    probe = probed(process)
    # The exponent is formed with the round-off of its largest part.
    sizes = polynomial.polyval(probe.extent(TAIL), np.abs(integral))
    error += 4.0 * np.finfo(float).eps * float(sizes)
    log_density = log_density_of(system, lambda energy: log_norm - decay(energy))
    nodes, measured = closed_form_measured(process, log_density, error=error)

    def u(energy: Array) -> Array:
        return np.asarray(np.exp(log_norm - decay(energy)))

    return tabulated(
        system,
        process,
        nodes,
        u,
        lambda energy: error * u(energy),
        measured=measured,
        closed=True,
    )
