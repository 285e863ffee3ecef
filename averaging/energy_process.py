"""Averaged energy process of a quasi-non-integrable Hamiltonian system, Eqs. (9), (24)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from averaging.shell.ratios import EnergyShell, energy_shell, shell_ratios
from fpk.errors import NotApplicable
from fpk.process import Coefficients, DiffusionProcess
from fpk.system import System

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EnergyBalance:
    """What averaging keeps of damping and noise: two sums over the masses.

    ``damping`` Σ c_ii/m_i (1/time) and ``noise`` Σ (f D fᵀ)_ii/m_i (energy/time). Off-diagonal
    entries drop out of the microcanonical average ⟨v_i v_j⟩ = δ_ij τ/m_i.
    """

    damping: float
    noise: float

    @property
    def inverse_temperature(self) -> float:
        """α of the general form of (29), p(H) = C T(H) exp(−α H), in 1/energy."""
        return self.damping / self.noise


def energy_balance(system: System) -> EnergyBalance:
    """Return Σ c_ii/m_i and Σ (f D fᵀ)_ii/m_i.

    Raises ``NotApplicable`` where one of them vanishes: there is no stationary density then.
    """
    if system.damping_terms:
        raise NotApplicable("damping that depends on the state is not averaged yet")
    damping = float(np.sum(np.diag(system.damping) / system.mass))
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if damping <= 0:
        raise NotApplicable("nothing is damped, so the energy grows for ever")
    return EnergyBalance(damping, noise)


def energy_process(system: System) -> DiffusionProcess:
    """Return the averaged energy process dH = s dt + σ dB of ``system``, Eqs. (9), (10), (24)-(28).

    With the microcanonical temperature τ(H) = Φ/T, Φ the phase volume and T = Φ' the density of
    states, the averages of (10) are ⟨v_i v_j⟩ = δ_ij τ/m_i, so that
    ``s = −Σ(c_ii/m_i) τ + Σ D_ii/m_i`` and ``σ² = 2 Σ(D_ii/m_i) τ`` for any number of masses.
    Corrections: (10) prints D f f for the noise terms without ∂²H/∂p_i∂p_j and v_i v_j; (28)
    prints the damping term of s with a plus sign; (25)-(29) hold for unit masses only.

    Raises ``NotApplicable`` for a system without noise or without damping.
    """
    balance = energy_balance(system)
    shell = energy_shell(system)
    scale = system.n / balance.inverse_temperature

    def coefficients(energy: Array) -> Coefficients:
        return _coefficients(shell, balance, scale, energy)

    return DiffusionProcess(
        coefficients=coefficients,
        energy_scale=scale,
        nonsmooth=tuple(H for H in shell.contact_energies if H > 0.0),
        degrees_of_freedom=system.n,
    )


def _coefficients(
    shell: EnergyShell, balance: EnergyBalance, scale: float, energy: Array
) -> Coefficients:
    ratios = shell_ratios(shell, energy)
    n = shell.potential.n
    tau = energy / n * ratios.volume / ratios.states
    tau_slope = 1.0 - tau * ratios.log_slope / energy
    dissipation = -balance.damping * tau
    return Coefficients(
        drift=dissipation + balance.noise,
        diffusion=2.0 * balance.noise * tau,
        diffusion_slope=2.0 * balance.noise * tau_slope,
        dissipation=dissipation,
        log_density_of_states=np.log(ratios.states) + (n - 1) * np.log(energy / scale),
        relative_error=ratios.error,
    )
