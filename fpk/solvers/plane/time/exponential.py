"""Actions of exp(t A) by shift-and-invert Krylov spaces, one for times of like size."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from fpk.numeric.arrays import EPS, Array
from fpk.solvers.plane.elements import factorised

RATIO = 30.0
"""Largest over smallest time of one Krylov space."""
POLE = 0.03
"""Shift γ over the largest time. A rational function of one such pole approximates e^(−x) on the
whole half-axis with an error that falls by (√2 − 1) a degree (Andersson 1981), on any mesh."""
KRYLOV = 1e-2
"""Fraction of the tolerance of an answer to which e^(tA) is computed."""
GROWN = 8
"""Dimensions by which a space grows; the answer without the last ones gives the error."""
MOST = 160
"""Largest dimension."""


class Evolved(NamedTuple):
    """g at times (times, unknowns), its change by the last ``GROWN`` dimensions, its round-off.

    That is relative (times,) in the norm ∫ w g²; ``residual`` is the largest of the linear systems.
    """

    values: Array
    change: Array
    rounding: Array
    residual: float


def relative_residual(matrix: csc_array, sizes: csc_array, x: Array, right: Array) -> float:
    """Return the largest entry of ``right − matrix x`` over the largest term, sizes |matrix|."""
    defect = np.abs(right - matrix @ x)
    return float(np.max(defect) / (np.max(np.abs(right)) + np.max(sizes @ np.abs(x))))


def evolved(A: csc_array, M: csc_array, dual: Array, times: Array, *, tol: float) -> Evolved:
    """Return g = e^(t M⁻¹A) M⁻¹ ``dual`` at ascending ``times`` > 0, to ``tol`` of its norm ∫ w g².

    The eigenvalues of (M − γA)⁻¹ M give slow rates to round-off/γ, at large times to their digits.
    """
    start = factorised(M).solve(dual)
    residuals, parts, first = [relative_residual(M, abs(M), start, dual)], [], 0
    while first < times.size:
        last = int(np.searchsorted(times, RATIO * times[first], side="right"))
        parts.append(_of_group(A, M, start, times[first:last], tol))
        first = last
    *arrays, own = zip(*parts, strict=True)
    values, change, rounding = map(np.concatenate, arrays)
    return Evolved(values, change, rounding, float(np.max([*residuals, *own])))


def _of_group(A: csc_array, M: csc_array, start: Array, times: Array, tol: float) -> Evolved:
    gamma = POLE * float(times[-1])
    matrix = (M - gamma * A).tocsc()
    factors, sizes = factorised(matrix), abs(matrix)
    # Whether A x and Aᵀ x agree up to round-off for an x of random signs.
    x = np.random.default_rng(0).choice([-1.0, 1.0], A.shape[0])
    symmetric = bool(np.max(np.abs(A @ x - A.T @ x)) <= 1e-13 * np.max(np.abs(A.data)))
    V, MV = np.empty((MOST, start.size)), np.empty((MOST, start.size))
    H, residuals, norm = np.zeros((MOST, MOST)), [0.0], float(np.sqrt(start @ (M @ start)))
    V[0], MV[0] = start / norm, (M @ start) / norm
    for k in range(1, MOST):
        v = factors.solve(MV[k - 1])
        if k % GROWN == 1:
            residuals.append(relative_residual(matrix, sizes, v, MV[k - 1]))
        before = float(np.sqrt(v @ (M @ v)))
        for _ in range(2):
            along = MV[:k] @ v
            H[:k, k - 1] += along
            v = v - along @ V[:k]
        Mv = M @ v
        H[k, k - 1] = size = float(np.sqrt(v @ Mv))
        if size <= 1e-12 * before:  # round-off: the space is complete
            more, rounding, norms = _reduced(H[:k, :k], times, gamma, symmetric)
            change = np.zeros_like(more)
            break
        V[k], MV[k] = v / size, Mv / size
        if k + 1 >= 3 * GROWN and (k + 1) % GROWN == 0:
            more, rounding, norms = _reduced(H[:k, :k], times, gamma, symmetric)
            less, *_ = _reduced(H[: k - GROWN, : k - GROWN], times, gamma, symmetric)
            change = more.copy()
            change[:, : k - GROWN] -= less
            if float(np.max(np.linalg.norm(change, axis=1) / norms)) <= tol or k + GROWN >= MOST:
                break
    return Evolved(
        norm * more @ V[: more.shape[1]],
        norm * change @ V[: more.shape[1]],
        rounding / norms,
        float(np.max(residuals)),
    )


def _reduced(H: Array, times: Array, gamma: float, symmetric: bool) -> tuple[Array, Array, Array]:
    """e^(tA) of the first basis vector (times, m), A = (1 − S⁻¹)/γ, its round-off and norms."""
    condition = 1.0
    if symmetric:
        s, X = np.linalg.eigh(0.5 * (H + H.T))
        first = X[0]
    else:
        s, X = np.linalg.eig(H)
        condition = float(np.linalg.cond(X))
        first = np.linalg.solve(X, np.eye(len(H))[0])
    # Of s below 1e-3 the factor e^(t(1 − 1/s)/γ) is e^−1100 by t/γ > 1/(RATIO · POLE) = 1.1.
    live = np.abs(s) > 1e-3
    rate = (1.0 - 1.0 / s[live]) / gamma
    # No mode grows, but the numerical range of a small space leans into the right half plane.
    rate = np.minimum(rate.real, 0.0) + 1j * rate.imag
    values = ((np.exp(np.outer(times, rate)) * first[live]) @ X[:, live].T).real
    # What has decayed has no error of its own.
    norms = np.maximum(np.linalg.norm(values, axis=1), 1e-200)
    # Eigenvectors are known to ε over the gaps of s, those of slow modes γ/t.
    return values, EPS * condition * (1.0 + times / gamma), norms
