"""Averaged energy process of a quasi-non-integrable Hamiltonian system, Eqs. (9), (24)."""

import numpy as np

from averaging.shell.energy_shell import EnergyShell
from averaging.shell.power import term_power
from averaging.shell.ratios import shell_ratios
from fpk.arrays import Array
from fpk.equivalent import dissipated_power, equivalent_temperature
from fpk.errors import NotApplicable
from fpk.process import Coefficients, Process
from fpk.system import System

SEARCHED = 4.0 ** np.arange(25)
"""Energies, in units of the one where |damping| would balance the noise, searched for balance."""
MOST_SEARCHED = 2
"""Contact masses up to which the balance is searched on the shells; of more, each energy takes
seconds, for a line of the partition function of its own."""


def damping_and_noise(system: System) -> tuple[float, float]:
    """Return Σ c_ii/m_i of the constant damping (1/time) and Σ (f D fᵀ)_ii/m_i (energy/time).

    Off-diagonal entries drop out of the average ⟨v_i v_j⟩ = δ_ij τ/m_i.
    """
    mobility = 1.0 / system.mass
    damping = system.damping.diagonal() @ mobility
    return float(damping), float(system.noise_matrix.diagonal() @ mobility)


def energy_process(system: System) -> Process:
    """Return the averaged energy process dH = s dt + σ dB of ``system``, Eqs. (9), (10), (24)-(28).

    With the microcanonical temperature τ(H) = Φ/T, Φ the phase volume and T = Φ' the density of
    states, the averages of (10) are ⟨v_i v_j⟩ = δ_ij τ/m_i, so that
    ``s = −Σ(c_ii/m_i) τ + Σ D_ii/m_i`` and ``σ² = 2 Σ(D_ii/m_i) τ`` for any number of masses.
    Damping that depends on the state adds −⟨c_ij(q, v) v_i v_j⟩ to s, by ``term_power``.
    Corrections: (10) prints D f f for the noise terms without ∂²H/∂p_i∂p_j and v_i v_j; (28)
    prints the damping term of s with a plus sign; (25)-(29) hold for unit masses only.

    Raises ``NotApplicable`` where noise or damping vanishes, or damping terms do not outweigh the
    noise at high energy: there is no stationary density then.
    """
    damping, noise = damping_and_noise(system)
    scale, n = _energy_scale(system, damping, noise), system.n

    def coefficients(energy: Array) -> Coefficients:
        ratios = shell_ratios(system, energy)
        tau = energy / n * ratios.volume / ratios.states
        dissipation, error = -damping * tau, ratios.error
        if system.damping_terms:
            power, power_error = system.fact(term_power)(energy)
            # The constant part is exact relative to τ, whose error is counted already; the error is
            # relative to the parts of s, which is less where the terms cancel the constant part.
            constant = np.abs(dissipation) * (error + np.finfo(float).eps)
            dissipation = dissipation - power
            error = error + (power_error + constant) / (np.abs(dissipation) + noise)
        return Coefficients(
            drift=noise + dissipation,
            diffusion=2.0 * noise * tau,
            divergence=2.0 * noise * (1.0 - tau * ratios.log_slope / energy),
            dissipation=dissipation,
            log_density_of_states=np.log(ratios.states) + (n - 1) * np.log(energy / scale),
            relative_error=error,
        )

    return Process(
        coefficients=coefficients,
        energy_scales=(scale,),
        nonsmooth=system.fact(EnergyShell).contact_energies,
        degrees_of_freedom=n,
        state_damping=bool(system.damping_terms),
    )


def _energy_scale(system: System, damping: float, noise: float) -> float:
    """An energy of the order of the mean: n times the temperature, or where damping takes over."""
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if not system.damping_terms:
        if damping <= 0:
            raise NotApplicable("nothing is damped, so the energy grows for ever")
        return system.n * noise / damping
    if not 0 < len(system.contact_masses) <= MOST_SEARCHED:
        return system.n * equivalent_temperature(system)
    return _last_balance(system, damping, noise)


def _last_balance(system: System, damping: float, noise: float) -> float:
    """About the highest energy at which damping and noise balance, with contacts."""
    sizes = np.abs(dissipated_power(system))
    sizes[1] = abs(damping)
    roots = np.roots([*sizes[:0:-1], -noise])
    positive = [z.real for z in roots if abs(z.imag) < 1e-9 * abs(z) and z.real > 0]
    if not positive:
        raise NotApplicable("nothing is damped on average, so the energy grows for ever")
    energy = system.n * max(positive) * SEARCHED
    ratios = shell_ratios(system, energy)
    tau = energy / system.n * ratios.volume / ratios.states
    excess = damping * tau + system.fact(term_power)(energy)[0] - noise
    if excess[-1] <= 0:
        raise NotApplicable("the damping does not balance the noise, so the energy grows for ever")
    below = np.flatnonzero(excess <= 0)
    if not below.size:
        return float(energy[0])
    k = below[-1]
    share = excess[k] / (excess[k] - excess[k + 1])
    return float(energy[k] * (energy[k + 1] / energy[k]) ** share)
