"""The linear part of a system: springs, constant damping and noise."""

from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from fpk.errors import NotApplicable
from fpk.modes import natural_modes
from fpk.system import System

Array = NDArray[np.float64]

UNDAMPED = 1e-12
"""A decay rate below this share of the largest eigenvalue of the drift is round-off."""


def drift_matrix(system: System) -> Array:
    """Return A of ``dx = A x dt + …`` with x = (q, p), shape (2n, 2n)."""
    n = system.n
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.diag(1.0 / system.mass)
    A[n:, :n] = -system.stiffness_matrix
    A[n:, n:] = -system.damping / system.mass
    return A


def diffusion_matrix(system: System) -> Array:
    """Return the constant b = 2 f D fᵀ of the momenta in x = (q, p), shape (2n, 2n)."""
    n = system.n
    b = np.zeros((2 * n, 2 * n))
    b[n:, n:] = 2.0 * system.noise_matrix
    return b


def natural_frequencies(system: System) -> Array:
    """Return the ω_i of K T = M T ω², ascending, in radians per time, Eq. (18) corrected."""
    return natural_modes(system)[1]


def decay_time(system: System) -> float:
    """Return 1/rate of the slowest decay of the linear part; inf where some motion never decays."""
    eigenvalues = np.linalg.eigvals(drift_matrix(system))
    rate = float(-np.max(eigenvalues.real))
    return 1.0 / rate if rate > UNDAMPED * float(np.max(np.abs(eigenvalues))) else inf


def stationary_covariance(system: System) -> Array:
    """Return the covariance of (q, p) of the system without contacts, shape (2n, 2n).

    It solves A Σ + Σ Aᵀ + b = 0 and is exact for any damping and noise. Raises
    ``NotApplicable`` where a mode is not damped, so that no stationary state exists, and where the
    damping depends on the state.
    """
    if system.damping_terms:
        raise NotApplicable("the damping depends on the state, so the system is not linear")
    if decay_time(system) == inf:
        raise NotApplicable("a mode is not damped, so that there is no stationary state")
    # In (ω Q, P) of the modes every entry is a rate of its own mode, so that a slow one is not
    # lost beside a fast one, eight decades away.
    shapes, omega = natural_modes(system)
    nothing = np.zeros((system.n, system.n))
    rates = shapes.T @ system.damping @ shapes
    A = np.block([[nothing, np.diag(omega)], [-np.diag(omega), -rates]])
    b = np.block([[nothing, nothing], [nothing, 2.0 * shapes.T @ system.noise_matrix @ shapes]])
    modal = np.asarray(solve_continuous_lyapunov(A, -b))
    back = np.block([[shapes / omega, nothing], [nothing, system.mass[:, None] * shapes]])
    covariance = back @ modal @ back.T
    return np.asarray(0.5 * (covariance + covariance.T))
