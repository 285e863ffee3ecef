"""Averaged modal energies as diffusion processes, Eqs. (17), (18), (32), (33)."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis, modal_analysis
from fpk.process import Coefficients, Process
from fpk.system import System

Array = NDArray[np.float64]


def modal_process(system: System) -> Process:
    """Return the averaged modal energies dH_i = s_i dt + σ_il dB_l of ``system``, Eqs. (17), (33).

    ``s_i = (−c*_ii H_i + d_i)/M*_i``, ``b_ii = 2 d_i H_i/M*_i``, ``b_ij = 0`` for i ≠ j, with
    d_i = (Tᵀ f D fᵀ T)_ii. Corrections: (33) prints s_i without noise and mass, b_ii without H_i
    and with D₂ for D₁ in b₂₂; (18) prints P_i/M_j P_j and a noise term without masses. Contacts are
    left out. It does not look for internal resonance: see ``averaging.modal.resonance``.
    Where the damping depends on the state, c*_ii/M*_i gives way to the polynomial γ_i(H) of all
    modal energies, its average over the phases: see ``averaging.modal.phase_averages``.

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it.
    """
    modes = system.fact(modal_analysis)
    return modes_process(modes, range(modes.n))


def modes_process(modes: ModalAnalysis, chosen: Sequence[int]) -> Process:
    """Return the averaged energies of some modes (counted from 0), as no other acts on them.

    One alone is a square-root (CIR) process, Eq. (33): with constant damping no mode knows of
    another. The density of states is the period, a constant, and H = 0 is the critical case
    2 s(0)/b' = 1: an entrance, p(0) finite and positive. The same holds of a mode whose damping
    γ(H) depends on its own energy alone.
    """
    index = list(chosen)
    scales = tuple(float(theta) for theta in modes.temperature[index])
    if len(index) == 1:
        noise = float(modes.noise[index[0]] / modes.modal_mass[index[0]])
        return Process(partial(_square_root, modes.rate(index[0]), noise), energy_scales=scales)
    noises = (modes.noise / modes.modal_mass)[index]
    rates = modes.rates(tuple(index))

    def coefficients(energies: Array) -> Coefficients:
        n = noises.size
        b = np.zeros((*energies.shape, n))
        b.reshape(-1, n * n)[:, :: n + 1] = 2.0 * noises * energies
        dissipation = -rates(energies) * energies
        divergence = np.broadcast_to(2.0 * noises, energies.shape)
        return Coefficients(noises + dissipation, b, divergence, dissipation)

    return Process(coefficients, energy_scales=scales)


def _square_root(rate: Array, noise: float, energy: Array) -> Coefficients:
    """dH = (d − γ(H) H) dt + √(2 d H) dB with γ = Σ rate_k H^k, no error but round-off."""
    dissipation = -np.asarray(polynomial.polyval(energy, rate), dtype=float) * energy
    nothing = np.zeros_like(energy)
    return Coefficients(
        drift=noise + dissipation,
        diffusion=2.0 * noise * energy,
        divergence=nothing + 2.0 * noise,
        dissipation=dissipation,
        log_density_of_states=nothing,
        relative_error=nothing,
        slope_error=nothing,
    )
