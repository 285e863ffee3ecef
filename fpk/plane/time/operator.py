"""The FPK operator of two energies in time on high-order elements, with absorbing ends.

With p = w g, w a weight near the stationary density, the weak forms of ∂p/∂t = L* p and of the
backward ∂u/∂t = L u are ``M ∂g/∂t = A g`` and ``M ∂u/∂t = Aᵀ u`` with
``A_ij = ∫ w (a φ_j − ½ b ∇φ_j)·∇φ_i``, ``a = s − ½ ∇·b + ½ b ∇ ln w`` and ``M_ij = ∫ w φ_i φ_j``.
At H_i = 0, where the diffusion across vanishes, zero flux is natural; w is no approximation: any
weight gives the same p.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.sparse import csc_array

from fpk.arrays import Array, Flags, Integers
from fpk.plane.condensation import axis_numbers, local_order
from fpk.plane.elements import by_element, element_matrices, mass_matrices, shape_functions
from fpk.plane.on_mesh import MORE_POINTS, WEIGHT_POINTS
from fpk.plane.solution import Nodes, gauss_grid
from fpk.plane.time.domain import Domain
from fpk.plane.weight import Weight
from fpk.process import Process


class Matrices(NamedTuple):
    """A and M of the free unknowns, and ∫ w φ of their functions."""

    A: csc_array
    M: csc_array
    shares: Array


@dataclass(frozen=True, eq=False)
class PlaneOperator:
    """``M ∂g/∂t = A g`` with tensor elements of one ``degree`` between ``nodes`` of a ``domain``.

    ``balanced`` says that w without its floor is the stationary density and no probability flows:
    but for the floor a = 0 exactly. ``absorbing`` says at which last nodes, of the first and of the
    second coordinate, g = 0: first passage. There one vertex function, that where w is largest,
    gives way to the sum of all of them, which is 1 but beside the limit: its matrix entries are
    integrals beside the limit, as small as the failure rate, and computed as such, not as a
    difference of large ones. ``more_points`` Gauss points are added along each axis.
    """

    process: Process
    domain: Domain
    nodes: Nodes
    degree: int
    weight: Weight | None = None
    balanced: bool = False
    absorbing: tuple[bool, bool] = (False, False)
    more_points: int = 0

    @property
    def points(self) -> int:
        """Gauss points per panel."""
        extra = 0 if self.weight is None else WEIGHT_POINTS // min(self.counts)
        return self.degree + MORE_POINTS + extra + self.more_points

    @property
    def counts(self) -> tuple[int, int]:
        """Elements along each axis."""
        return self.nodes[0].size - 1, self.nodes[1].size - 1

    @property
    def sizes(self) -> tuple[int, int]:
        """Shape functions along each axis: those of the vertices first."""
        first, second = (count * self.degree + 1 for count in self.counts)
        return first, second

    @cached_property
    def _held(self) -> Flags:
        """Whether a shape function (all of them) is held at zero by an absorbing end."""
        held = np.zeros(self.sizes, dtype=bool)
        held[self.counts[0]] |= self.absorbing[0]
        held[:, self.counts[1]] |= self.absorbing[1]
        return held.ravel()

    @cached_property
    def _vertices(self) -> Flags:
        """Whether a shape function (all of them) belongs to a vertex."""
        vertex = np.zeros(self.sizes, dtype=bool)
        vertex[: self.counts[0] + 1, : self.counts[1] + 1] = True
        return vertex.ravel()

    @cached_property
    def free(self) -> Integers:
        """The shape functions not held at zero."""
        return np.flatnonzero(~self._held)

    @cached_property
    def _pinned(self) -> int | None:
        """The free unknown that gives way to the sum of the vertex functions, if any is held."""
        if not any(self.absorbing):
            return None
        vertices = np.flatnonzero(self._vertices[self.free])
        y = np.unravel_index(self.free[vertices], self.sizes)
        first, second = self.domain.energies(self.nodes[0][y[0]], self.nodes[1][y[1]])
        if self.weight is None:
            return int(vertices[0])
        return int(vertices[np.argmin(self.weight.exponent(first, second))])

    @cached_property
    def matrices(self) -> Matrices:
        """The matrices of the free unknowns."""
        lengths = np.meshgrid(*(np.diff(x) for x in self.nodes), indexing="ij")
        sizes = np.stack([h.ravel() for h in lengths], axis=1)
        (x, y), _ = gauss_grid(self.nodes, self.points)
        coefficients, w = self._coefficients(x[:, None], y[None, :])
        order, _ = local_order(self.degree)
        of_A = element_matrices(by_element(coefficients, self.counts), sizes, self.degree)
        of_M = mass_matrices(by_element(w, self.counts), sizes, self.degree)
        along = [axis_numbers(count, self.degree) for count in self.counts]
        flat = along[0][:, None, :, None] * self.sizes[1] + along[1][None, :, None, :]
        local = flat.reshape(len(sizes), -1)[:, order]
        A, M = (self._assembled(local, parts) for parts in (of_A, of_M))
        vertices = self._vertices.astype(float)
        shares = np.asarray(M @ vertices)
        if self._pinned is None:
            return Matrices(A, M, shares)
        # The sum e of the free vertex functions is 1 − (that of the held ones, b).
        b = vertices * self._held
        flux = self._flux_of_one(coefficients)
        rows, columns = -np.asarray(A.T @ b)[self.free], (flux - A @ b)[self.free]
        both = float(b @ (A @ b) - b @ flux)
        e = (vertices - b)[self.free]
        Me = np.asarray(M @ (vertices - b))[self.free]
        shares = shares[self.free]
        shares[self._pinned] = float((vertices - b) @ (M @ vertices))
        return Matrices(
            self._with_sum(self._pinned, A, rows, columns, both),
            self._with_sum(self._pinned, M, Me, Me, float(e @ Me)),
            shares,
        )

    def _with_sum(
        self, k: int, matrix: csc_array, row: Array, column: Array, both: float
    ) -> csc_array:
        """The free part of a matrix with row and column of the pinned unknown ``k`` replaced."""
        free = matrix[:, self.free][self.free]
        free.data[free.indices == k] = 0.0
        free.data[slice(*free.indptr[[k, k + 1]])] = 0.0
        row, column = row.copy(), column.copy()
        row[k], column[k] = both, 0.0
        i, j = np.flatnonzero(column), np.flatnonzero(row)
        places = np.append(i, np.full(j.size, k)), np.append(np.full(i.size, k), j)
        return free + csc_array((np.append(column[i], row[j]), places), shape=free.shape)

    def _flux_of_one(self, coefficients: Array) -> Array:
        """∫ w a·∇φ of all shape functions: A times 1, not as a sum that cancels."""
        (x, y), (v, u) = gauss_grid(self.nodes, self.points)
        first, second = self.along(0, x), self.along(1, y)
        slopes = self.along(0, x, slope=True), self.along(1, y, slope=True)
        area = v[:, None] * u
        total = slopes[0].T @ (area * coefficients[0]) @ second
        return np.asarray(total + first.T @ (area * coefficients[1]) @ slopes[1]).ravel()

    def _assembled(self, local: Integers, parts: Array) -> csc_array:
        m = local.shape[1]
        rows, columns = np.repeat(local, m, axis=1).ravel(), np.tile(local, (1, m)).ravel()
        size = self.sizes[0] * self.sizes[1]
        return csc_array((parts.ravel(), (rows, columns)), shape=(size, size))

    def _coefficients(self, first: Array, second: Array) -> tuple[Array, Array]:
        """w a, w b_11, b_12, b_22 times |∂H/∂y|, pulled back (5, ...), and w |∂H/∂y|."""
        H1, H2 = self.domain.energies(first, second)
        c = self.process.coefficients(np.stack([H1.ravel(), H2.ravel()], axis=1))
        b = c.diffusion.reshape(*H1.shape, 2, 2)
        w, slope, held = self._weight_and_slope(H1, H2)
        if self.balanced:
            # s − ½ ∇·b is −½ b ∇Φ: what is left is of the size of the floor, without cancellation.
            a = -0.5 * np.einsum("...ij,...j->...i", b, held[..., None] * slope)
        else:
            a = (c.drift - 0.5 * c.divergence).reshape(*H1.shape, 2)
            a = a + 0.5 * np.einsum("...ij,...j->...i", b, (1.0 - held)[..., None] * slope)
        a, b = self.domain.pulled_back((first, second), a, b)
        of_y = w * self.domain.jacobian(first, second)
        return of_y * np.stack(
            [a[..., 0], a[..., 1], b[..., 0, 0], b[..., 0, 1], b[..., 1, 1]]
        ), of_y

    def _weight_and_slope(self, H1: Array, H2: Array) -> tuple[Array, Array, Array]:
        """w, the slope ∇Φ of the weight without its floor, and the floor's share of w."""
        if self.weight is None:
            return np.ones(H1.shape), np.zeros((*H1.shape, 2)), np.zeros(H1.shape)
        phi, scales, floor = self.weight.coefficients, self.weight.scales, self.weight.floor
        x, y = H1 / scales[0], H2 / scales[1]
        w = np.exp(-polyval2d(x, y, phi)) + floor
        slopes = [polyval2d(x, y, polyder(phi, axis=k)) / scales[k] for k in (0, 1)]
        return w, np.stack(slopes, axis=-1), floor / w

    def weight_at(self, H1: Array, H2: Array) -> Array:
        """Return w at energies that broadcast together."""
        H1, H2 = np.broadcast_arrays(H1, H2)
        return np.ones(H1.shape) if self.weight is None else self.weight(H1, H2)

    def along(self, axis: int, y: Array, *, slope: bool = False) -> Array:
        """Return the shape functions of one axis, or their slopes, at coordinates y; 0 outside."""
        nodes, k = self.nodes[axis], self.degree
        panel = np.clip(np.searchsorted(nodes, y, side="right") - 1, 0, nodes.size - 2)
        t = (y - nodes[panel]) / (nodes[panel + 1] - nodes[panel])
        values = np.zeros((y.size, self.sizes[axis]))
        inside = ((y >= nodes[0]) & (y <= nodes[-1]))[:, None]
        phi = shape_functions(k, np.clip(t, 0.0, 1.0))[int(slope)].T * inside
        if slope:
            phi = phi / np.diff(nodes)[panel][:, None]
        np.put_along_axis(values, axis_numbers(nodes.size - 1, k)[panel], phi, axis=1)
        return values

    def at(self, H1: Array, H2: Array) -> Array:
        """Return the functions of the free unknowns at points, (points, unknowns)."""
        y = self.domain.coordinates(np.atleast_1d(H1), np.atleast_1d(H2))
        first, second = self.along(0, y[0]), self.along(1, y[1])
        rows = (first[:, :, None] * second[:, None, :]).reshape(y[0].size, -1)
        return self.gathered(rows)

    def gathered(self, rows: Array) -> Array:
        """Return functionals (..., all shape functions) as those of the free unknowns."""
        free = rows[..., self.free].copy()
        if self._pinned is not None:
            free[..., self._pinned] = rows[..., self._vertices & ~self._held].sum(axis=-1)
        return free

    def vertex_values(self, g: Array) -> Array:
        """Return the values (..., vertices) of functions at the vertices of the mesh."""
        full = self.spread(g)
        return full[..., : self.counts[0] + 1, : self.counts[1] + 1].reshape(*g.shape[:-1], -1)

    def spread(self, g: Array) -> Array:
        """Return the coefficients (..., *sizes) of all shape functions from free unknowns."""
        full = np.zeros((*g.shape[:-1], self._held.size))
        full[..., self.free] = g
        if self._pinned is not None:
            e = self._vertices & ~self._held
            full[..., self.free[self._pinned]] = 0.0
            full[..., e] += g[..., self._pinned, None]
        return full.reshape(*g.shape[:-1], *self.sizes)
