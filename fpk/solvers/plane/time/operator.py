"""The FPK operator of two energies in time on high-order elements, with absorbing ends.

With p = w g, w a weight near the stationary density, the weak forms of ∂p/∂t = L* p and of the
backward ∂u/∂t = L u are ``M ∂g/∂t = A g`` and ``M ∂u/∂t = Aᵀ u`` with
``A_ij = ∫ w (a φ_j − ½ b ∇φ_j)·∇φ_i``, ``a = s − ½ ∇·b + ½ b ∇ ln w`` and ``M_ij = ∫ w φ_i φ_j``.
At H_i = 0, where the diffusion across vanishes, zero flux is natural; w is no approximation: any
weight gives the same p.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.sparse import csc_array

from fpk.numeric.arrays import Array, Flags, Integers
from fpk.solvers.plane.elements import (
    axis_numbers,
    by_element,
    element_matrices,
    local_order,
    mass_matrices,
    shape_functions,
)
from fpk.solvers.plane.solution import ENRICHMENT, WEIGHT_POINTS, Nodes, gauss_grid
from fpk.solvers.plane.weight import Weight
from fpk.system.process import Process


@dataclass(frozen=True, eq=False)
class PlaneOperator:
    """``M ∂g/∂t = A g`` with tensor elements of one ``degree`` between ``nodes`` of coordinates y.

    y = (H1, H2), or, ``collapsed``, (H, H1/H) with H = H1 + H2: of the triangle H < H_f. Where
    H = 0 that map is singular and the weak form is not: b ~ H, so that ∫ ½ b ∇u·∇u dH of a u that
    depends on the share H1/H alone is finite. ``balanced`` says that w without its floor is the
    stationary density and no probability flows: but for the floor a = 0 exactly. ``absorbing`` says
    at which last nodes, of the first and of the second coordinate, g = 0: first passage. There one
    vertex function, that where w is largest, gives way to the sum of all of them, which is 1 but
    beside the limit: its matrix entries are integrals beside the limit, as small as the failure
    rate, and computed as such, not as a difference of large ones.
    """

    process: Process
    nodes: Nodes
    degree: int
    weight: Weight | None = None
    balanced: bool = False
    absorbing: tuple[bool, bool] = (False, False)
    collapsed: bool = False

    def energies(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return H1 and H2 at coordinates."""
        x, y = np.broadcast_arrays(first, second)
        return (np.asarray(x * y), np.asarray(x * (1.0 - y))) if self.collapsed else (x, y)

    def coordinates(self, H1: Array, H2: Array) -> tuple[Array, Array]:
        """Return the coordinates of energies; a share of ½ at H = 0, where no function knows it."""
        H1, H2 = np.broadcast_arrays(H1, H2)
        if not self.collapsed:
            return H1, H2
        H = H1 + H2
        return H, np.divide(H1, H, out=np.full(H.shape, 0.5), where=H > 0.0)

    def jacobian(self, first: Array, second: Array) -> Array:
        """Return |∂H/∂y|."""
        x, _ = np.broadcast_arrays(first, second)
        return np.asarray(x) if self.collapsed else np.ones(x.shape)

    def pulled_back(self, first: Array, second: Array, F: Array, b: Array) -> tuple[Array, Array]:
        """Return G F and G b Gᵀ, G = ∂y/∂H: coefficients of ∫ (F u − ½ b ∇u)·∇v dH in y.

        The axes of energies are the last ones.
        """
        if not self.collapsed:
            return F, b
        H, x = np.broadcast_arrays(first, second)
        G = np.stack([np.ones_like(H), np.ones_like(H), (1.0 - x) / H, -x / H], axis=-1)
        G = G.reshape(*H.shape, 2, 2)
        return np.einsum("...ij,...j->...i", G, F), G @ b @ np.swapaxes(G, -1, -2)

    @property
    def points(self) -> int:
        """Gauss points per panel."""
        extra = 0 if self.weight is None else WEIGHT_POINTS // min(self.counts)
        return self.degree + ENRICHMENT + extra

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
        if self.weight is None:
            return int(vertices[0])
        i, j = np.unravel_index(self.free[vertices], self.sizes)
        H1, H2 = self.energies(self.nodes[0][i], self.nodes[1][j])
        return int(vertices[np.argmin(self.weight.exponent(H1, H2))])

    @cached_property
    def matrices(self) -> tuple[csc_array, csc_array, Array]:
        """A and M of the free unknowns, and ∫ w φ of their functions."""
        lengths = np.meshgrid(*(np.diff(x) for x in self.nodes), indexing="ij")
        sizes = np.stack([h.ravel() for h in lengths], axis=1)
        (x, y), (v, u) = gauss_grid(self.nodes, self.points)
        coefficients, w = self._coefficients(x[:, None], y[None, :])
        order, _ = local_order(self.degree)
        along = [axis_numbers(count, self.degree) for count in self.counts]
        flat = along[0][:, None, :, None] * self.sizes[1] + along[1][None, :, None, :]
        local = flat.reshape(len(sizes), -1)[:, order]
        m, total = local.shape[1], self._held.size
        places = np.repeat(local, m, axis=1).ravel(), np.tile(local, (1, m)).ravel()
        A, M = (
            csc_array((parts.ravel(), places), shape=(total, total))
            for parts in (
                element_matrices(by_element(coefficients, self.counts), sizes, self.degree),
                mass_matrices(by_element(w, self.counts), sizes, self.degree),
            )
        )
        vertices = self._vertices.astype(float)
        shares = np.asarray(M @ vertices)
        if self._pinned is None:
            return A, M, shares
        # A times 1, ∫ w a·∇φ of all shape functions, not as a sum that cancels.
        first, second = (self.along(k, z) for k, z in enumerate((x, y)))
        slopes = [self.along(k, z, slope=True) for k, z in enumerate((x, y))]
        area = v[:, None] * u
        flux = slopes[0].T @ (area * coefficients[0]) @ second
        flux = np.asarray(flux + first.T @ (area * coefficients[1]) @ slopes[1]).ravel()
        # The sum e of the free vertex functions is 1 − (that of the held ones, b).
        b = vertices * self._held
        rows, columns = -np.asarray(A.T @ b)[self.free], (flux - A @ b)[self.free]
        both = float(b @ (A @ b) - b @ flux)
        e = vertices - b
        Me, of_e = np.asarray(M @ e), float(e @ shares)
        shares = shares[self.free]
        shares[self._pinned] = of_e
        return (
            self._with_sum(self._pinned, A, rows, columns, both),
            self._with_sum(self._pinned, M, Me[self.free], Me[self.free], float(e @ Me)),
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

    def _coefficients(self, first: Array, second: Array) -> tuple[Array, Array]:
        """w a, w b_11, b_12, b_22 times |∂H/∂y|, pulled back (5, ...), and w |∂H/∂y|."""
        H1, H2 = self.energies(first, second)
        c = self.process.coefficients(np.stack([H1.ravel(), H2.ravel()], axis=1))
        b = c.diffusion.reshape(*H1.shape, 2, 2)
        # w, the slope ∇Φ of the weight without its floor, and the floor's share of w.
        w, slope, held = np.ones(H1.shape), np.zeros((*H1.shape, 2)), np.zeros(H1.shape)
        if self.weight is not None:
            phi, scales, floor = self.weight.coefficients, self.weight.scales, self.weight.floor
            x, y = H1 / scales[0], H2 / scales[1]
            w = np.exp(-polyval2d(x, y, phi)) + floor
            slopes = [polyval2d(x, y, polyder(phi, axis=k)) / scales[k] for k in (0, 1)]
            slope, held = np.stack(slopes, axis=-1), floor / w
        if self.balanced:
            # s − ½ ∇·b is −½ b ∇Φ: what is left is of the size of the floor, without cancellation.
            a = -0.5 * np.einsum("...ij,...j->...i", b, held[..., None] * slope)
        else:
            a = (c.drift - 0.5 * c.divergence).reshape(*H1.shape, 2)
            a = a + 0.5 * np.einsum("...ij,...j->...i", b, (1.0 - held)[..., None] * slope)
        a, b = self.pulled_back(first, second, a, b)
        of_y = w * self.jacobian(first, second)
        parts = [a[..., 0], a[..., 1], b[..., 0, 0], b[..., 0, 1], b[..., 1, 1]]
        return of_y * np.stack(parts), of_y

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
        y = self.coordinates(np.atleast_1d(H1), np.atleast_1d(H2))
        first, second = self.along(0, y[0]), self.along(1, y[1])
        return self.gathered((first[:, :, None] * second[:, None, :]).reshape(y[0].size, -1))

    def gathered(self, rows: Array) -> Array:
        """Return functionals (..., all shape functions) as those of the free unknowns."""
        free = rows[..., self.free].copy()
        if self._pinned is not None:
            free[..., self._pinned] = rows[..., self._vertices & ~self._held].sum(axis=-1)
        return free

    def spread(self, g: Array) -> Array:
        """Return the coefficients (..., *sizes) of all shape functions from free unknowns."""
        full = np.zeros((*g.shape[:-1], self._held.size))
        full[..., self.free] = g
        if self._pinned is not None:
            full[..., self.free[self._pinned]] = 0.0
            full[..., self._vertices & ~self._held] += g[..., self._pinned, None]
        return full.reshape(*g.shape[:-1], *self.sizes)

    def largest(self, g: Array) -> Array:
        """Return the largest size (...) of functions at the vertices of the mesh."""
        at_vertices = self.spread(g)[..., : self.counts[0] + 1, : self.counts[1] + 1]
        return np.asarray(np.abs(at_vertices).max(axis=(-2, -1)))
