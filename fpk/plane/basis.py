"""Polynomials of one energy, orthonormal for a measure, by their three-term recurrence."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.compiling import kept

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Basis:
    """Polynomials of one energy, orthonormal for a measure.

    ``P_{k+1} = ((H − centre_k) P_k − spread_{k−1} P_{k−1}) / spread_k``, P_0 = 1.
    """

    centres: Array
    spreads: Array

    def values(self, H: Array) -> Array:
        """All polynomials at energies of any shape, (degree + 1, …)."""
        return self.with_slopes(H)[0]

    def with_slopes(self, H: Array) -> tuple[Array, Array]:
        """All polynomials and their slopes."""
        H = np.asarray(H, float)
        P, D = _with_slopes(self.centres, self.spreads, H.ravel().copy())
        return P.reshape(-1, *H.shape), D.reshape(-1, *H.shape)


def orthonormal(H: Array, measure: Array, degree: int) -> Basis:
    """Return the basis for point masses ``measure`` at ``H``, by Stieltjes' procedure."""
    return Basis(*_orthonormal(H.copy(), measure / measure.sum(), degree))


@kept()
def _orthonormal(H: Array, share: Array, degree: int) -> tuple[Array, Array]:
    """Centres and spreads (degree,) for the masses ``share`` of sum 1."""
    centres, spreads = np.empty(degree), np.empty(degree)
    before, now, spread = np.zeros(H.size), np.ones(H.size), 0.0
    for k in range(degree):
        centre, square = 0.0, 0.0
        for g in range(H.size):
            centre += share[g] * H[g] * now[g] ** 2
        for g in range(H.size):
            following = (H[g] - centre) * now[g] - spread * before[g]
            before[g], now[g] = now[g], following
            square += share[g] * following**2
        spread = np.sqrt(square)
        for g in range(H.size):
            now[g] /= spread
        centres[k], spreads[k] = centre, spread
    return centres, spreads


@kept()
def _with_slopes(centres: Array, spreads: Array, H: Array) -> tuple[Array, Array]:
    """All polynomials and their slopes at energies (points,), (degree + 1, points) each."""
    P, D = np.empty((centres.size + 1, H.size)), np.empty((centres.size + 1, H.size))
    P[0], D[0] = 1.0, 0.0
    for k in range(centres.size):
        last = spreads[k - 1] if k else 0.0
        for g in range(H.size):
            value, slope = H[g] - centres[k], P[k, g]
            P[k + 1, g] = (value * P[k, g] - last * P[max(k - 1, 0), g]) / spreads[k]
            D[k + 1, g] = (slope + value * D[k, g] - last * D[max(k - 1, 0), g]) / spreads[k]
    return P, D
