"""Linear part of a system: springs, natural modes (13), constant damping and noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np
from scipy.linalg import block_diag, expm, matrix_balance, solve_continuous_lyapunov

from fpk.numeric.arrays import EPS, ROUND_OFF, Array
from fpk.numeric.errors import NotApplicable
from fpk.system.system import System


def drift_matrix(system: System) -> Array:
    """Return A (2n, 2n) of ``dx = A x dt + …``, x = (q, p), without contacts and damping terms."""
    velocity, nothing = np.diag(1.0 / system.mass), np.zeros((system.n, system.n))
    damping = system.damping * (1.0 / system.mass)
    return np.block([[nothing, velocity], [-system.stiffness_matrix, -damping]])


def diffusion_matrix(system: System) -> Array:
    """Return the diffusion b = σσᵀ (2n, 2n) of x = (q, p): 2 f D fᵀ for the momenta, else 0."""
    return np.asarray(block_diag(np.zeros((system.n, system.n)), 2.0 * system.noise_matrix))


def natural_modes(system: System) -> tuple[Array, Array]:
    """Return the shapes T (n, n), one mode a column, and ω (n,) of K T = M T ω², ω ascending.

    Shapes are normalised to Tᵀ M T = 1, with arbitrary signs, and ω is in radians per time. A mode
    has the energy ``H_m = ½ (P_m² + ω_m² Q_m²)`` with ``Q = Tᵀ M q``, ``q = T Q``, ``P = Tᵀ p``.

    With K = Gᵀ G, row i of G being √k_i (q_i − q_{i−1}), ω are the singular values of G M^(−1/2).
    Small ω keep digits that eigenvalues of K would lose to the round-off of the largest.
    """
    roots, springs = np.sqrt(system.mass), np.sqrt(system.stiffness)
    G = np.diag(springs) - np.diag(springs[1:], -1)
    _, omega, transposed = np.linalg.svd(G / roots)
    return np.ascontiguousarray((transposed[::-1] / roots).T), np.ascontiguousarray(omega[::-1])


def displacements_given(system: System, masses: Sequence[int]) -> tuple[Array, Array]:
    """Return w (n, c) and Σ (n, n) of q = w q_c + ξ, ξ ~ N(0, θ Σ), q_c the given displacements.

    It is the Gibbs state of temperature θ without contacts, conditioned on the displacements of
    ``masses``, c ascending numbers from 0; the wall is given, too, at 0. Between two given masses
    the chain is a Brownian bridge: the covariance of two masses is a b/s, with the flexibilities a
    from the lower given mass to the nearer of the two, b from the farther of the two to the upper
    given mass, and s between both given masses. Beyond the last given mass it is a, and 0 between
    masses that a given mass separates. Nothing cancels, for any ratio of springs.
    """
    n, flexibility = system.n, 1.0 / system.stiffness
    weights, covariance = np.zeros((n, len(masses))), np.zeros((n, n))
    for k, (below, above) in enumerate(pairwise([-1, *masses, n])):
        a = np.cumsum(flexibility[below + 1 : above])
        block, share = np.minimum.outer(a, a), np.ones(a.size)
        if above < n:
            s, *rest = (flexibility[i : above + 1].sum() for i in range(below + 1, above + 1))
            b = np.array(rest)
            block, share = block * (np.minimum.outer(b, b) / s), b / s
            weights[below + 1 : above, k] = a / s
            weights[above, k] = 1.0
        if k:
            weights[below + 1 : above, k - 1] = share
        covariance[below + 1 : above, below + 1 : above] = block
    return weights, covariance


def modal_energies(system: System, q: Array, p: Array) -> Array:
    """Return the energies H_m (..., n) of the modes at ``q``, ``p`` (..., n), without contacts."""
    shapes, omega = natural_modes(system)
    energies: Array = 0.5 * ((p @ shapes) ** 2 + (omega * ((q * system.mass) @ shapes)) ** 2)
    return energies


def decay_time(system: System) -> float:
    """Return 1/min(−Re λ), λ the eigenvalues of ``drift_matrix``; inf if a motion never decays."""
    eigenvalues = np.linalg.eigvals(drift_matrix(system))
    rate = float(-np.max(eigenvalues.real))
    return 1.0 / rate if rate > ROUND_OFF * float(np.max(np.abs(eigenvalues))) else inf


@dataclass(frozen=True, eq=False)
class LinearCovariance:
    """Covariance of x = (ω Q, P) of the modes without contacts, and its errors.

    ``shapes`` T (n, n) and ``omega`` (n,) are from ``natural_modes``; ``drift`` is A (2n, 2n) of
    dx = A x dt + …. ``covariance`` (2n, 2n) is V diag(``variance``) Vᵀ with ``axes`` V, variances
    ascending; ``variance_error`` (2n,) are their errors and ``relative_error`` is the largest
    relative error of a variance E (a·x)² for any a. ``residual`` is the largest of the Lyapunov
    equation, relative to its terms.
    """

    shapes: Array
    omega: Array
    drift: Array
    covariance: Array
    axes: Array
    variance: Array
    variance_error: Array
    relative_error: float
    residual: float


def linear_covariance(system: System) -> LinearCovariance:
    """Return the covariance Σ of (ω Q, P) of the modes without contacts, from A Σ + Σ Aᵀ + b = 0.

    In these coordinates A has the rates of every mode, which lose no digits beside faster modes.
    The error estimate is the sum of the last of two corrections, of the effect of a residual of the
    size of its round-off, and of the effect of a round-off of ω with alternating signs.

    Raises ``NotApplicable`` if a mode is not damped or the damping depends on the state.
    """
    if system.damping_terms:
        raise NotApplicable("the damping depends on the state, so the system is not linear")
    if decay_time(system) == inf:
        raise NotApplicable("a mode is not damped, so that there is no stationary state")
    n = system.n
    T, omega = natural_modes(system)
    nothing = np.zeros((n, n))
    A = np.block([[nothing, np.diag(omega)], [-np.diag(omega), -T.T @ system.damping @ T]])
    b = block_diag(nothing, 2.0 * T.T @ system.noise_matrix @ T)
    covariance = correction = np.zeros((2 * n, 2 * n))
    # The first correction leaves the square of the solver's relative error, which is below 1e-6 if
    # every mode decays by more than 1e-10 in a radian; the second estimates what remains.
    for _ in range(3):
        correction = solve_continuous_lyapunov(A, -(A @ covariance + covariance @ A.T + b))
        covariance = covariance + 0.5 * (correction + correction.T)
    left = A @ covariance + covariance @ A.T + b
    # Sizes of the terms of A and b, which cancel if a mode is nearly undamped.
    both = system.damping, 2.0 * system.noise_matrix
    damping, noise = (np.abs(T.T) @ np.abs(x) @ np.abs(T) for x in both)
    sizes = np.block([[nothing, np.diag(omega)], [np.diag(omega), damping]]) @ np.abs(covariance)
    terms = sizes + sizes.T
    terms[n:, n:] += noise
    rounding = EPS * 2 * n
    shift = rounding * float(omega[-1]) * (-1.0) ** np.arange(n)
    turned = np.block([[nothing, np.diag(shift)], [-np.diag(shift), nothing]]) @ covariance
    effects = [solve_continuous_lyapunov(A, -x) for x in (rounding * terms, turned + turned.T)]
    variance, V = np.linalg.eigh(covariance)
    errors = [V.T @ effect @ V for effect in (correction, *effects)]
    # Eigenvalues have the round-off of the largest eigenvalue, soft modes that of the stiffest.
    variance_error = sum(np.abs(np.diag(e)) for e in errors) + rounding * variance[-1]
    variance_error += 2.0 * rounding * omega[-1] / omega[0] * variance
    size = np.sqrt(np.maximum(variance, variance_error))
    size[size == 0.0] = 1.0  # a mode at rest without noise has no error
    relative = sum(np.linalg.norm(e / np.outer(size, size), 2) for e in errors)
    relative += np.max(variance_error / size**2)
    # An entry between uncorrelated modes has no terms: its scale is that of both diagonal entries,
    # for displacements of the terms ω Σ.
    terms[range(n), range(n)] += omega * np.abs(np.diag(covariance)[:n])
    alone = np.sqrt(np.diag(terms))
    terms = np.maximum(terms, np.outer(alone, alone))
    residual = float(np.max(np.abs(left) / np.where(terms > 0.0, terms, 1.0)))
    return LinearCovariance(
        T, omega, A, covariance, V, variance, variance_error, float(relative), residual
    )


def stationary_covariance(system: System) -> Array:
    """Return the covariance (2n, 2n) of (q, p) without contacts, for full matrices of damping and
    noise. Raises ``NotApplicable`` as ``linear_covariance`` does."""
    modal = system.fact(linear_covariance)
    back = block_diag(modal.shapes / modal.omega, system.mass[:, None] * modal.shapes)
    covariance = back @ modal.covariance @ back.T
    return np.asarray(0.5 * (covariance + covariance.T))


def flow_covariance(drift: Array, diffusion: Array, dt: float) -> tuple[Array, Array]:
    """Return ``exp(A dt)`` and ``∫ exp(A s) b exp(Aᵀ s) ds`` over 0..dt.

    A is the ``drift`` and b the ``diffusion`` matrix (2n, 2n). Van Loan's block exponential (IEEE
    Trans. Automat. Control 23, 1978, 395) for ``|A| h <= ½``, in units in which A is balanced and b
    is about 1; each doubling of ``h`` adds positive covariances: nothing cancels.
    """
    with np.errstate(invalid="ignore"):  # scipy casts the scale to a permutation, which is unused
        balanced, (scale, _) = matrix_balance(drift, permute=False, separate=True)
    row = scale[:, None]
    diffusion = diffusion / row / scale
    largest = float(np.max(np.abs(diffusion)))
    size = 2.0 ** np.floor(np.log2(largest)) if largest > 0.0 else 1.0
    A, b, m = np.asarray(balanced, dtype=float), diffusion / size, len(drift)
    doublings = max(0, int(np.ceil(np.log2(2.0 * np.linalg.norm(A, 2) * dt + 1e-300))))
    h = dt / 2**doublings
    block = expm(np.block([[-A, b], [np.zeros((m, m)), A.T]]) * h)
    propagator = block[m:, m:].T
    covariance = propagator @ block[:m, m:]
    for _ in range(doublings):
        covariance = covariance + propagator @ covariance @ propagator.T
        propagator = propagator @ propagator
    covariance = size * (row * (0.5 * (covariance + covariance.T)) * scale)
    return row * expm(A * dt) / scale, covariance
