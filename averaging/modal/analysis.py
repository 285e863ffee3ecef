"""Modal analysis of the chain without contacts, Eqs. (12)-(16)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from averaging.modal.ends import growth_reason
from averaging.modal.phase_averages import ModeShapes
from averaging.modal.state_damping import (
    NEGLIGIBLE,
    StateDamping,
    balanced_energies,
    state_damping,
)
from fpk.equivalent import equivalent_temperature
from fpk.errors import NotApplicable
from fpk.modes import natural_modes
from fpk.system import System

Array = NDArray[np.float64]

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class ModalAnalysis:
    """Modes of K T = M T ω², ascending, with damping and noise in modal coordinates.

    ``X = T Q`` (14), so that ``P = Tᵀ p`` are the modal momenta. ``mode_shapes`` T (n, n), one mode
    a column; ``momentum_shapes`` T⁻ᵀ = M T M*⁻¹ (n, n), so that p = T⁻ᵀ P; ``modal_mass`` M* and
    ``modal_stiffness`` K* (n,); ``modal_damping`` c* = Tᵀ c T and ``modal_noise`` D* = Tᵀ f D fᵀ T
    (n, n), E[W*_i W*_j'] = 2 D*_ij δ; ``natural_frequency`` (n,) in radians per time.
    ``relative_error`` estimates the round-off of what is built from them.
    Where the damping depends on the state, ``modal_damping`` is its constant part, ``state`` has
    all of it, averaged, and ``balance`` (n,) the energies at which it balances the noise.
    """

    mode_shapes: Array
    momentum_shapes: Array
    modal_mass: Array
    modal_stiffness: Array
    modal_damping: Array
    modal_noise: Array
    natural_frequency: Array
    relative_error: float
    state: StateDamping | None = None
    balance: Array | None = None

    @property
    def n(self) -> int:
        """Number of modes."""
        return self.modal_mass.size

    @property
    def damping(self) -> Array:
        """c*_ii of each mode (n,)."""
        return np.diag(self.modal_damping)

    @property
    def noise(self) -> Array:
        """d_i = D*_ii of each mode (n,)."""
        return np.diag(self.modal_noise)

    @property
    def period(self) -> Array:
        """T_i = 2π √(M*_i/K*_i), the density of states of one mode; (18) prints √(K/M)."""
        return np.asarray(2.0 * np.pi * np.sqrt(self.modal_mass / self.modal_stiffness))

    @property
    def half_bandwidth(self) -> Array:
        """c*_ii/(2 M*_i), the rate at which the amplitude of a mode decays (n,)."""
        return np.asarray(0.5 * self.damping / self.modal_mass)

    @cached_property
    def temperature(self) -> Array:
        """θ_i = d_i/c*_ii, the mean energy of each mode (n,); for ``state`` of its order only."""
        if self.balance is not None:
            return self.balance
        return np.asarray(self.noise / self.damping)

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Return the groups of modes, ascending, within which a damping rate depends on another."""
        return self.state.groups() if self.state else tuple((m,) for m in range(self.n))

    def rate(self, mode: int) -> Array:
        """Return γ(H) of a mode on which no other acts, coefficients in ascending powers of H."""
        if self.state is None:
            return np.array([self.damping[mode] / self.modal_mass[mode]])
        return self.state.of_group((mode,)).along(0)

    def rates(self, group: tuple[int, ...]) -> Callable[[Array], Array]:
        """Return γ_m at energies (points, k) of a group of modes on which no other acts."""
        if self.state is not None:
            return self.state.of_group(group).rates
        constant = (self.damping / self.modal_mass)[list(group)]
        return lambda energies: constant

    @cached_property
    def linearised(self) -> "ModalAnalysis":
        """The modes with the constant damping equivalent to theirs at the balance; or themselves.

        c*_mk = E[F_m Q̇_k]/E[Q̇_k²] with independent Gaussian modes: statistical linearisation.
        """
        if self.state is None or self.balance is None:
            return self
        damping = self.state.linearised(self.balance) * self.modal_mass
        return replace(self, modal_damping=damping, state=None, balance=None)


def modal_analysis(system: System) -> ModalAnalysis:
    """Return the modes of ``system`` without its contacts, Eqs. (13)-(16).

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it.
    """
    T, omega = natural_modes(system)
    c, D = T.T @ system.damping @ T, T.T @ system.noise_matrix @ T
    cancelling = [
        np.einsum("ri,rs,si->i", np.abs(T), np.abs(matrix), np.abs(T))
        for matrix in (system.damping, system.noise_matrix)
    ]
    checks = [("gets no noise, so its energy has no density: b_ii of (17) vanishes", D, 1)]
    if not system.damping_terms:
        checks.insert(0, ("is not damped, so its energy grows for ever", c, 0))
    for words, matrix, k in checks:
        for i in np.flatnonzero(np.diag(matrix) <= NEGLIGIBLE * cancelling[k]):
            raise NotApplicable(f"mode {i + 1} (ω = {omega[i]:.4g}) {words}")
    worst = max(float(np.max(cancelling[k] / np.diag(matrix))) for _, matrix, k in checks)
    mass = np.einsum("ri,r,ri->i", T, system.mass, T)
    modes = ModalAnalysis(
        mode_shapes=T,
        momentum_shapes=system.mass[:, None] * T / mass,
        modal_mass=mass,
        modal_stiffness=omega**2 * mass,
        modal_damping=c,
        modal_noise=D,
        natural_frequency=omega,
        relative_error=_round_off(omega) * worst,
    )
    if not system.damping_terms:
        return modes
    return _with_state_damping(system, modes, cancelling[0] / modes.modal_mass)


def _with_state_damping(system: System, modes: ModalAnalysis, sizes: Array) -> ModalAnalysis:
    """The modes with damping that depends on the state; ``sizes`` (n,) of what cancels in γ_m(0).

    An error of γ_m moves ln p by its share of d_m/(M*_m H_m), the rate that balances it.
    """
    shapes = ModeShapes(modes.mode_shapes, modes.modal_mass, modes.modal_stiffness)
    state = state_damping(system, shapes, modes.modal_damping / modes.modal_mass)
    noise = modes.noise / modes.modal_mass
    try:
        guess = equivalent_temperature(system)
    except NotApplicable:
        guess = float(np.max(noise / sizes))
    theta = balanced_energies(state, noise, guess)
    if reason := growth_reason(state):
        raise NotApplicable(reason)
    cancelling = float(np.max((sizes + state.size(theta)) * theta / noise))
    error = modes.relative_error + _round_off(modes.natural_frequency) * cancelling
    return replace(modes, state=state, balance=theta, relative_error=error)


def _round_off(omega: Array) -> float:
    """Relative round-off of modes: that of singular values, n ε ω_max, over the least gap of ω.

    The gap to 0 counts: the slowest mode is as uncertain as that.
    """
    gap = float(np.min(np.diff(omega, prepend=0.0)))
    return 2.0 * omega.size * EPS * float(omega[-1]) / max(gap, EPS * float(omega[-1]))
