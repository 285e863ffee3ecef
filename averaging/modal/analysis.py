"""Modal analysis of the chain without contacts and its averaged energies, Eqs. (12)-(18), (33)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from averaging.modal.damping import NEGLIGIBLE, AveragedDamping, averaged_damping, balanced_energies
from fpk.arrays import EPS, Array
from fpk.ends import require_confined
from fpk.errors import NotApplicable, NotCertified
from fpk.linear import natural_modes
from fpk.probe import probed
from fpk.process import Coefficients, Process
from fpk.system import System


@dataclass(frozen=True, eq=False)
class ModalAnalysis:
    """Modes of K T = M T ω², ascending, of unit modal mass, with damping and noise.

    ``X = T Q`` (14), so that ``P = Tᵀ p = Q̇`` are the modal momenta. ``mode_shapes`` T (n, n), one
    mode a column, Tᵀ M T = 1; ``state_shapes`` S (2n, 2n), so that (q, p) = S (ω Q, P);
    ``natural_frequency`` ω (n,) in radians per time, K* = ω²; ``modal_noise`` D* = Tᵀ f D fᵀ T
    (n, n), E[W*_i W*_j'] = 2 D*_ij δ. ``modal_damping`` c* = Tᵀ c T (n, n); where the damping
    depends on the state it is the constant one of statistical linearisation,
    c*_mk = E[F_m Q̇_k]/E Q̇_k². ``averaged`` is the damping averaged over the phases;
    ``constant`` says that it does not depend on the state. ``relative_error`` estimates the
    relative round-off of damping and noise.
    """

    mode_shapes: Array
    state_shapes: Array
    natural_frequency: Array
    modal_damping: Array
    modal_noise: Array
    averaged: AveragedDamping
    constant: bool
    relative_error: float

    @property
    def n(self) -> int:
        """Number of modes."""
        return self.natural_frequency.size

    @property
    def noise(self) -> Array:
        """d_i = D*_ii of each mode (n,)."""
        return np.diag(self.modal_noise)

    @property
    def half_bandwidth(self) -> Array:
        """c*_ii/2, the rate at which the amplitude of a mode decays (n,)."""
        return np.asarray(0.5 * np.diag(self.modal_damping))

    @property
    def temperature(self) -> Array:
        """θ_i = d_i/c*_ii, the mean energy of each mode (n,); a scale only if not ``constant``."""
        return np.asarray(self.noise / np.diag(self.modal_damping))

    def process(self, modes: Sequence[int] | None = None) -> Process:
        """Return dH_i = s_i dt + σ_il dB_l of some modes on which no other acts, or of all of them.

        ``s_i = d_i − γ_i(H) H_i``, ``b_ii = 2 d_i H_i``, ``b_ij = 0``, Eqs. (17), (33), with
        γ_i = c*_ii where the damping is constant. Corrections: (33) prints s_i without noise and
        mass, b_ii without H_i and with D₂ for D₁ in b₂₂; (18) prints P_i/M_j P_j and a noise term
        without masses. The density of states is the period, a constant; at the entrance H = 0,
        where 2 s(0)/b' = 1, p is finite and positive. Resonance: ``averaging.modal.resonance``.
        """
        index = list(range(self.n) if modes is None else modes)
        d, rates = self.noise[index], self.averaged.rates(index)
        one = len(index) == 1

        def coefficients(energies: Array) -> Coefficients:
            H = energies.reshape(-1, d.size)
            b = 2.0 * d * H
            dissipation = (-rates(H) * H).reshape(energies.shape)
            zero = np.zeros_like(energies)
            known = (zero, zero) if one else ()
            return Coefficients(
                d + dissipation,
                b.reshape(energies.shape) if one else b[:, :, None] * np.eye(d.size),
                2.0 * d + zero,
                dissipation,
                *known,
            )

        return Process(coefficients, tuple(float(theta) for theta in self.temperature[index]))


def modal_analysis(system: System) -> ModalAnalysis:
    """Return the modes of ``system`` without its contacts, Eqs. (13)-(16).

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it, or damping that
    depends on the state lets energies grow for ever.
    """
    T, omega = natural_modes(system)
    averaged, constant = averaged_damping(system, T, omega), not system.damping_terms
    D, size = T.T @ system.noise_matrix @ T, np.abs(T.T) @ np.abs(system.noise_matrix) @ np.abs(T)
    c, noise = averaged.values[0], np.diag(D)
    names = [f"mode {i + 1} (ω = {w:.4g})" for i, w in enumerate(omega)]
    for i in np.flatnonzero(np.diag(c) <= 0.0) if constant else ():
        raise NotApplicable(f"{names[i]} is not damped, so its energy grows for ever")
    for i in np.flatnonzero(noise <= NEGLIGIBLE * np.diag(size)):
        raise NotApplicable(
            f"{names[i]} gets no noise, so its energy has no density: b_ii of (17) vanishes"
        )
    theta = noise / np.diag(c) if constant else balanced_energies(system, averaged, noise)
    damping, damping_size = averaged.mean(theta)
    # Round-off is relative to what cancels in the damping and in the noise of a mode.
    cancelling = np.max(np.diag(damping_size) * theta / noise) + np.max(np.diag(size) / noise)
    # Modes have that of singular values, n ε ω_max, over the least gap of ω, that to 0 included.
    gap = max(float(np.min(np.diff(omega, prepend=0.0))), EPS * float(omega[-1]))
    round_off = 2.0 * omega.size * EPS * float(omega[-1]) / gap
    modes = ModalAnalysis(
        mode_shapes=T,
        # p = T⁻ᵀ P, where (35) prints T_11^{-1} for an element of the matrix T⁻¹ = Tᵀ M.
        state_shapes=block_diag(T / omega, system.mass[:, None] * T),
        natural_frequency=omega,
        modal_damping=c if constant else damping,
        modal_noise=D,
        averaged=averaged,
        constant=constant,
        relative_error=round_off * float(cancelling),
    )
    # Energies that the damping couples grow for ever or not; of more than two that is not judged.
    for group in () if constant else averaged.groups:
        try:
            if len(group) == 1:
                probed(modes.process(group))
            elif len(group) == 2:
                require_confined(modes.process(group))
        except NotCertified as reason:
            grow = " and ".join(f"H{m + 1}" for m in group)
            raise NotApplicable(f"{grow}: {reason}, so the energy grows for ever") from reason
    return modes
