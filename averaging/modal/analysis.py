"""Modal analysis of the chain without contacts, Eqs. (12)-(16)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from fpk.errors import NotApplicable
from fpk.system import System

Array = NDArray[np.float64]

NOTHING = 1e-12
"""A modal damping or noise below this share of the terms that cancel in it counts as none."""


@dataclass(frozen=True, eq=False)
class ModalAnalysis:
    """Modes of K T = M T ω², ascending, with damping and noise in modal coordinates.

    ``X = T Q`` (14), so that ``P = Tᵀ p`` are the modal momenta. ``mode_shapes`` T (n, n), one mode
    a column; ``modal_mass`` M* and ``modal_stiffness`` K* (n,); ``modal_damping`` c* = Tᵀ c T and
    ``modal_noise`` D* = Tᵀ (f D fᵀ) T (n, n), E[W*_i W*_j'] = 2 D*_ij δ; ``natural_frequency`` (n,)
    in radians per time. ``relative_error`` estimates the round-off of what is built from them.
    """

    mode_shapes: Array
    modal_mass: Array
    modal_stiffness: Array
    modal_damping: Array
    modal_noise: Array
    natural_frequency: Array
    relative_error: float

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
        """θ_i = d_i/c*_ii, the mean energy of each mode (n,)."""
        return np.asarray(self.noise / self.damping)


def modal_analysis(system: System) -> ModalAnalysis:
    """Return the modes of ``system`` without its contacts, Eqs. (13)-(16).

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it.
    """
    if system.damping_terms:
        raise NotApplicable("damping that depends on the state is not averaged yet")
    K, M = system.stiffness_matrix, np.diag(system.mass)
    squares, T = eigh(K, M)
    c, D = T.T @ system.damping @ T, T.T @ system.noise_matrix @ T
    cancelling = [
        np.einsum("ri,rs,si->i", np.abs(T), np.abs(matrix), np.abs(T))
        for matrix in (system.damping, system.noise_matrix)
    ]
    for words, matrix, terms in (
        ("is not damped, so its energy grows for ever", c, cancelling[0]),
        ("gets no noise, so its energy has no density: b_ii of (17) vanishes", D, cancelling[1]),
    ):
        for i in np.flatnonzero(np.diag(matrix) <= NOTHING * terms):
            raise NotApplicable(f"mode {i + 1} (ω = {np.sqrt(squares[i]):.4g}) {words}")
    worst = max(
        float(np.max(terms / np.diag(matrix)))
        for matrix, terms in zip((c, D), cancelling, strict=True)
    )
    return ModalAnalysis(
        mode_shapes=T,
        modal_mass=np.einsum("ri,r,ri->i", T, system.mass, T),
        modal_stiffness=np.einsum("ri,rs,si->i", T, K, T),
        modal_damping=c,
        modal_noise=D,
        natural_frequency=np.sqrt(squares),
        relative_error=_round_off(squares) * worst,
    )


def _round_off(squares: Array) -> float:
    """Relative round-off of modes: the solver's backward error n ε ω_max² over the least gap of ω².

    The gap to 0 counts: the stiffness of the slowest mode is as uncertain as that.
    """
    gap = float(np.min(np.diff(squares, prepend=0.0)))
    eps = float(np.finfo(float).eps)
    return 2.0 * squares.size * eps * float(squares[-1]) / max(gap, eps * float(squares[-1]))
