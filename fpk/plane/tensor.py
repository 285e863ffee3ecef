"""Piecewise polynomials of two energies on a tensor mesh, with a weight or without."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fpk.line.elements import gauss_rule, shapes_at_gauss
from fpk.plane.elements import gauss_energies
from fpk.plane.weight import Weight

Array = NDArray[np.float64]
Nodes = tuple[Array, Array]

ROUND_OFF = 4e-16
CHUNK = 8192


@dataclass(frozen=True, eq=False)
class TensorPolynomial:
    """Continuous piecewise polynomial of two energies on a tensor mesh, times w if there is one.

    ``nodes`` along each axis; ``coefficients`` (elements, degree+1, degree+1), the elements running
    along H2 fastest, of products of line shape functions.
    """

    nodes: Nodes
    degree: int
    coefficients: Array
    weight: Weight | None = None

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.degree + 1 for x in self.nodes)
        return first * second

    def rounding(self, H1: Array, H2: Array) -> Array:
        """Relative round-off of p at energies that broadcast together."""
        own = np.full(np.broadcast_shapes(H1.shape, H2.shape), ROUND_OFF * self.degree**2)
        return own if self.weight is None else own + ROUND_OFF * self.weight.terms(H1, H2)

    def __call__(self, H1: Array, H2: Array) -> Array:
        """Values at energies that broadcast together; 0 outside the mesh."""
        x, y = np.asarray(H1, float), np.asarray(H2, float)
        if x.ndim == 2 and x.shape[1] == 1 and y.ndim <= 2 and y.shape[-1:] == (y.size,):
            return self._on_grid(x.ravel(), y.ravel())
        if y.ndim == 2 and y.shape[1] == 1 and x.ndim <= 2 and x.shape[-1:] == (x.size,):
            return self._on_grid(x.ravel(), y.ravel()).T
        x, y = np.broadcast_arrays(x, y)
        flat = np.empty(x.size)
        for start in range(0, x.size, CHUNK):
            part = slice(start, start + CHUNK)
            flat[part] = self._at(x.ravel()[part], y.ravel()[part])
        return flat.reshape(x.shape)

    def at_gauss(self, rule: int) -> Array:
        """Values (elements, points, points) at the Gauss points that go with degree ``rule``."""
        phi, _ = shapes_at_gauss(self.degree, rule)
        u = np.asarray(phi.T @ self.coefficients @ phi)
        return u if self.weight is None else u * weight_at_gauss(self.weight, self.nodes, rule)[0]

    def _at(self, x: Array, y: Array) -> Array:
        (i, first), (j, second) = (self._shapes(axis, H) for axis, H in enumerate((x, y)))
        element = i * (self.nodes[1].size - 1) + j
        across = np.matmul(self.coefficients[element], second.T[:, :, None])[:, :, 0]
        value = np.asarray(np.sum(first.T * across, axis=1))
        return value if self.weight is None else value * self.weight.floored(x, y)

    def _on_grid(self, x: Array, y: Array) -> Array:
        """Values (x.size, y.size): one direction at a time."""
        k = self.degree + 1
        rows = []
        for axis, H in enumerate((x, y)):
            place, shapes = self._shapes(axis, H)
            full = np.zeros((H.size, self.nodes[axis].size - 1, k))
            full[np.arange(H.size), place] = shapes.T
            rows.append(full.reshape(H.size, -1))
        blocks = self.coefficients.reshape(*(n.size - 1 for n in self.nodes), k, k)
        matrix = blocks.transpose(0, 2, 1, 3).reshape(rows[0].shape[1], -1)
        value = np.asarray(rows[0] @ matrix @ rows[1].T)
        return value if self.weight is None else value * self.weight.floored(x[:, None], y)

    def _shapes(self, axis: int, H: Array) -> tuple[NDArray[np.int64], Array]:
        """Elements along an axis, and shape functions (degree + 1, points), 0 outside the mesh."""
        nodes = self.nodes[axis]
        k = np.clip(np.searchsorted(nodes, H, side="right") - 1, 0, nodes.size - 2)
        t = (H - nodes[k]) / (nodes[k + 1] - nodes[k])
        inside = (t >= 0.0) & (t <= 1.0)
        values = legvander(2.0 * np.clip(t, 0.0, 1.0) - 1.0, self.degree)
        return k, _in_legendre(self.degree) @ values.T * inside


@lru_cache
def _in_legendre(degree: int) -> Array:
    """Shape functions (degree + 1, degree + 1) as Legendre series on their interval."""
    t, w = gauss_rule(degree)
    series = shapes_at_gauss(degree, degree)[0] @ (w[:, None] * legvander(2.0 * t - 1.0, degree))
    return np.asarray(series * (2.0 * np.arange(degree + 1) + 1.0))


def weight_at_gauss(weight: Weight, nodes: Nodes, rule: int) -> tuple[Array, tuple[Array, Array]]:
    """w with its floor, and the slopes of −ln w, at Gauss points, (elements, points, points)."""
    H1, H2 = gauss_energies(nodes, rule)
    w, first, second = (
        by_element(values, H1.shape[0], H2.shape[0])
        for values in weight.floored_on_grid(H1.ravel(), H2.ravel())
    )
    return w, (first, second)


def by_element(values: Array, first: int, second: int) -> Array:
    """Values on the grid of the Gauss energies, as (elements, points, points)."""
    points = len(values) // first
    blocks = values.reshape(first, points, second, points).transpose(0, 2, 1, 3)
    return np.asarray(blocks.reshape(-1, points, points))
