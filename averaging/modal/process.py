"""Averaged modal energies as diffusion processes, Eqs. (17), (18), (32), (33)."""

from collections.abc import Callable, Sequence
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
    Where the damping depends on the state, c*_ii/M*_i gives way to the polynomial γ_i(H) of all
    modal energies, its average over the phases: see ``averaging.modal.phase_averages``.

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it.
    """
    modes = modal_analysis(system)
    return modes_process(modes, range(modes.n))


def modes_process(modes: ModalAnalysis, chosen: Sequence[int]) -> VectorProcess:
    """Return the averaged energies of some modes (counted from 0), as no other acts on them."""
    index = list(chosen)
    noise = (modes.noise / modes.modal_mass)[index]

    def diffusion(energies: Array) -> Array:
        n = noise.size
        b = np.zeros((*energies.shape, n))
        b.reshape(-1, n * n)[:, :: n + 1] = 2.0 * noise * energies.reshape(-1, n)
        return b

    def diffusion_divergence(energies: Array) -> Array:
        return np.broadcast_to(2.0 * noise, energies.shape).copy()

    return VectorProcess(
        drift=_drift(modes, index, noise),
        diffusion=diffusion,
        diffusion_divergence=diffusion_divergence,
        energy_scales=tuple(float(theta) for theta in modes.temperature[index]),
    )


def _drift(modes: ModalAnalysis, index: list[int], noise: Array) -> Callable[[Array], Array]:
    if modes.state is None:
        damping = (modes.damping / modes.modal_mass)[index]
        return lambda energies: np.asarray(noise - damping * energies)
    state = modes.state.of_block(tuple(index))
    return lambda energies: np.asarray(noise - state.rates(energies) * energies)


def mode_process(modes: ModalAnalysis, mode: int) -> DiffusionProcess:
    """Return the energy of one mode (counted from 0): a square-root (CIR) process, Eq. (33).

    With constant damping no mode knows of another. The density of states is the period, a
    constant, and H = 0 is the critical case 2 s(0)/b' = 1: an entrance, p(0) finite and positive.
    The same holds of a mode whose damping γ(H) depends on its own energy alone.
    """
    noise = float(modes.noise[mode] / modes.modal_mass[mode])
    if modes.state is not None:
        return DiffusionProcess(
            coefficients=partial(_rated, modes.state.of_block((mode,)).polynomial(), noise),
            energy_scale=float(modes.temperature[mode]),
            nonsmooth=(),
            degrees_of_freedom=1,
        )
    damping = float(modes.damping[mode] / modes.modal_mass[mode])
    return DiffusionProcess(
        coefficients=partial(_square_root, damping, noise),
        energy_scale=noise / damping,
        nonsmooth=(),
        degrees_of_freedom=1,
    )


def _square_root(damping: float | Array, noise: float, energy: Array) -> Coefficients:
    nothing = np.zeros_like(energy)
    return Coefficients(
        drift=noise - damping * energy,
        diffusion=2.0 * noise * energy,
        diffusion_slope=nothing + 2.0 * noise,
        dissipation=-damping * energy,
        log_density_of_states=nothing,
        relative_error=nothing,
        slope_error=nothing,
    )


def _rated(rate: Array, noise: float, energy: Array) -> Coefficients:
    """As ``_square_root`` with the damping Σ rate_k H^k."""
    damping = np.asarray(np.polynomial.polynomial.polyval(energy, rate), dtype=float)
    return _square_root(damping, noise, energy)
