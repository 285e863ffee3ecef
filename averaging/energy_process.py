"""Averaged energy process of a quasi-non-integrable Hamiltonian system, Eqs. (9), (24)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from averaging.shell.moments import TermPower, term_power
from averaging.shell.ratios import EnergyShell, energy_shell, shell_ratios
from fpk.compiling import cached_njit
from fpk.equivalent import dissipated_power, equivalent_temperature
from fpk.errors import NotApplicable
from fpk.process import Coefficients, Process
from fpk.system import System

Array = NDArray[np.float64]

SEARCHED = 4.0 ** np.arange(25)
"""Energies, in units of the one where |damping| would balance the noise, searched for balance."""
MOST_CONTACT_MASSES = 4
"""Contact masses over which shells are integrated: the cubature takes 21 points along each of one
angle less, and rules of fewer points miss where the integrand is without their estimate saying so
(one did, by half of the norm of three contact masses)."""
MOST_SEARCHED = 2
"""Contact masses up to which they are: with more, each energy costs half a second."""


@dataclass(frozen=True)
class EnergyBalance:
    """What averaging keeps of damping and noise: two sums over the masses.

    ``damping`` Σ c_ii/m_i (1/time), of the constant matrix, and ``noise`` Σ (f D fᵀ)_ii/m_i
    (energy/time). Off-diagonal entries drop out of the average ⟨v_i v_j⟩ = δ_ij τ/m_i.
    ``energy_scale`` is an energy of the order of the mean.
    """

    damping: float
    noise: float
    energy_scale: float

    @property
    def inverse_temperature(self) -> float:
        """α of the general form of (29), p(H) = C T(H) exp(−α H), in 1/energy."""
        return self.damping / self.noise


def energy_balance(system: System) -> EnergyBalance:
    """Return Σ c_ii/m_i, Σ (f D fᵀ)_ii/m_i and the scale of the energy where all damping balances.

    Raises ``NotApplicable`` where noise or damping vanishes, or damping terms do not outweigh the
    noise at high energy: there is no stationary density then; and for more contact masses than
    ``MOST_CONTACT_MASSES``.
    """
    return system.fact(_energy_balance)


def _energy_balance(system: System) -> EnergyBalance:
    damping = float(np.sum(np.diag(system.damping) / system.mass))
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    if len(system.contact_masses) > MOST_CONTACT_MASSES:
        raise NotApplicable(
            f"{len(system.contact_masses)} contact masses: energy shells are integrated over"
            f" {MOST_CONTACT_MASSES} at the most; use montecarlo"
        )
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if not system.damping_terms:
        if damping <= 0:
            raise NotApplicable("nothing is damped, so the energy grows for ever")
        return EnergyBalance(damping, noise, system.n / (damping / noise))
    if not 0 < len(system.contact_masses) <= MOST_SEARCHED:
        return EnergyBalance(damping, noise, system.n * equivalent_temperature(system))
    return EnergyBalance(damping, noise, _last_balance(system, damping, noise))


def energy_process(system: System) -> Process:
    """Return the averaged energy process dH = s dt + σ dB of ``system``, Eqs. (9), (10), (24)-(28).

    With the microcanonical temperature τ(H) = Φ/T, Φ the phase volume and T = Φ' the density of
    states, the averages of (10) are ⟨v_i v_j⟩ = δ_ij τ/m_i, so that
    ``s = −Σ(c_ii/m_i) τ + Σ D_ii/m_i`` and ``σ² = 2 Σ(D_ii/m_i) τ`` for any number of masses.
    Damping that depends on the state adds −⟨c_ij(q, v) v_i v_j⟩ to s, by ``term_power``.
    Corrections: (10) prints D f f for the noise terms without ∂²H/∂p_i∂p_j and v_i v_j; (28)
    prints the damping term of s with a plus sign; (25)-(29) hold for unit masses only.

    Raises ``NotApplicable`` for a system without noise, or whose damping does not balance it.
    """
    balance = energy_balance(system)
    shell = energy_shell(system)
    scale = balance.energy_scale
    terms = term_power(system) if system.damping_terms else None

    def coefficients(energy: Array) -> Coefficients:
        c = _coefficients(shell, balance, scale, energy)
        return c if terms is None else _with_terms(c, terms, balance, energy)

    return Process(
        coefficients=coefficients,
        energy_scales=(scale,),
        nonsmooth=shell.contact_energies,
        degrees_of_freedom=system.n,
        state_damping=terms is not None,
    )


def _coefficients(
    shell: EnergyShell, balance: EnergyBalance, scale: float, energy: Array
) -> Coefficients:
    ratios = shell.ratios(energy)
    n = shell.potential.n
    return Coefficients(*_averaged(ratios, energy, n, balance.damping, balance.noise, scale))


@cached_njit()
def _averaged(
    ratios: Array, energy: Array, n: int, damping: float, noise: float, scale: float
) -> Array:
    """Rows of ``Coefficients`` from the rows of ``ShellRatios``, at energies (energies,)."""
    found = np.empty((7, energy.size))
    for i in range(energy.size):
        states, volume, log_slope = ratios[0, i], ratios[1, i], ratios[2, i]
        tau = energy[i] / n * volume / states
        found[0, i] = noise - damping * tau
        found[1, i] = 2.0 * noise * tau
        found[2, i] = 2.0 * noise * (1.0 - tau * log_slope / energy[i])
        found[3, i] = -damping * tau
        found[4, i] = np.log(states) + (n - 1) * np.log(energy[i] / scale)
        found[5, i], found[6, i] = ratios[3, i], ratios[4, i]
    return found


def _with_terms(
    c: Coefficients, terms: TermPower, balance: EnergyBalance, energy: Array
) -> Coefficients:
    """Coefficients with the power of the damping terms, and their error among the others."""
    power, error = terms(energy)
    # The constant part is exact relative to τ, whose error is in c already; the error is relative
    # to the sizes of the parts of s, which is less where the terms cancel the constant part.
    dissipation = c.dissipation - power
    constant = np.abs(c.dissipation) * (c.relative_error + np.finfo(float).eps)
    size = np.abs(dissipation) + balance.noise
    return c._replace(
        drift=dissipation + balance.noise,
        dissipation=dissipation,
        relative_error=c.relative_error + (error + constant) / size,
    )


def _last_balance(system: System, damping: float, noise: float) -> float:
    """The highest energy at which damping and noise balance, contacts and all, about."""
    shell, terms = energy_shell(system), term_power(system)
    sizes = np.abs(dissipated_power(system))
    sizes[1] = abs(damping)
    roots = np.roots([*sizes[:0:-1], -noise])
    positive = [z.real for z in roots if abs(z.imag) < 1e-9 * abs(z) and z.real > 0]
    if not positive:
        raise NotApplicable("nothing is damped on average, so the energy grows for ever")
    energy = system.n * max(positive) * SEARCHED
    ratios = shell_ratios(shell, energy)
    tau = energy / system.n * ratios.volume / ratios.states
    excess = damping * tau + terms(energy)[0] - noise
    if excess[-1] <= 0:
        raise NotApplicable("the damping does not balance the noise, so the energy grows for ever")
    below = np.flatnonzero(excess <= 0)
    if not below.size:
        return float(energy[0])
    k = below[-1]
    share = excess[k] / (excess[k] - excess[k + 1])
    return float(energy[k] * (energy[k + 1] / energy[k]) ** share)
