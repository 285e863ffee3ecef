"""W3: two coupled energies whose density is exact by construction, and no exponential.

The diffusion is full, b = diag(2 d_i H_i) + 2 κ H Hᵀ: noise of each energy, and noise that
multiplies both. The density is a mixture, p = Σ_k share_k Π_i exp(−H_i/mean_ki)/mean_ki: one
energy is large or the other, and ln p is no polynomial. The drift makes it stationary, and
probability circulates, J = (∂ψ/∂H2, −∂ψ/∂H1), ψ = ω H1 H2 p, free of divergence and tangential to
the axes: s = ½ ∇·b + ½ b ∇ln p + J/p. All numbers were written down before any program had
solved it.
"""

from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from fpk.system.process import Coefficients, Process

Array = NDArray[np.float64]

NOISE = (1.0, 0.5)
"""d_i."""
COMMON = 0.25
"""κ."""
SWIRL = 0.3
"""ω."""
SHARES = np.array([0.6, 0.4])
MEANS = np.array([[1.0, 0.5], [0.4, 1.25]])
"""mean_ki, a row a part of the mixture."""


@dataclass(frozen=True)
class Mixture:
    """Two energies with full diffusion; see the words of this file."""

    name: str

    dimension = 2
    contact_energies = ()

    @property
    def temperature(self) -> Array:
        """The longest mean of each energy, how p falls off along its axis: boxes go by it."""
        return np.asarray(MEANS.max(axis=0))

    @cached_property
    def process(self) -> Process:
        """The same coefficients, as this program's solver asks for them."""

        def diffusion(energies: Array) -> Array:
            b = 2.0 * COMMON * energies[:, :, None] * energies[:, None, :]
            for i, noise in enumerate(NOISE):
                b[:, i, i] += 2.0 * noise * energies[:, i]
            return b

        def divergence(energies: Array) -> Array:
            return 2.0 * np.array(NOISE) + 6.0 * COMMON * energies

        def drift(energies: Array) -> Array:
            return self.coefficients(energies.T)[0].T

        return Process(
            lambda H: Coefficients(drift(H), diffusion(H), divergence(H)), tuple(SHARES @ MEANS)
        )

    def written(self, x, y, sigmoid):
        """Return (s_1, s_2), (b_11, b_22), Σ_j ∂b_ij/∂H_j and b_12, of arrays or symbols."""
        (a, b), (c, d) = (1.0 / MEANS).tolist()
        heights = SHARES / MEANS.prod(axis=1)
        first = sigmoid(log(heights[0] / heights[1]) - (a - c) * x - (b - d) * y)
        # H_i ∂ln p/∂H_i, with the share that the first part of the mixture has in p at a place.
        xu, yv = -x * (c + (a - c) * first), -y * (d + (b - d) * first)
        both = COMMON * (3.0 + xu + yv)
        drift = (
            NOISE[0] * (1.0 + xu) + x * both + SWIRL * x * (1.0 + yv),
            NOISE[1] * (1.0 + yv) + y * both - SWIRL * y * (1.0 + xu),
        )
        pairs = tuple(zip(NOISE, (x, y), strict=True))
        diffusion = tuple(2.0 * d * H + 2.0 * COMMON * H * H for d, H in pairs)
        divergence = tuple(2.0 * d + 6.0 * COMMON * H for d, H in pairs)
        return drift, diffusion, divergence, 2.0 * COMMON * x * y

    def coefficients(self, points: Array) -> tuple[Array, Array, Array]:
        """Return s_i, b_ii and Σ_j ∂b_ij/∂H_j at points (2, ...), each of that shape."""
        s, b, divergence, _ = self.written(*points, expit)
        return np.array(s), np.array(b), np.array(divergence)

    def cross(self, points: Array) -> Array:
        """b_12 at points (2, ...)."""
        return np.asarray(2.0 * COMMON * points[0] * points[1])

    def exact(self, points: Array) -> Array:
        """p(H1, H2) at points (2, ...)."""
        x, y = points
        parts = (
            share * np.exp(-x / first - y / second) / (first * second)
            for share, (first, second) in zip(SHARES, MEANS, strict=True)
        )
        return np.asarray(sum(parts))

    def tail(self, ends: tuple[float, ...]) -> float:
        """Return the probability outside the box."""
        beyond = np.exp(-np.array(ends) / MEANS)
        outside = beyond[:, 0] + beyond[:, 1] - beyond[:, 0] * beyond[:, 1]
        return float(SHARES @ outside)
