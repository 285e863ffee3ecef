"""The frame of two energies in time: weight, start, and meshes of rising resolution."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fpk.numeric.arrays import Array
from fpk.solvers.plane.solution import Nodes, PlaneSolution, gauss_grid
from fpk.solvers.plane.time.operator import PlaneOperator
from fpk.solvers.plane.weight import BEYOND
from fpk.system.process import Process

LEVELS = ((3, 7), (4, 9), (5, 11), (6, 13), (8, 14), (11, 15))
"""Panels along each axis and degree: about two digits more from one to the next."""
RISE = 3.0
"""Rise of −ln w from the far edges of one level to those of the next, whose difference then
contains what ending the mesh costs; and beyond the far edges up to which it is followed: in the
corner of a mesh it may rise by hundreds, and elements over which it rises by 40 have singular
matrices."""
MORE = 8
"""Gauss points, beyond those of the operator, of integrals of a density that is no polynomial."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A process of two energies, its stationary density, and the weight that goes with it."""

    process: Process
    stationary: PlaneSolution

    @property
    def balanced(self) -> bool:
        """Whether no probability flows, so that the weight itself is the stationary density."""
        return self.stationary.weight is not None and self.stationary.degree == 0

    @property
    def relative_error(self) -> float:
        """Relative error of the equation by that of a balanced weight, whose flux is dropped."""
        return self.stationary.relative_error if self.balanced else 0.0

    def heights(self, H1: Array, H2: Array) -> Array:
        """Return the rise of −ln w from its least value to energies (points,) each."""
        weight = self.stationary.weight
        return np.zeros(H1.shape) if weight is None else weight.exponent(H1, H2)

    def rise(self, tol: float, height: float, level: int) -> float:
        """Return the rise of −ln w from its least value beyond which p is negligible.

        From a start at which −ln w is ``height`` a density reaches w e^height at the most, up to a
        factor.
        """
        return height - float(np.log(BEYOND * tol)) + level * RISE

    def ends(self, rise: float) -> Array:
        """Return the energies (2,) beyond which −ln w exceeds ``rise``."""
        if self.stationary.weight is None:
            return np.array([x[-1] for x in self.stationary.nodes])
        return np.array(self.stationary.weight.ends(rise))

    def operators(
        self,
        nodes: Callable[[float, int], Nodes],
        *,
        tol: float,
        height: float = 0.0,
        share: float = 1.0,
        absorbing: tuple[bool, bool] = (False, False),
        collapsed: bool = False,
    ) -> Iterator[PlaneOperator]:
        """Yield operators, each finer than the last, on ``nodes(rise, panels)``.

        The weight is to the power ``share`` <= 1, and flat where −ln w would exceed the rise by
        ``RISE``.
        """
        weight, balanced = self.stationary.weight, self.balanced
        if weight is not None and share < 1.0:
            weight, balanced = replace(weight, coefficients=share * weight.coefficients), False
        for level, (panels, degree) in enumerate(LEVELS):
            rise = self.rise(tol, height, level)
            floor = float(np.exp(-share * (rise + RISE)))
            yield PlaneOperator(
                process=self.process,
                nodes=nodes(rise, panels),
                degree=degree,
                weight=weight and replace(weight, floor=floor),
                balanced=balanced,
                absorbing=absorbing,
                collapsed=collapsed,
            )


@dataclass(frozen=True, eq=False)
class PlaneStart:
    """Where two energies begin: at ``energies`` (2,), or with a ``density``.

    This is the stationary one under ``factor`` times the noise.
    """

    energies: Array | None = None
    density: PlaneSolution | None = None
    factor: float = 1.0

    @property
    def l1_error(self) -> float:
        """Estimate of the L1 error of the initial density, which no evolution increases."""
        return 0.0 if self.density is None else self.density.l1_error

    def height(self, frame: Frame) -> float:
        """Return the rise of −ln w from its least value to the energies; 0 for a density."""
        return 0.0 if self.energies is None else float(frame.heights(*self.energies[:, None])[0])

    def dual(self, op: PlaneOperator) -> Array:
        """Return φ at the energies, or ∫ p_0 φ over the domain, of the free unknowns."""
        if self.density is None:
            assert self.energies is not None
            return np.asarray(op.at(*self.energies[:, None])[0])
        (x, y), (v, w) = gauss_grid(op.nodes, op.points + MORE)
        H1, H2 = op.energies(x[:, None], y[None, :])
        p = self.density.density(H1, H2) * op.jacobian(x[:, None], y[None, :])
        rows = op.along(0, x).T @ (v[:, None] * p * w) @ op.along(1, y)
        return op.gathered(rows.reshape(-1))
