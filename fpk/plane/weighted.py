"""Densities of two energies p = w u on a tensor mesh."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fpk.plane.elements import gauss_rule, shapes_at_gauss
from fpk.piecewise import PiecewiseTensor
from fpk.plane.elements import by_element, gauss_energies
from fpk.plane.mesh import Nodes
from fpk.plane.weight import Weight

Array = NDArray[np.float64]

ROUND_OFF = 4e-16
"""Relative round-off of a sum of shape functions, per square of their degree."""


@dataclass(frozen=True, eq=False)
class WeightedPolynomial:
    """p = w u: u a continuous piecewise polynomial, w = 1 without a ``weight``."""

    u: PiecewiseTensor
    weight: Weight | None = None

    @classmethod
    def of_shapes(cls, nodes: Nodes, coefficients: Array, weight: Weight | None) -> Self:
        """Return p by ``coefficients`` (elements, degree + 1, degree + 1) of shape functions.

        The elements run along H2 fastest.
        """
        series = _legendre_series(coefficients.shape[-1] - 1)
        panels = (nodes[0].size - 1, nodes[1].size - 1)
        legendre = (series.T @ coefficients @ series).reshape(*panels, *coefficients.shape[1:])
        return cls(PiecewiseTensor(nodes, legendre), weight)

    @property
    def nodes(self) -> Nodes:
        """Energies along each axis between which p is smooth."""
        return self.u.nodes

    @property
    def degree(self) -> int:
        """Degree of u along each axis."""
        return int(self.u.coefficients.shape[-1]) - 1

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.degree + 1 for x in self.nodes)
        return first * second

    def __call__(self, H1: Array, H2: Array) -> Array:
        """p at energies that broadcast together; 0 outside the mesh."""
        u = self.u(H1, H2)
        return u if self.weight is None else u * self.weight(np.asarray(H1), np.asarray(H2))

    def at_gauss(self, rule: int) -> Array:
        """p (elements, points, points) at the Gauss points that go with degree ``rule``."""
        H1, H2 = gauss_energies(self.nodes, rule)
        return by_element(self(H1.reshape(-1, 1), H2.ravel()), len(H1), len(H2))

    def rounding(self, H1: Array, H2: Array) -> Array:
        """Relative round-off of p at energies that broadcast together."""
        own = np.full(np.broadcast_shapes(H1.shape, H2.shape), ROUND_OFF * self.degree**2)
        return own if self.weight is None else own + ROUND_OFF * self.weight.terms(H1, H2)


@lru_cache
def _legendre_series(degree: int) -> Array:
    """Shape functions (degree + 1, degree + 1) as Legendre series on their interval."""
    t, w = gauss_rule(degree)
    series = shapes_at_gauss(degree, degree)[0] @ (w[:, None] * legvander(2.0 * t - 1.0, degree))
    return np.asarray(series * (2.0 * np.arange(degree + 1) + 1.0))
