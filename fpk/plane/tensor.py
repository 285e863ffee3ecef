"""Piecewise polynomials of two energies on a tensor mesh, times a weight or not."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fpk.line.elements import gauss_rule, shapes_at_gauss
from fpk.plane.elements import by_element, gauss_energies
from fpk.plane.mesh import Nodes
from fpk.plane.weight import Weight

Array = NDArray[np.float64]

ROUND_OFF = 4e-16
"""Round-off of a sum of shape functions, relative and per square of the degree."""
CHUNK = 8192
"""Scattered points evaluated at once: their element matrices of degree 20 take 30 MB."""


@dataclass(frozen=True, eq=False)
class TensorPolynomial:
    """p = w u: u a continuous piecewise polynomial on a tensor mesh, w = 1 without a ``weight``.

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
        """p at energies that broadcast together; 0 outside the mesh."""
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
        """p (elements, points, points) at the Gauss points that go with degree ``rule``."""
        phi, _ = shapes_at_gauss(self.degree, rule)
        u = np.asarray(phi.T @ self.coefficients @ phi)
        if self.weight is None:
            return u
        H1, H2 = gauss_energies(self.nodes, rule)
        w = self.weight(H1.reshape(-1, 1), H2.ravel())
        return u * by_element(w, len(H1), len(H2))

    def _at(self, x: Array, y: Array) -> Array:
        (i, first), (j, second) = (self._shapes(axis, H) for axis, H in enumerate((x, y)))
        element = i * (self.nodes[1].size - 1) + j
        across = np.matmul(self.coefficients[element], second.T[:, :, None])[:, :, 0]
        u = np.asarray(np.sum(first.T * across, axis=1))
        return u if self.weight is None else u * self.weight(x, y)

    def _on_grid(self, x: Array, y: Array) -> Array:
        """p (x.size, y.size), one direction at a time."""
        k = self.degree + 1
        rows = []
        for axis, H in enumerate((x, y)):
            interval, shapes = self._shapes(axis, H)
            full = np.zeros((H.size, self.nodes[axis].size - 1, k))
            full[np.arange(H.size), interval] = shapes.T
            rows.append(full.reshape(H.size, -1))
        blocks = self.coefficients.reshape(*(n.size - 1 for n in self.nodes), k, k)
        matrix = blocks.transpose(0, 2, 1, 3).reshape(rows[0].shape[1], -1)
        u = np.asarray(rows[0] @ matrix @ rows[1].T)
        return u if self.weight is None else u * self.weight(x[:, None], y)

    def _shapes(self, axis: int, H: Array) -> tuple[NDArray[np.int64], Array]:
        """Intervals of an axis, and shape functions (degree + 1, points), 0 outside the mesh."""
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
