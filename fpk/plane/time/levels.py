"""The frame of two energies in time: weight, balance, and meshes of rising resolution."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fpk.arrays import Array
from fpk.plane.solution import Nodes, PlaneSolution
from fpk.plane.time.domain import Domain, Rectangle
from fpk.plane.time.operator import PlaneOperator
from fpk.plane.weight import BEYOND, Weight
from fpk.process import Process

LEVELS = ((3, 7), (4, 9), (5, 11), (6, 13), (8, 14), (11, 15))
"""Panels along each axis and degree: about two digits more from one to the next."""
LENGTHENING = 3.0
"""Rise of −ln w from the far edges of one level to those of the next, whose difference then
contains what ending the mesh costs."""
MARGIN = 3.0
"""Rise of −ln w beyond that of the far edges up to which it is followed: in the corner of a mesh it
may rise by hundreds, and elements over which it rises by 40 have singular matrices."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A process of two energies, its stationary density, and the weight that goes with it."""

    process: Process
    stationary: PlaneSolution

    @cached_property
    def balanced(self) -> bool:
        """Whether no probability flows, so that the weight itself is the stationary density."""
        return self.stationary.weight is not None and self.stationary.degree == 0

    def tempered(self, share: float) -> tuple[Weight | None, bool]:
        """Return the weight to the power ``share`` <= 1, and whether it is the stationary one."""
        weight = self.stationary.weight
        if weight is None or share >= 1.0:
            return weight, self.balanced
        return replace(weight, coefficients=share * weight.coefficients), False

    @property
    def relative_error(self) -> float:
        """Relative error of the equation by that of a balanced weight, whose flux is dropped."""
        return self.stationary.relative_error if self.balanced else 0.0

    def heights(self, H1: Array, H2: Array) -> Array:
        """Return the rise of −ln w from its least value to energies (points,) each."""
        weight = self.stationary.weight
        return np.zeros(H1.shape) if weight is None else weight.exponent(H1, H2)

    def height(self, H1: float, H2: float) -> float:
        """Return the rise of −ln w from its least value to an energy."""
        return float(self.heights(np.array([H1]), np.array([H2]))[0])

    def rise(self, tol: float, height: float, level: int) -> float:
        """Return the rise of −ln w from its least value beyond which p is negligible.

        From a start at which −ln w is ``height`` a density reaches w e^height at the most, up to a
        factor.
        """
        return height - float(np.log(BEYOND * tol)) + level * LENGTHENING

    def ends(self, rise: float) -> Array:
        """Return the energies (2,) beyond which −ln w exceeds ``rise``."""
        if self.stationary.weight is None:
            return np.array([x[-1] for x in self.stationary.nodes])
        return np.array(self.stationary.weight.ends(rise))


def operators(
    frame: Frame,
    nodes: Callable[[float, int], Nodes],
    *,
    tol: float,
    height: float = 0.0,
    share: float = 1.0,
    absorbing: tuple[bool, bool] = (False, False),
    domain: Domain | None = None,
) -> Iterator[PlaneOperator]:
    """Yield operators, each finer than the last, on ``nodes(rise, panels)``.

    Where −ln w would exceed the rise by ``MARGIN`` the weight is flat.
    """
    weight, balanced = frame.tempered(share)
    for level, (panels, degree) in enumerate(LEVELS):
        rise = frame.rise(tol, height, level)
        floor = float(np.exp(-share * (rise + MARGIN)))
        yield PlaneOperator(
            process=frame.process,
            domain=domain or Rectangle(),
            nodes=nodes(rise, panels),
            degree=degree,
            weight=weight and replace(weight, floor=floor),
            balanced=balanced,
            absorbing=absorbing,
        )
