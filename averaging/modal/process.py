"""Averaged modal energies as diffusion processes, Eqs. (17), (18), (32), (33)."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis, modal_analysis
from fpk.process import Coefficients, DiffusionProcess
from fpk.system import System
from fpk.vector_process import VectorProcess

Array = NDArray[np.float64]


def modal_process(system: System) -> VectorProcess:
    """Return the averaged modal energies dH_i = s_i dt + σ_il dB_l of ``system``, Eqs. (17), (33).

    ``s_i = (−c*_ii H_i + d_i)/M*_i``, ``b_ii = 2 d_i H_i/M*_i``, ``b_ij = 0`` for i ≠ j, with
    d_i = (Tᵀ f D fᵀ T)_ii. Corrections: (33) prints s_i without noise and mass, b_ii without H_i
    and with D₂ for D₁ in b₂₂; (18) prints P_i/M_j P_j and a noise term without masses. Contacts are
    left out. It does not look for internal resonance: see ``averaging.modal.resonance``.

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it.
    """
    modes = modal_analysis(system)
    return modes_process(modes, range(modes.n))


def modes_process(modes: ModalAnalysis, chosen: Sequence[int]) -> VectorProcess:
    """Return the averaged energies of some modes (counted from 0), as no other acts on them."""
    index = list(chosen)
    damping = (modes.damping / modes.modal_mass)[index]
    noise = (modes.noise / modes.modal_mass)[index]

    def drift(energies: Array) -> Array:
        return np.asarray(noise - damping * energies)

    def diffusion(energies: Array) -> Array:
        return np.asarray(2.0 * (noise * energies)[..., None] * np.eye(noise.size))

    def diffusion_divergence(energies: Array) -> Array:
        return np.broadcast_to(2.0 * noise, energies.shape).copy()

    return VectorProcess(
        drift=drift,
        diffusion=diffusion,
        diffusion_divergence=diffusion_divergence,
        energy_scales=tuple(float(theta) for theta in modes.temperature[index]),
    )


def mode_process(modes: ModalAnalysis, mode: int) -> DiffusionProcess:
    """Return the energy of one mode (counted from 0): a square-root (CIR) process, Eq. (33).

    With constant damping no mode knows of another. The density of states is the period, a
    constant, and H = 0 is the critical case 2 s(0)/b' = 1: an entrance, p(0) finite and positive.
    """
    damping = float(modes.damping[mode] / modes.modal_mass[mode])
    noise = float(modes.noise[mode] / modes.modal_mass[mode])
    return DiffusionProcess(
        coefficients=partial(_square_root, damping, noise),
        energy_scale=noise / damping,
        nonsmooth=(),
        degrees_of_freedom=1,
    )


def _square_root(damping: float, noise: float, energy: Array) -> Coefficients:
    nothing = np.zeros_like(energy)
    return Coefficients(
        drift=noise - damping * energy,
        diffusion=2.0 * noise * energy,
        diffusion_slope=nothing + 2.0 * noise,
        dissipation=-damping * energy,
        log_density_of_states=nothing,
        relative_error=nothing,
    )
