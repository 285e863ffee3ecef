"""Averaged energy process of a quasi-non-integrable Hamiltonian system, Eqs. (9), (24)."""

from collections import defaultdict
from typing import Any

import numpy as np

from averaging.shell.averages import shell_averages
from averaging.shell.energy_shell import EnergyShell
from fpk.numeric.arrays import EPS, Array
from fpk.numeric.errors import NotApplicable
from fpk.system.equivalent import equivalent_temperature
from fpk.system.process import Coefficients, Process
from fpk.system.system import System


def damping_and_noise(system: System) -> tuple[float, float]:
    """Return Σ c_ii/m_i of constant damping, 1/time, and Σ (f D fᵀ)_ii/m_i, energy/time."""
    damping, noise = system.damping.diagonal(), system.noise_matrix.diagonal()
    return float(damping @ (1.0 / system.mass)), float(noise @ (1.0 / system.mass))


def damping_by_energy(system: System) -> Array | None:
    """Return the symmetric part of the damping matrix, coefficients (n, n) of H^0, H^1, …

    None where it depends on q or v, too; c_ij(q) = −c_ji(q) does no work, and is left out.
    """
    parts: dict[Any, Array] = defaultdict(lambda: np.zeros((system.n, system.n)))
    parts[(), (), 0] += system.damping
    for t in system.damping_terms:
        parts[t.q, t.v, t.energy][t.row, t.column] += t.coefficient
    if any(v or (q and np.any(c + c.T)) for (q, v, _), c in parts.items()):
        return None
    matrices = np.zeros((1 + max(power for _, _, power in parts), system.n, system.n))
    for (q, _, power), c in parts.items():
        if not q:
            matrices[power] = 0.5 * (c + c.T)
    return matrices


def energy_process(system: System) -> Process:
    """Return the averaged energy process dH = s dt + σ dB of ``system``, Eqs. (9), (10), (24)-(28).

    With the microcanonical temperature τ(H) = Φ/T, Φ the phase volume and T = Φ' the density of
    states, the averages of (10) are ⟨v_i v_j⟩ = δ_ij τ/m_i, so that
    ``s = −Σ(c_ii/m_i) τ + Σ D_ii/m_i`` and ``σ² = 2 Σ(D_ii/m_i) τ`` for any number of masses.
    Damping that depends on the state adds −⟨c_ij(q, v) v_i v_j⟩ to s.
    Corrections: (10) prints D f f for the noise terms without ∂²H/∂p_i∂p_j and v_i v_j; (28)
    prints the damping term of s with a plus sign; (25)-(29) hold for unit masses only.

    Drift and diffusion at two energies::

        averaged = energy_process(system).coefficients(np.array([0.1, 0.5]))
        averaged.drift, averaged.diffusion

    Raises ``NotApplicable`` where noise or damping vanishes, or damping terms do not outweigh the
    noise at high energy: there is no stationary density then.
    """
    (damping, noise), n = damping_and_noise(system), system.n
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if damping <= 0 and not system.damping_terms:
        raise NotApplicable("nothing is damped, so the energy grows for ever")
    # An energy of the order of the mean: n times the temperature, or where damping takes over.
    terms = system.damping_terms
    scale = n * (equivalent_temperature(system) if terms else noise / damping)

    def coefficients(energy: Array) -> Coefficients:
        shell = shell_averages(system, energy)
        tau = energy / n * shell.volume / shell.states
        dissipation, error = -damping * tau, shell.error
        if system.damping_terms:
            # The constant part is exact relative to τ, whose error is counted already; the error is
            # relative to the parts of s, which is less where the terms cancel the constant part.
            constant = np.abs(dissipation) * (error + EPS)
            dissipation = dissipation - shell.power
            error = error + (shell.power_error + constant) / (np.abs(dissipation) + noise)
        return Coefficients(
            drift=noise + dissipation,
            diffusion=2.0 * noise * tau,
            divergence=2.0 * noise * (1.0 - tau * shell.log_slope / energy),
            dissipation=dissipation,
            log_density_of_states=np.log(shell.states) + (n - 1) * (np.log(energy) - np.log(scale)),
            relative_error=error,
        )

    return Process(
        coefficients=coefficients,
        energy_scales=(scale,),
        nonsmooth=system.fact(EnergyShell).contact_energies,
        degrees_of_freedom=n,
        state_damping=bool(system.damping_terms),
    )
