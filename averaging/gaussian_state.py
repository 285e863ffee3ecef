"""A Gaussian state and the densities of its energy, displacements and momenta."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from averaging.gamma_sum import gamma_density, gamma_sum
from fpk.arrays import EPS, Array
from fpk.certificate import Measured
from fpk.density import Density, certified_density
from fpk.observable import Observable

REACH = 8.5
"""Half-width of the support in standard deviations."""
TAIL = 1.9e-17
"""Probability of one coordinate beyond ``REACH`` on both sides, erfc(8.5/√2)."""
WIDTH = 3.0
"""Largest width of a panel in standard deviations of one coordinate given the other."""
PANELS = (17, 120)
"""Least and largest number of panels along an axis; correlations above 0.999 would need more."""
ENERGY_TAIL = 4e-18
"""Bound of the probability beyond the last energy of the support."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Gaussian state (q, p) = F ξ, ξ independent standard normal, whose energy is Σ λ_j G_j.

    ``factor`` F (2n, k): F Fᵀ is the covariance, known to ``relative_error`` as a quadratic form.
    ``scales`` λ_j, known to ``scale_errors``, of independent gamma variables G_j of the ``shape``.
    ``residual`` is that of the equation which the covariance solves.
    """

    factor: Array
    relative_error: float
    scales: Array
    shape: float
    scale_errors: Array
    residual: float

    def density(self, observable: Observable, *, tol: float) -> Density:
        """Return the density of the energy H, or of one or two of (q, p)."""
        if observable[0].kind == "H":
            return self._energy_density(observable, tol)
        count = len(observable)
        rows = self.factor[state_rows(observable, self.factor.shape[0] // 2)]
        scale = np.linalg.norm(rows, axis=1)
        # x/scale = L y with independent standard y: L of the rows' QR.
        L = np.asarray(qr((rows / scale[:, None]).T, mode="r")[0][:count].T)
        # Round-off of the rows counts by the condition of L.
        relative = self.relative_error + 8.0 * EPS * rows.shape[1] * float(np.linalg.cond(L))
        height = (2.0 * np.pi) ** (-0.5 * count) / abs(float(np.prod(np.diag(L)) * np.prod(scale)))
        width = WIDTH * float(np.min(np.abs(np.diag(L))))
        panels = int(np.clip(np.ceil(2.0 * REACH / width), *PANELS))

        def half_square(x: Sequence[Array]) -> Array:
            z = np.stack(np.broadcast_arrays(*x))
            y = solve_triangular(L, z.reshape(count, -1) / scale[:, None], lower=True)
            return np.asarray(0.5 * np.sum(y * y, axis=0).reshape(z.shape[1:]))

        def pointwise(*x: Array) -> Array:
            # d ln p = ½ yᵀ E y − ½ tr E, where E = L⁻¹ dR L⁻ᵀ is at most ``relative`` in norm.
            exponent = half_square(x)
            return np.asarray(relative * (exponent + 0.5 * count) * height * np.exp(-exponent))

        tail = TAIL * count
        return certified_density(
            observable,
            tuple(np.linspace(-REACH * s, REACH * s, panels + 1) for s in scale),
            lambda *x: height * np.exp(-half_square(x)),
            pointwise,
            measured=Measured(count * relative + tail, np.nan, np.inf, self.residual, tail),
            tol=tol,
            # The mass is measured at x = scale L y, where no correlation makes a ridge.
            frame=(scale[:, None] * L, (np.linspace(-REACH, REACH, PANELS[0] + 1),) * count),
        )

    def _energy_density(self, observable: Observable, tol: float) -> Density:
        largest = float(np.max(self.scales))
        # Chernoff's bound at s = 7/8 of the least rate: P(X > E) <= e^(−sE) Π (1 − s λ_j)^−shape.
        s = 0.875 / largest
        end = float(-np.log(ENERGY_TAIL) - self.shape * np.sum(np.log1p(-s * self.scales))) / s
        nodes, least = [0.0], max(float(np.min(self.scales)), EPS * end)
        while nodes[-1] < end:
            nodes.append(nodes[-1] + min(max(2.0 * least, nodes[-1] / 3.0), 2.0 * largest))

        def error(energy: Array) -> Array:
            return gamma_sum(self.scales, self.shape, self.scale_errors, energy)[1]

        return certified_density(
            observable,
            (np.array([*nodes[:-1], end]),),
            lambda energy: gamma_density(self.scales, self.shape, energy),
            error,
            measured=Measured(ENERGY_TAIL, np.nan, np.inf, self.residual, ENERGY_TAIL),
            tol=tol,
            added_error=lambda p, energy: error(energy),
        )


def state_rows(observable: Observable, n: int) -> list[int]:
    """Return where the coordinates of ``observable`` stand in (q, p) of n masses."""
    return [c.row + (n if c.kind == "p" else 0) for c in observable]
