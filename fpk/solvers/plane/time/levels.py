"""The equation of two energies in time: its start, and operators of rising resolution."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fpk.numeric.arrays import Array
from fpk.solvers.plane.solution import Nodes, PlaneSolution, gauss_grid
from fpk.solvers.plane.time.operator import PlaneOperator
from fpk.solvers.plane.weight import BEYOND

LEVELS = ((3, 7), (4, 9), (5, 11), (6, 13), (8, 14), (11, 15))
"""Panels along each axis and degree: about two digits more from one to the next."""
RISE = 3.0
"""Rise of −ln w from the far edges of one level to those of the next, whose difference then
contains what ending the mesh costs; and beyond the far edges up to which it is followed: in the
corner of a mesh it may rise by hundreds, and elements over which it rises by 40 have singular
matrices."""
SHARE = 0.1
"""Share of the largest difference of two levels, anywhere, that is in every error: levels agree by
chance, too, as their difference crosses zero."""


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

    def height(self, stationary: PlaneSolution) -> float:
        """Return the rise of −ln w from its least value to the energies; 0 for a density."""
        if self.energies is None:
            return 0.0
        return float(stationary.heights(*self.energies[:, None])[0])

    def dual(self, op: PlaneOperator) -> Array:
        """Return φ at the energies, or ∫ p_0 φ over the domain, of the free unknowns."""
        if self.density is None:
            assert self.energies is not None
            return op.at(self.energies)
        (x, y), (v, w) = gauss_grid(op.nodes, op.points)
        p = self.density.density(*op.energies(x[:, None], y)) * op.jacobian(x[:, None], y)
        rows = op.along(0, x).T @ (v[:, None] * p * w) @ op.along(1, y)
        return op.gathered(rows.ravel())


def reach(tol: float, height: float, level: int = 0) -> float:
    """Return the rise of −ln w from its least value beyond which p is negligible.

    From a start at which −ln w is ``height`` a density reaches w e^height at the most, up to a
    factor.
    """
    return height - float(np.log(BEYOND * tol)) + level * RISE


def far_ends(stationary: PlaneSolution, rise: float) -> Array:
    """Return the energies (2,) beyond which −ln w exceeds ``rise``."""
    if stationary.weight is None:
        return np.array([x[-1] for x in stationary.nodes])
    return np.array(stationary.weight.ends(rise))


def operators(
    stationary: PlaneSolution,
    nodes: Callable[[float, int], Nodes],
    *,
    tol: float,
    height: float = 0.0,
    share: float = 1.0,
    absorbing: tuple[bool, bool] = (False, False),
    collapsed: bool = False,
) -> Iterator[PlaneOperator]:
    """Yield operators, each finer than the last, on ``nodes(rise, panels)``.

    The weight, that of the ``stationary`` density, is to the power ``share`` <= 1, and flat where
    −ln w would exceed the rise by ``RISE``.
    """
    weight, balanced = stationary.weight, stationary.balanced
    if weight is not None and share < 1.0:
        weight, balanced = replace(weight, coefficients=share * weight.coefficients), False
    for level, (panels, degree) in enumerate(LEVELS):
        rise = reach(tol, height, level)
        floored = weight and replace(weight, floor=float(np.exp(-share * (rise + RISE))))
        mesh = nodes(rise, panels)
        yield PlaneOperator(
            stationary.process, mesh, degree, floored, balanced, absorbing, collapsed
        )
