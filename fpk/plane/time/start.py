"""Starts of two energies, as functionals of the shape functions."""

from dataclasses import dataclass

import numpy as np

from fpk.arrays import Array
from fpk.plane.solution import PlaneSolution, gauss_grid
from fpk.plane.time.operator import PlaneOperator

MORE = 8
"""Gauss points, beyond those of the operator, of the integrals of an initial density."""


@dataclass(frozen=True, eq=False)
class PointStart:
    """Given energies (2,)."""

    energies: Array
    l1_error: float = 0.0

    def dual(self, op: PlaneOperator) -> Array:
        """Return φ at the start, of the free unknowns."""
        return np.asarray(op.at(self.energies[:1], self.energies[1:])[0])


@dataclass(frozen=True, eq=False)
class DensityStart:
    """The stationary density under ``factor`` times the noise."""

    density: PlaneSolution
    factor: float

    @property
    def l1_error(self) -> float:
        """Estimate of the L1 error of the initial density, which no evolution increases."""
        return self.density.l1_error

    def dual(self, op: PlaneOperator) -> Array:
        """Return ∫ p_0 φ over the domain, of the free unknowns."""
        (x, y), (v, w) = gauss_grid(op.nodes, op.points + MORE)
        H1, H2 = op.domain.energies(x[:, None], y[None, :])
        p = self.density.density(H1, H2) * op.domain.jacobian(x[:, None], y[None, :])
        rows = op.along(0, x).T @ (v[:, None] * p * w) @ op.along(1, y)
        return op.gathered(rows.reshape(-1))


Start = PointStart | DensityStart
