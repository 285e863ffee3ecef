"""A linear system in time: exact but for round-off."""

import heapq
from typing import Any

import numpy as np
from scipy.linalg import eig, expm

from fpk.arrays import EPS, Array, Complexes
from fpk.linear import linear_covariance, natural_modes
from fpk.system import System

EXPM = 160.0
"""Round-off of e^(At) in units of that of t A, and of the masses: against 50 digits, of 800 lags of
270 systems, one to three masses, up to 1e4 radians, 80 was the most."""


def spectral_density(system: System, row: int, at: Array) -> tuple[Array, Array]:
    """Return (1/π) [h f D fᵀ h*]_ii, h(ω) = (K − ω² M + iω c)⁻¹, of q of mass ``row``, and errors.

    White noise of E[W W'] = 2 D δ has the two-sided spectral density D/π. The error is that of a
    perturbation of all entries of h⁻¹ by their round-off.
    """
    K, M, c, D = system.stiffness_matrix, np.diag(system.mass), system.damping, system.noise_matrix
    w = at[:, None, None]
    h = np.linalg.inv(K - w**2 * M + 1j * w * c)
    rounding = 4.0 * EPS * system.n * (np.abs(K) + w**2 * M + np.abs(w * c))
    own, size = h[:, row], np.abs(h)
    changed = (size[:, row, None] @ rounding @ size)[:, 0]
    values = np.einsum("wi,ij,wj->w", own, D, own.conj()).real / np.pi
    sizes = np.einsum("wi,ij,wj->w", changed + EPS * size[:, row], np.abs(D), size[:, row])
    return values, 2.0 * sizes / np.pi


def autocovariance(system: System, row: int, at: Array) -> tuple[Array, Array]:
    """Return (e^(At) Σ)_ii of q of mass ``row`` at the lags ``at``, and errors.

    With Σ of the Lyapunov equation it solves dC/dt = A C. In (ω Q, P) of the modes, where nothing
    grows, |e^(At)| <= 1: round-off of A changes e^(At) by no more than t times itself and
    |e^(At/2)|. An error of Σ, relative to it as a quadratic form, is felt by q and its forecast.
    """
    modes, A = system.fact(linear_covariance), _modal_drift(system)
    w = np.append(modes.shapes[row] / modes.omega, np.zeros(system.n))
    Sigma, size = modes.covariance, float(np.linalg.norm(A, 2))
    own = float(w @ Sigma @ w)
    values, errors = np.empty(at.size), np.empty(at.size)
    for k, t in enumerate(at):
        # Of more radians than 1/EPS no digit is known, but that nothing is left.
        half = expm(0.5 * min(t, 1.0 / (EPS * size)) * A)
        forecast = w @ half @ half
        values[k] = forecast @ Sigma @ w
        rounding = EXPM * system.n * EPS * (1.0 + t * size) * float(np.linalg.norm(half, 2))
        errors[k] = rounding * float(np.linalg.norm(w) * np.linalg.norm(Sigma @ w))
        felt = np.sqrt(own * max(float(forecast @ Sigma @ forecast), 0.0))
        errors[k] += modes.relative_error * felt
    return values, errors


def _modal_drift(system: System) -> Array:
    """A of dx = A x dt + … with x = (ω Q, P) of the natural modes, shape (2n, 2n)."""
    T, omega = natural_modes(system)
    nothing = np.zeros((system.n, system.n))
    return np.block([[nothing, np.diag(omega)], [-np.diag(omega), -T.T @ system.damping @ T]])


def rice_rates(q: float, v: float, relative: float, at: Array) -> tuple[Array, Array]:
    """Return σ_v/(2πσ_q) exp(−a²/2σ_q²) at the levels a, and errors; ``q`` and ``v`` are σ_q, σ_v.

    ``relative`` is the error of the variances.
    """
    square = (at / q) ** 2
    values = v / (2.0 * np.pi * q) * np.exp(-0.5 * square)
    return values, values * (relative + 4.0 * EPS) * (1.0 + 0.5 * square)


def eigenvalue_sums(system: System, count: int) -> tuple[Complexes, Array]:
    """Return the ``count`` eigenvalues of −L with the least positive real parts, and their errors.

    They are Σ n_j μ_j, n_j = 0, 1, …, with μ those of minus the drift matrix: the products of j
    left eigenvectors with the state are eigenfunctions of L but for terms of lower degree. One of
    a conjugate pair stands for both. The error is that of a change of the drift matrix by its
    round-off, by the condition of each eigenvalue; of one that is double it is the square root.
    """
    n = system.n
    A = _modal_drift(system)
    decomposed: Any = eig(-A, left=True, right=True)
    mu, left, right = decomposed
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    rounding = 2 * n * EPS
    change = rounding / np.maximum(overlap, np.sqrt(rounding))
    error = float(np.linalg.norm(A, 2)) * change
    # LAPACK has conjugate pairs side by side.
    first = np.flatnonzero(mu.imag > 0.0)
    second = np.flatnonzero(mu.imag < 0.0)
    partner = np.arange(2 * n)
    partner[first], partner[second] = second, first

    def stands_for_both(terms: list[int]) -> bool:
        value = mu[list(terms)].sum()
        if abs(value.imag) > np.sqrt(EPS) * abs(value):
            return bool(value.imag > 0.0)
        return sorted(terms) <= sorted(partner[list(terms)])

    # Sums in the order of their real parts: a longer one has one more eigenvalue, none before its
    # last in this order of all.
    order = [int(j) for j in np.argsort(mu.real)]
    heap: list[tuple[float, tuple[int, ...]]] = [
        (float(mu[j].real), (place,)) for place, j in enumerate(order)
    ]
    sums: list[list[int]] = []
    while len(sums) < count:
        real, places = heapq.heappop(heap)
        terms = [order[place] for place in places]
        if stands_for_both(terms):
            sums.append(terms)
        for place in range(places[-1], 2 * n):
            heapq.heappush(heap, (real + float(mu[order[place]].real), (*places, place)))
    return np.array([mu[terms].sum() for terms in sums]), np.array([error[t].sum() for t in sums])
