"""Moments of the first-passage time, the failure rate and the reliability on one mesh."""

from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.sparse import csc_array
from scipy.sparse.linalg import LinearOperator, eigs, splu

from averaging.phase_space.passage.elements import Elements
from fpk.arrays import Array
from fpk.errors import NotCertified

PIVOTS = (1e-3, 1e-2, 1.0)
"""Least diagonal pivots relative to their columns, tried in this order: lower ones keep more of the
symmetric ordering, and entries may grow by their inverse in each step."""
GROWN = 1e-10
"""Residual of a solution, relative to the terms that cancel in it, by which entries have grown."""
VECTORS, EVERY = 160, 10
"""Most vectors of the Krylov space of the reliability, and after how many it is looked at."""
SHIFT = 4.0
"""Shift of that space in units of the frequency: 2 to 8 take equally many vectors."""
KRYLOV = 0.05
"""Fraction of the tolerance to which that space gives the reliability."""
EIGENVALUE = 1e-13
"""Relative residual at which the iteration for the failure rate ends."""


def factorised(matrix: csc_array) -> Any:
    """Return the factors; raise ``NotCertified`` where the elimination breaks down."""
    right = matrix @ np.ones(matrix.shape[0])
    for pivot in PIVOTS:
        try:
            factors = splu(
                matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=pivot,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise NotCertified(f"the elimination breaks down: {error}") from None
        x = factors.solve(right)
        if np.max(np.abs(right - matrix @ x)) <= GROWN * np.max(abs(matrix) @ np.abs(x)):
            break
    return factors


@dataclass(frozen=True, eq=False)
class Solution:
    """Backward equation on ``elements``: L T = −1, L T₂ = −2 T, ∂u/∂t = L u."""

    elements: Elements

    @cached_property
    def factors(self) -> Any:
        """The factors of K."""
        return factorised(self.elements.K)

    @cached_property
    def mean(self) -> Array:
        """Coefficients of T up to a factor that is 1 but for round-off where failure is rare."""
        return self._solved(self.elements.load)

    def _solved(self, right: Array, trans: str = "N") -> Array:
        K = self.elements.K if trans == "N" else self.elements.K.T
        x = self.factors.solve(right, trans)
        return np.asarray(x + self.factors.solve(right - K @ x, trans))

    def residual(self) -> float:
        """Return the largest residual of T relative to the largest of its terms."""
        e = self.elements
        defect = np.abs(e.load - e.K @ self.mean)
        return float(np.max(defect) / np.max(abs(e.K) @ np.abs(self.mean)))

    def moments(self, start: Array) -> tuple[float, float, float]:
        """Return E T and E T² of the functional ``start``, and the mass that round-off lost.

        All that starts fails in the end: y'(−L 1) = start'1 with the density y = K⁻ᵀ start of the
        time spent. Where failure is rare K is nearly singular, and y is right up to a factor, that
        this identity gives back. What it is off from 1 is the mass lost, relative to all.
        """
        e = self.elements
        y = self._solved(start, "T")
        kept = float(y @ e.exit) / float(start @ (1.0 / e.scale))
        y /= kept
        mean = float(y @ e.load)
        second = 2.0 * float(y @ (e.M @ self.mean)) * mean / float(start @ self.mean)
        return mean, second, abs(kept - 1.0)

    def rate(self) -> float:
        """Return the least eigenvalue of −L, by the flow out of its left eigenvector."""
        e = self.elements
        size = e.load.size
        inverse = LinearOperator((size, size), matvec=lambda x: self.factors.solve(x, "T"))
        options: dict[str, Any] = {"v0": e.load, "ncv": min(12, size - 1), "tol": EIGENVALUE}
        _, y = eigs(e.K.T, k=1, M=e.M, sigma=0.0, OPinv=inverse, **options)
        y = y[:, 0] / y[np.argmax(np.abs(y[:, 0])), 0]
        return float(np.real(y @ e.exit) / np.real(y @ e.load))

    @cached_property
    def sigma(self) -> float:
        """A rate of the order of the frequency, less where damping outdoes it."""
        mesh = self.elements.mesh
        frequency = pi / mesh.oscillator.travel(mesh.radius)
        return (
            SHIFT * frequency / (1.0 + mesh.oscillator.damping / (mesh.oscillator.mass * frequency))
        )

    @cached_property
    def shifted(self) -> Any:
        """The factors of K + σM."""
        return factorised(csc_array(self.elements.K + self.sigma * self.elements.M))

    def mass_defect(self, start: Array) -> float:
        """Return what is wrong with the mass at a time of exponential distribution, the mean 1/σ.

        By its density σ (K + σM)⁻ᵀ start, what is within and what has left add up to ``start``.
        """
        e, one = self.elements, 1.0 / self.elements.scale
        y = self.shifted.solve(start, "T")
        return abs(float(y @ (self.sigma * (e.M @ one) + e.exit) - start @ one))

    def failure(self, start: Array, times: Array, *, tol: float) -> tuple[Array, Array]:
        """Return P(T <= t) at ascending times > 0, and what the last vectors changed.

        M F' = −K F + exit from F = 0, so that what is small keeps its digits. Galerkin's method on
        the Krylov space of (K + σM)⁻¹M from the function 1, which F tends to, orthonormal in M: as
        K + Kᵀ is not negative, neither is its projection, and nothing grows. At H = E, where there
        are no unknowns, F is 1: what that adds within the last panels is constant.
        """
        e, v = self.elements, 1.0 / self.elements.scale
        at_limit = 1.0 - float(start @ v)
        Mv, Kv = e.M @ v, e.K @ v
        length = np.sqrt(v @ Mv)
        V, MV, KV = (np.empty((VECTORS, e.load.size)) for _ in range(3))
        last = np.full(times.size, np.inf)
        change = before = last
        for n in range(VECTORS):
            v, Mv, Kv = v / length, Mv / length, Kv / length
            V[n], MV[n], KV[n] = v, Mv, Kv
            if (n + 1) % EVERY == 0:
                H, g = V[: n + 1] @ KV[: n + 1].T, V[: n + 1] @ start
                values = at_limit + _projected(H, V[: n + 1] @ e.exit, g, times)
                before, change, last = change, np.abs(values - last), values
                enough = tol * min(1.0, float(np.max(np.abs(values))))
                if np.max(change) <= KRYLOV * enough and np.max(before) <= enough:
                    break
            v = self.shifted.solve(Mv)
            Kv, Mv, parts = e.K @ v, e.M @ v, np.zeros(n + 1)
            for _ in range(2):
                more = MV[: n + 1] @ v
                v -= more @ V[: n + 1]
                parts += more
            Mv, Kv = Mv - parts @ MV[: n + 1], Kv - parts @ KV[: n + 1]
            length = np.sqrt(v @ Mv)
        return last, np.maximum(change, KRYLOV * before)


def _projected(H: Array, source: Array, g: Array, times: Array) -> Array:
    """g'F of F' = −H F + source from F = 0, step by step from one time to the next."""
    size = g.size
    system = np.zeros((size + 1, size + 1))
    system[:size, :size], system[:size, size] = -H, source
    values, F, now, step, propagator = np.empty(times.size), np.zeros(size + 1), 0.0, 0.0, system
    F[size] = 1.0
    for k, t in enumerate(times):
        if k == 0 or abs(t - now - step) > 1e-13 * t:
            step = t - now
            propagator = expm(step * system)
        F, now = propagator @ F, t
        values[k] = g @ F[:size]
    return values
