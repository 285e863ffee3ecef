"""The linear part of a system: springs, constant damping and noise."""

from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, solve_continuous_lyapunov

from fpk.errors import NotApplicable
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
    squares = eigh(system.stiffness_matrix, np.diag(system.mass), eigvals_only=True)
    return np.asarray(np.sqrt(squares))


def slowest_decay_rate(system: System) -> float:
    """Return the least decay rate of the linear part, −max Re λ(A); <= 0 if it does not decay."""
    return float(-np.max(np.linalg.eigvals(drift_matrix(system)).real))


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
    A = drift_matrix(system)
    if decay_time(system) == inf:
        raise NotApplicable("a mode is not damped, so that there is no stationary state")
    covariance = solve_continuous_lyapunov(A, -diffusion_matrix(system))
    return np.asarray(0.5 * (covariance + covariance.T))
