"""Starts and observables of the density p(H1, H2), as functionals of the shape functions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fpk.arrays import Array
from fpk.plane.solution import Nodes, PlaneSolution, gauss_grid, graded
from fpk.plane.time.operator import PlaneOperator
from fpk.quadrature import panel_rule

Seen = Literal["pair", "first", "second", "sum"]

SUM_PANELS, SUM_POINTS = 12, 8
"""Panels, equidistant in √H, and points of each, on which the density of H1 + H2 is measured."""
MORE = 8
"""Gauss points, beyond those of the operator, of the integrals of p over the energy not seen, and
of those of an initial density."""


@dataclass(frozen=True)
class View:
    """The coordinates of a density of two energies that are ``seen``."""

    seen: Seen

    def at(self, op: PlaneOperator, g: Array, points: tuple[Array, ...]) -> Array:
        """Return the densities (times, points) of g (times, n1, n2) at points (points,) each."""
        if self.seen == "pair":
            H1, H2 = points
            first, second = op.along(0, H1), op.along(1, H2)
            values = np.array([np.sum((first @ each) * second, axis=1) for each in g])
            return np.asarray(values * op.weight_at(H1, H2))
        rows = self._of_sum(op, points[0]) if self.seen == "sum" else self._of_one(op, points[0])
        return np.asarray(g.reshape(len(g), -1) @ rows.reshape(len(rows), -1).T)

    def grid(self, op: PlaneOperator) -> tuple[Nodes | tuple[Array], Array]:
        """Return axes of energies on which the density is integrated, and the weights there."""
        if self.seen == "sum":
            nodes = graded((op.nodes[0][-1] + op.nodes[1][-1], 1.0), SUM_PANELS)[0]
            x, w = panel_rule(nodes, SUM_POINTS)
            return (x.ravel(),), w.ravel()
        axes, (v, w) = gauss_grid(op.nodes, op.degree + 2)
        if self.seen == "pair":
            return axes, np.multiply.outer(v, w)
        axis = int(self.seen == "second")
        return (axes[axis],), (v, w)[axis]

    def on_grid(self, op: PlaneOperator, g: Array, axes: tuple[Array, ...]) -> Array:
        """Return the densities (times, *grid) of g (times, n1, n2) on the grid of ``axes``."""
        if self.seen != "pair":
            return self.at(op, g, axes)
        first, second = op.along(0, axes[0]), op.along(1, axes[1])
        return np.asarray((first @ g @ second.T) * op.weight_at(axes[0][:, None], axes[1]))

    def _of_one(self, op: PlaneOperator, energy: Array) -> Array:
        """∫ w φ_i ψ_j over the other energy (points, n1, n2)."""
        axis = int(self.seen == "second")
        y, v = (a.ravel() for a in panel_rule(op.nodes[1 - axis], op.points + MORE))
        own, other = op.along(axis, energy), op.along(1 - axis, y)
        H = (energy[:, None], y) if axis == 0 else (y, energy[:, None])
        inner = (op.weight_at(*H) * v) @ other
        rows = own[:, :, None] * inner[:, None, :]
        return rows if axis == 0 else np.swapaxes(rows, 1, 2)

    def _of_sum(self, op: PlaneOperator, energy: Array) -> Array:
        """∫ w φ_i(x) ψ_j(H − x) dx (points, n1, n2), cut where panels end."""
        rows = np.zeros((energy.size, *op.sizes))
        for row, H in zip(rows, energy, strict=True):
            if H <= 0.0:
                continue
            cuts = np.concatenate([op.nodes[0], H - op.nodes[1]])
            low, high = max(0.0, H - op.nodes[1][-1]), min(H, op.nodes[0][-1])
            if low >= high:
                continue
            nodes = np.unique(np.clip(cuts, low, high))
            x, v = (a.ravel() for a in panel_rule(nodes, op.points + MORE))
            factor = v * op.weight_at(x, H - x)
            row[...] = (op.along(0, x) * factor[:, None]).T @ op.along(1, np.maximum(H - x, 0.0))
        return rows


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
