"""FPK operators of two energies in time on finer and finer elements, absorbing edges, and starts.

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
from fpk.solvers.plane import elements as tensor
from fpk.solvers.plane.elements import Nodes
from fpk.solvers.plane.solution import PlaneSolution, gauss_points
from fpk.solvers.plane.weight import RISE, UNIT_WEIGHT, Weight, negligible_rise
from fpk.system.process import Process

PLANE_LEVELS = ((3, 7), (4, 9), (5, 11), (6, 13), (8, 14), (11, 15))
"""Panels along each axis and degree of successive levels; each gains about two digits."""
DISTANCE_SHARE = 0.1
"""Share of the largest difference of two levels that is added to the error at every point: the
local difference may cross zero."""


@dataclass(frozen=True, eq=False)
class PlaneOperator:
    """``M ∂g/∂t = A g`` on tensor elements of one ``degree`` between ``nodes`` of coordinates y.

    y = (H1, H2), or, if ``collapsed``, (H, H1/H) with H = H1 + H2, for the triangle H < H_f; at
    H = 0 this map is singular but the weak form is not, as b ~ H. ``balanced``: the ``weight``
    without its floor is the density of zero flux. ``absorbing``: whether g = 0 at the last
    nodes of y_1 and of y_2, for first passage. One vertex function, where w is largest, is then
    replaced by the sum of all free vertex functions, which is 1 except next to the limit: its
    matrix entries, as small as the failure rate, are then no differences of large numbers.
    """

    process: Process
    nodes: Nodes
    degree: int
    weight: Weight = UNIT_WEIGHT
    balanced: bool = False
    absorbing: tuple[bool, bool] = (False, False)
    collapsed: bool = False

    def energies(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return H1 and H2 at the coordinates y = (``first``, ``second``)."""
        return (first * second, first * (1.0 - second)) if self.collapsed else (first, second)

    def coordinates(self, H1: Array, H2: Array) -> tuple[Array, Array]:
        """Return the coordinates y of ``H1`` and ``H2``; at H = 0 H1/H has no effect, and is ½."""
        if not self.collapsed:
            return H1, H2
        H = H1 + H2
        return H, np.divide(H1, H, out=np.full(H.shape, 0.5), where=H > 0.0)

    def pulled_back(self, first: Array, second: Array, of_energies: Array) -> Array:
        """Return the coefficients of the weak form in y = (``first``, ``second``), (6, ...).

        They are |∂H/∂y| times w, G w a and G w b Gᵀ, with G = ∂y/∂H; ``of_energies`` (6, ...) are
        w, w a and w b of ``flux_coefficients``, and are returned if y = (H1, H2).
        """
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
        """Gauss points of an element along each axis."""
        return gauss_points(self.nodes, self.degree, self.weight)

    @property
    def counts(self) -> tuple[int, int]:
        """Number of elements along each axis."""
        return self.nodes[0].size - 1, self.nodes[1].size - 1

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of shape functions along each axis, vertex functions included."""
        return self.counts[0] * self.degree + 1, self.counts[1] * self.degree + 1

    @cached_property
    def _vertices(self) -> Integers:
        """Numbers of the vertex functions among all shape functions, (vertices, vertices)."""
        first, second = (np.arange(count + 1) for count in self.counts)
        return np.asarray(first[:, None] * self.sizes[1] + second)

    @cached_property
    def functions(self) -> tuple[csc_array, csc_array, int]:
        """Coefficients (shape functions, unknowns) of trial and test functions, and an unknown k.

        With an absorbing edge the k-th trial function is the sum of all free vertex functions. All
        vertex functions add up to 1, and A tested with 1 is 0: its test function is this sum minus
        1, the negative sum of the functions that the edge sets to 0. Else k = 0 has no meaning.
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
        """Sparse A (test, trial functions), M, and ∫ w φ (unknowns,) of the trial functions φ."""
        (x, y), ((_, v), (_, u)) = gauss_grid(self.nodes, points=self.points)
        at, numbers = self.energies(x, y), tensor.local_numbers(self.nodes, self.degree)
        parts = tensor.flux_coefficients(self.process, *at, self.weight, balanced=self.balanced)
        parts = self.pulled_back(x, y, parts)
        by_element = (
            tensor.element_matrices(f, self.nodes, self.degree) for f in (parts[1:], parts[:1])
        )
        A, M = (tensor.assemble(of, numbers) for of in by_element)
        S, N, k = self.functions
        A = N.T @ A @ N
        if any(self.absorbing):
            # A times 1, ∫ w a·∇φ, is integrated directly: as a sum of entries of A it cancels.
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
        """Return shape functions along ``axis`` at coordinates ``y`` (points,), or their slopes if
        ``slope``: (points, functions), 0 outside the nodes."""
        nodes, k = self.nodes[axis], self.degree
        panel = np.clip(np.searchsorted(nodes, y, side="right") - 1, 0, nodes.size - 2)
        t = (y - nodes[panel]) / (nodes[panel + 1] - nodes[panel])
        values = np.zeros((y.size, self.sizes[axis]))
        inside = ((y >= nodes[0]) & (y <= nodes[-1]))[:, None]
        phi = tensor.shape_functions(k, np.clip(t, 0.0, 1.0))[int(slope)].T * inside
        if slope:
            phi = phi / np.diff(nodes)[panel][:, None]
        np.put_along_axis(values, tensor.axis_numbers(nodes.size - 1, k)[panel], phi, axis=1)
        return values

    def spread(self, g: Array) -> Array:
        """Return coefficients (..., *sizes) of all shape functions from unknowns ``g`` (..., n)."""
        return np.asarray(g @ self.functions[0].T).reshape(*g.shape[:-1], *self.sizes)

    def largest(self, g: Array) -> Array:
        """Return the largest size (...), over all vertices, of functions with unknowns ``g``."""
        at_vertices = self.spread(g)[..., : self.counts[0] + 1, : self.counts[1] + 1]
        return np.asarray(np.abs(at_vertices).max(axis=(-2, -1)))


@dataclass(frozen=True, eq=False)
class PlaneStart:
    """Initial ``energies`` (2,), or the stationary ``density`` under ``factor`` times the noise
    intensity; the other is None."""

    energies: Array | None = None
    density: PlaneSolution | None = None
    factor: float = 1.0

    @property
    def l1_error(self) -> float:
        """Estimated L1 error of the initial density, which does not grow in time."""
        return 0.0 if self.density is None else self.density.l1_error

    def height(self, stationary: PlaneSolution) -> float:
        """Return −ln w at the initial energies, above its minimum; 0 for a density. w is the weight
        of the ``stationary`` solution."""
        return 0.0 if self.energies is None else float(stationary.weight.exponent(*self.energies))

    def dual(self, op: PlaneOperator) -> Array:
        """Return E φ (unknowns,) of the initial density, φ the trial functions of ``op``."""
        if self.density is None:
            assert self.energies is not None
            y, p = op.coordinates(*self.energies[:, None]), np.ones((1, 1))
        else:
            at, ((_, v), (_, w)) = gauss_grid(op.nodes, points=op.points)
            # |∂H/∂y| = H in collapsed coordinates.
            area = v[:, None] * w * (at[0] if op.collapsed else 1.0)
            y, p = (at[0].ravel(), at[1].ravel()), area * self.density.density(*op.energies(*at))
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
    """Yield operators on finer and finer meshes ``nodes(rise, panels)``, which end at −ln w = rise.

    The rise follows from ``tol`` and ``height`` by ``negligible_rise``. The weight is the weight of
    ``stationary`` to the power ``share`` <= 1, and constant where −ln w exceeds the rise by
    ``RISE``, as elements over which it rises by 40 have singular matrices. For ``absorbing`` and
    ``collapsed`` see ``PlaneOperator``.
    """
    weight, balanced = stationary.weight, not stationary.degree and share == 1.0
    weight = replace(weight, coefficients=share * weight.coefficients)
    for level, (panels, degree) in enumerate(PLANE_LEVELS):
        rise = negligible_rise(tol, height, level)
        floored = replace(weight, floor=float(np.exp(-share * (rise + RISE))))
        yield PlaneOperator(
            stationary.process, nodes(rise, panels), degree, floored, balanced, absorbing, collapsed
        )
