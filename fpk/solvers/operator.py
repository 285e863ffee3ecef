"""The FPK equation of one or two energies in scikit-fem, its weak form written as the equation is.

``Operator`` has the matrices on a given mesh, ``solve_by_scikit_fem`` the stationary density on
meshes that are refined uniformly. The fast solvers of ``fpk.solvers.line`` and
``fpk.solvers.plane`` assemble the same equation in other ways, one element and one direction at a
time, and judge both answers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array
from skfem import Basis, MeshLine, MeshQuad
from skfem.element import ElementLineP1, ElementLineP2, ElementLinePp, ElementQuadP
from skfem.helpers import grad, mul

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import NotCertified
from fpk.numeric.piecewise import PiecewiseTensor, interpolated_tensor, projection
from fpk.numeric.quadrature import gauss_legendre
from fpk.solvers.line.mesh import GRADED_LAYERS, initial_nodes
from fpk.solvers.line.stationary import StationarySolution, solve_on_mesh
from fpk.solvers.plane.elements import null_vector
from fpk.solvers.plane.solution import Nodes, PlaneSolution
from fpk.solvers.plane.stationary import solve_by_elements
from fpk.solvers.plane.weight import Weight, flux_free_weight
from fpk.solvers.probe import probed
from fpk.system.ends import require_confined
from fpk.system.process import Process

MOST_ENTRIES = 1e5
"""Entries of all element matrices of one energy, beyond which no interval is halved."""
DEGREE = 6
"""Degree of the elements where none is given."""


def flux(u: Any, w: Mapping[str, Array]) -> Any:
    """J = T (F u − ½ b ∇u) of ∂p/∂t = −∇ · J, p = T u; the weak form is ∫ J · ∇v, Eqs. (9), (19).

    In the drift-diffusion form T = 1 and F = s − ½ ∇ · b, in the flux form F is the dissipation.
    """
    return w["states"] * (w["F"] * u - 0.5 * mul(w["b"], grad(u)))


@dataclass(frozen=True, eq=False)
class Operator:
    """``M ∂u/∂t = A u``: the FPK operator on elements of one ``degree`` between ``nodes``.

    ``nodes`` are one array for each energy. p = T u in the flux form, of one energy, for which the
    process gives dissipation and density of states; p = u in the drift-diffusion form. Zero flux is
    natural at all ends; ``absorbing`` names energies (counted from 0) at whose last node u = 0
    instead: first passage. The backward operator is the transpose of A. ``points`` is the degree
    that the quadrature is exact for.
    """

    process: Process
    nodes: tuple[Array, ...]
    degree: int
    points: int
    flux_form: bool = False
    absorbing: tuple[int, ...] = ()

    @cached_property
    def basis(self) -> Basis:
        """Continuous hierarchical elements, those of ``fpk.solvers.plane``, with Gauss points."""
        t, w = gauss_legendre(self.points // 2 + 1)
        t, w = 0.5 * (1.0 + t), 0.5 * w
        if len(self.nodes) == 1:
            low = {1: ElementLineP1, 2: ElementLineP2}
            element = low[self.degree]() if self.degree in low else ElementLinePp(self.degree)
            return Basis(MeshLine(self.nodes[0]), element, quadrature=(t[None], w))
        square = np.stack([x.ravel() for x in np.meshgrid(t, t, indexing="ij")])
        mesh = MeshQuad.init_tensor(*self.nodes)
        return Basis(mesh, ElementQuadP(self.degree), quadrature=(square, np.outer(w, w).ravel()))

    def log_states(self, energies: Array) -> Array:
        """ln T at energies (points, d), 0 in the drift-diffusion form."""
        if not self.flux_form:
            return np.zeros(len(energies))
        return np.asarray(self.process.coefficients(energies[:, 0]).log_density_of_states)

    @cached_property
    def local(self) -> tuple[Array, Array, Array, Array]:
        """∫ J(u_j) · ∇v_i, ∫ T u_j v_i and ∫ T v_i of each element, T relative to the last.

        That is ln of the largest T at the points of quadrature of each element, (elements,).
        """
        x = np.asarray(self.basis.global_coordinates())
        d, shape = len(x), self.basis.dx.shape
        energies = x.reshape(d, -1).T
        c = self.process.at(energies)
        F = c.drift - 0.5 * c.divergence
        if self.flux_form:
            F = self.process.coefficients(energies[:, 0]).dissipation[:, None]
        log_T = self.log_states(energies).reshape(shape)
        unit = log_T.max(axis=1)
        states = np.exp(log_T - unit[:, None])
        w = {
            "F": F.T.reshape(d, *shape),
            "b": np.moveaxis(c.diffusion, 0, -1).reshape(d, d, *shape),
            "states": states,
        }
        fields, dx = [u for (u,) in self.basis.basis], self.basis.dx
        value = np.stack([np.broadcast_to(np.asarray(u), shape) for u in fields])[:, None]
        slope = np.stack([np.broadcast_to(u.grad, (d, *shape)) for u in fields])
        J = np.stack([flux(u, w) for u in fields])

        def tested(v: Array, f: Array) -> Array:
            # (functions, components, elements, points) to one matrix product an element.
            a, b = (np.moveaxis(y, 2, 0).reshape(shape[0], len(y), -1) for y in (v * dx, f))
            return np.asarray(a @ b.transpose(0, 2, 1))

        ones = states[None, None]
        return tested(slope, J), tested(value, states * value), tested(value, ones)[..., 0], unit

    def assembled(self, entries: Array, log_scale: Array) -> csr_array:
        """The matrix of element matrices, T in the unit exp(``log_scale``) of each column."""
        dofs, unit = self.basis.element_dofs.T, self.local[3]
        scaled = entries * np.exp(unit[:, None] - log_scale[dofs])[:, None, :]
        i, j = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
        size = (self.basis.N, self.basis.N)
        return csr_array(coo_array((scaled.ravel(), (i.ravel(), j.ravel())), shape=size))

    @cached_property
    def free(self) -> Integers:
        """Unknowns that are not held at zero by an absorbing end."""
        held = [
            self.basis.get_dofs(lambda x, k=k: np.isclose(x[k], self.nodes[k][-1])).all()
            for k in self.absorbing
        ]
        every = np.arange(self.basis.N)
        return np.setdiff1d(every, np.concatenate(held)) if held else every

    @cached_property
    def A(self) -> csr_array:
        """The matrix of ∫ J · ∇v (test functions first), of the free unknowns."""
        largest = np.full(self.basis.N, self.local[3].max())
        return self.assembled(self.local[0], largest)[self.free][:, self.free]

    @cached_property
    def M(self) -> csr_array:
        """The mass matrix ∫ T u v of the free unknowns."""
        largest = np.full(self.basis.N, self.local[3].max())
        return self.assembled(self.local[1], largest)[self.free][:, self.free]

    @cached_property
    def shares(self) -> Array:
        """∫ T v of the free shape functions v: with u it gives ∫p."""
        unit = self.local[3]
        entries = self.local[2] * np.exp(unit - unit.max())[:, None]
        dofs = self.basis.element_dofs.T.ravel()
        total = np.bincount(dofs, entries.ravel(), minlength=self.basis.N)
        return np.asarray(total[self.free], dtype=float)

    def null_vector(self) -> tuple[Array, Array, float]:
        """Return y and ln s of the solution u = y/s of A u = 0, and its relative residual.

        s is the largest T in the elements of each unknown: y is of the size of p, and T may span
        any number of decades. Raises ``NotCertified`` with an absorbing end, or where A has no
        single null vector.
        """
        if self.absorbing:
            raise NotCertified("with an absorbing end nothing is stationary")
        log_scale = np.full(self.basis.N, -np.inf)
        np.maximum.at(log_scale, self.basis.element_dofs.T, self.local[3][:, None])
        matrix = csc_array(self.assembled(self.local[0], log_scale))
        at = self.basis.mesh.p.T / np.array(self.process.energy_scales)
        near = np.argsort(np.sum((at - 1.0) ** 2, axis=1))
        y, residual = null_vector(matrix, self.basis.nodal_dofs[0, near])
        return y, log_scale, residual

    def stationary(self) -> Array:
        """Return u of A u = 0, ∫p = 1; T is relative to its largest value."""
        y, log_scale, _ = self.null_vector()
        u = y * np.exp(self.local[3].max() - log_scale)
        return np.asarray(u / (self.shares @ u))

    def density(self, u: Array, *energies: Array) -> Array:
        """Return p of the free unknowns u at energies (points,) within the nodes."""
        full = np.zeros(self.basis.N)
        full[self.free] = u
        points = np.stack(energies, axis=1)
        states = np.exp(self.log_states(points) - self.local[3].max())
        return np.asarray(self.basis.probes(points.T) @ full * states)


def null_vectors(process: Process, nodes: Array, degree: int, points: int) -> tuple[Array, float]:
    """Return Legendre series (elements, degree + 1) of u of one energy, of the mean 1 in each.

    Returned, too, is the algebraic residual.
    """
    operator = Operator(process, (nodes,), degree, 2 * points - 1, flux_form=True)
    y, log_scale, residual = operator.null_vector()
    basis = operator.basis
    own = log_scale[basis.element_dofs]
    # u in the scale of each element: within its own unknowns it may span many decades, too.
    y = y[basis.element_dofs] * np.exp(own.min(axis=0) - own)
    values = sum(np.asarray(u) * y[k][:, None] for k, (u,) in enumerate(basis.basis))
    series = values @ projection(points - 1)[: degree + 1].T
    return series / series[:, :1], residual


def null_function(
    process: Process, nodes: Nodes, degree: int, points: int, weight: Weight | None = None
) -> tuple[PiecewiseTensor, float]:
    """Return p of two energies on a tensor mesh, unscaled, and its algebraic residual."""
    operator = Operator(process, nodes, degree, 2 * points - 1)
    y, _, residual = operator.null_vector()
    values = np.asarray(operator.basis.interpolate(y))
    # scikit-fem's first local coordinate is H2.
    blocks = values.reshape(nodes[0].size - 1, nodes[1].size - 1, points, points)
    grid = blocks.transpose(0, 3, 1, 2).reshape(blocks.shape[0] * points, -1)
    p = interpolated_tensor(nodes, grid, points)
    k = degree + 1
    return PiecewiseTensor(nodes, p.coefficients[..., :k, :k]), residual


def solve_by_scikit_fem(
    process: Process, *, tol: float, degree: int = DEGREE, marked: float = 0.0
) -> StationarySolution | PlaneSolution:
    """Return the stationary density to the L1 tolerance ``tol`` by elements of one ``degree``.

    Every interval of the mesh is halved until the answer is certified, at the most as often as its
    matrices are affordable; what is returned then is not certified. Its error is estimated from
    elements two degrees higher. Of one energy the first mesh is that of the fast solver; of two
    energies its intervals are equal in √H, and those are halved that ``solve_by_elements`` has
    ``marked``.

    Raises ``NotCertified`` where no stationary density exists.
    """
    if process.dimension == 2:
        require_confined(process)
        first = flux_free_weight(process)
        return solve_by_elements(
            process, first, tol=tol, degree=degree, marked=marked, solved=null_function
        )
    probe, layers = probed(process), GRADED_LAYERS if process.state_damping else 0
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth, layers=layers)
    while True:
        solution = solve_on_mesh(process, nodes, degree, tol=tol, null_vectors=null_vectors)
        if solution.certificate.certified or nodes.size * (degree + 3) ** 2 > MOST_ENTRIES:
            return solution
        nodes = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
