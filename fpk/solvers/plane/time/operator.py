"""The FPK operators of two energies in time on ever finer elements, with absorbing ends; starts.

With p = w g, w a weight near the stationary density, the weak forms of ∂p/∂t = L* p and of the
backward ∂u/∂t = L u are ``M ∂g/∂t = A g`` and ``M ∂u/∂t = Aᵀ u`` with
``A_ij = ∫ w (a φ_j − ½ b ∇φ_j)·∇φ_i``, ``a = s − ½ ∇·b + ½ b ∇ ln w`` and ``M_ij = ∫ w φ_i φ_j``.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, eye_array

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.quadrature import gauss_grid
from fpk.solvers.plane.elements import (
    Nodes,
    assemble,
    axis_numbers,
    element_matrices,
    flux_coefficients,
    local_numbers,
    shape_functions,
)
from fpk.solvers.plane.solution import PlaneSolution, gauss_points
from fpk.solvers.plane.weight import RISE, UNIT_WEIGHT, Weight, negligible_rise
from fpk.system.process import Process

PLANE_LEVELS = ((3, 7), (4, 9), (5, 11), (6, 13), (8, 14), (11, 15))
"""Panels along each axis and degree: about two digits more from one to the next."""
DISTANCE_SHARE = 0.1
"""Share of the largest difference of two levels, anywhere, in every error: it may cross zero."""


@dataclass(frozen=True, eq=False)
class PlaneOperator:
    """``M ∂g/∂t = A g`` with tensor elements of one ``degree`` between ``nodes`` of coordinates y.

    y = (H1, H2), or, ``collapsed``, (H, H1/H) with H = H1 + H2: of the triangle H < H_f. At H = 0
    that map is singular and the weak form is not, as b ~ H. ``balanced`` as of
    ``flux_coefficients``. ``absorbing`` says at which last nodes, along y_1 and y_2, g = 0: first
    passage. There one vertex function, that where w is largest, gives way to the sum of all of
    them, 1 but beside the limit: its matrix entries, as small as the failure rate, are then no
    difference of large ones.
    """

    process: Process
    nodes: Nodes
    degree: int
    weight: Weight = UNIT_WEIGHT
    balanced: bool = False
    absorbing: tuple[bool, bool] = (False, False)
    collapsed: bool = False

    def energies(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return H1 and H2 at coordinates."""
        return (first * second, first * (1.0 - second)) if self.collapsed else (first, second)

    def coordinates(self, H1: Array, H2: Array) -> tuple[Array, Array]:
        """Return the coordinates of energies; a share of ½ at H = 0, where no function knows it."""
        if not self.collapsed:
            return H1, H2
        H = H1 + H2
        return H, np.divide(H1, H, out=np.full(H.shape, 0.5), where=H > 0.0)

    def jacobian(self, first: Array, second: Array) -> Array:
        """Return |∂H/∂y|."""
        return first + 0.0 * second if self.collapsed else np.ones_like(first + second)

    def pulled_back(self, first: Array, second: Array, of_energies: Array) -> Array:
        """Return |∂H/∂y| times w, G w a and G w b Gᵀ (6, ...), G = ∂y/∂H: the weak form in y."""
        if not self.collapsed:
            return of_energies
        w, a1, a2, b11, b12, b22 = of_energies

        def share(along_1: Array, along_2: Array) -> Array:
            return np.asarray(((1.0 - second) * along_1 - second * along_2) / first)

        across = share(b11, b12), share(b12, b22)
        parts = [w, a1 + a2, share(a1, a2), b11 + 2.0 * b12 + b22, sum(across), share(*across)]
        return np.asarray(first * np.stack(parts))

    @property
    def points(self) -> int:
        """Gauss points per panel."""
        return gauss_points(self.nodes, self.degree, self.weight)

    @property
    def counts(self) -> tuple[int, int]:
        """Elements along each axis."""
        return self.nodes[0].size - 1, self.nodes[1].size - 1

    @property
    def sizes(self) -> tuple[int, int]:
        """Shape functions along each axis: those of the vertices first."""
        return self.counts[0] * self.degree + 1, self.counts[1] * self.degree + 1

    @cached_property
    def _vertices(self) -> Integers:
        """The shape functions (of all of them) that belong to a vertex, one row along H2 each."""
        first, second = (np.arange(count + 1) for count in self.counts)
        return np.asarray(first[:, None] * self.sizes[1] + second)

    @cached_property
    def functions(self) -> tuple[csc_array, csc_array, int]:
        """Trial and test functions as coefficients (all shape functions, unknowns), the pinned one.

        The vertex functions add up to 1, and 1 tested by A is 0: the sum of the free ones is tested
        as 1 less those held at zero by an absorbing end.
        """
        vertices, at_ends = self._vertices, np.zeros(self.sizes, dtype=bool)
        at_ends[self.counts[0]] |= self.absorbing[0]
        at_ends[:, self.counts[1]] |= self.absorbing[1]
        held = at_ends.ravel()
        free = np.flatnonzero(~held)
        trial: csc_array = eye_array(held.size, format="csc")[:, free]
        if not any(self.absorbing):
            return trial, trial, 0
        rise = self.weight.exponent(*self.energies(self.nodes[0][:, None], self.nodes[1]))
        rise[held[vertices]] = np.inf
        k = int(np.searchsorted(free, vertices.flat[np.argmin(rise)]))
        trial.data[k] = 0.0
        own, every = (
            csc_array((np.ones(rows.size), (rows, np.full(rows.size, k))), shape=trial.shape)
            for rows in (vertices[~held[vertices]], vertices.ravel())
        )
        return csc_array(trial + own), csc_array(trial + own - every), k

    @cached_property
    def matrices(self) -> tuple[csc_array, csc_array, Array]:
        """A and M of the free unknowns, and ∫ w φ of their functions."""
        (x, y), ((_, v), (_, u)) = gauss_grid(self.nodes, points=self.points)
        at, numbers = self.energies(x, y), local_numbers(self.nodes, self.degree)
        parts = flux_coefficients(self.process, *at, self.weight, balanced=self.balanced)
        parts = self.pulled_back(x, y, parts)
        A, M = (
            assemble(element_matrices(of, self.nodes, self.degree), numbers)
            for of in (parts[1:], parts[:1])
        )
        S, N, k = self.functions
        A = N.T @ A @ N
        if any(self.absorbing):
            # A times 1, ∫ w a·∇φ, is not taken as a sum that cancels.
            first, second = (self.along(axis, z.ravel()) for axis, z in enumerate((x, y)))
            slopes = [self.along(axis, z.ravel(), slope=True) for axis, z in enumerate((x, y))]
            area = v[:, None] * u
            flux = slopes[0].T @ (area * parts[1]) @ second
            flux += first.T @ (area * parts[2]) @ slopes[1]
            of_one = N.T @ flux.ravel()
            rows = np.flatnonzero(of_one)
            A += csc_array((of_one[rows], (rows, np.full(rows.size, k))), shape=A.shape)
        one = np.zeros(len(M.indptr) - 1)
        one[self._vertices] = 1.0
        return A.tocsc(), (S.T @ M @ S).tocsc(), S.T @ (M @ one)

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

    def spread(self, g: Array) -> Array:
        """Return the coefficients (..., *sizes) of all shape functions from free unknowns."""
        return np.asarray(g @ self.functions[0].T).reshape(*g.shape[:-1], *self.sizes)

    def largest(self, g: Array) -> Array:
        """Return the largest size (...) of functions at the vertices of the mesh."""
        at_vertices = self.spread(g)[..., : self.counts[0] + 1, : self.counts[1] + 1]
        return np.asarray(np.abs(at_vertices).max(axis=(-2, -1)))


@dataclass(frozen=True, eq=False)
class PlaneStart:
    """Energies (2,) that begin, or the stationary ``density`` under ``factor`` times the noise."""

    energies: Array | None = None
    density: PlaneSolution | None = None
    factor: float = 1.0

    @property
    def l1_error(self) -> float:
        """Estimate of the L1 error of the initial density, which no evolution increases."""
        return 0.0 if self.density is None else self.density.l1_error

    def height(self, stationary: PlaneSolution) -> float:
        """Return the rise of −ln w from its least value to the energies; 0 for a density."""
        return 0.0 if self.energies is None else float(stationary.weight.exponent(*self.energies))

    def dual(self, op: PlaneOperator) -> Array:
        """Return φ at the energies, or ∫ p_0 φ over the domain, of the free unknowns."""
        if self.density is None:
            assert self.energies is not None
            y, p = op.coordinates(*self.energies[:, None]), np.ones((1, 1))
        else:
            at, ((_, v), (_, w)) = gauss_grid(op.nodes, points=op.points)
            y, p = (at[0].ravel(), at[1].ravel()), v[:, None] * w * op.jacobian(*at)
            p *= self.density.density(*op.energies(*at))
        return np.asarray((op.along(0, y[0]).T @ p @ op.along(1, y[1])).ravel() @ op.functions[0])


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

    Their weight is the ``stationary`` one to the power ``share`` <= 1, and flat where −ln w would
    exceed the rise by ``RISE``, as elements over which it rises by 40 have singular matrices.
    """
    weight, balanced = stationary.weight, not stationary.degree and share == 1.0
    weight = replace(weight, coefficients=share * weight.coefficients)
    for level, (panels, degree) in enumerate(PLANE_LEVELS):
        rise = negligible_rise(tol, height, level)
        floored = replace(weight, floor=float(np.exp(-share * (rise + RISE))))
        yield PlaneOperator(
            stationary.process, nodes(rise, panels), degree, floored, balanced, absorbing, collapsed
        )
