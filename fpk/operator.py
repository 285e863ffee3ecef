"""The FPK operator of a process of one or two energies on a mesh, as sparse matrices.

Here the weak form is written as the equation is, in scikit-fem. The stationary solvers assemble it
in other ways, ``fpk.line`` one element at a time and ``fpk.plane`` one direction at a time, and
tests compare the matrices' null vectors.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, LinearForm, MeshLine, MeshQuad
from skfem.element import ElementLineP1, ElementLineP2, ElementLinePp, ElementQuadP
from skfem.helpers import dot, grad, mul

from fpk.arrays import Array, Integers
from fpk.errors import NotCertified
from fpk.process import Process


@BilinearForm
def flux(u, v, w):  # type: ignore[no-untyped-def]
    """∫ J · ∇v, J = T (F u − ½ b ∇u): the weak form of ∂p/∂t = −∇ · J, p = T u, zero flux outside.

    In the drift-diffusion form T = 1 and F = s − ½ ∇ · b, in the flux form F is the dissipation.
    """
    return dot(w.states * (w.F * u - 0.5 * mul(w.b, grad(u))), grad(v))


@BilinearForm
def mass(u, v, w):  # type: ignore[no-untyped-def]
    """∫ p v, p = T u."""
    return w.states * u * v


@LinearForm
def share(v, w):  # type: ignore[no-untyped-def]
    """∫ T v: with u it gives ∫p."""
    return w.states * v


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
        """Continuous hierarchical elements, in two energies those of ``fpk.plane``."""
        if len(self.nodes) == 1:
            low = {1: ElementLineP1, 2: ElementLineP2}
            element = low[self.degree]() if self.degree in low else ElementLinePp(self.degree)
            return Basis(MeshLine(self.nodes[0]), element, intorder=self.points)
        mesh = MeshQuad.init_tensor(*self.nodes)
        return Basis(mesh, ElementQuadP(self.degree), intorder=self.points)

    @cached_property
    def at_points(self) -> Array:
        """Energies (points, d) of the quadrature."""
        x = np.asarray(self.basis.global_coordinates())
        return x.reshape(len(x), -1).T

    @cached_property
    def log_unit(self) -> float:
        """ln T that counts as 0: the largest of all points."""
        return float(np.max(self.process.coefficients(self.at_points[:, 0]).log_density_of_states))

    def states(self, energies: Array) -> Array:
        """T at energies (points, d), 1 in the drift-diffusion form."""
        if not self.flux_form:
            return np.ones(len(energies))
        log_states = self.process.coefficients(energies[:, 0]).log_density_of_states
        return np.asarray(np.exp(log_states - self.log_unit))

    @cached_property
    def coefficients(self) -> dict[str, Array]:
        """F, b and T at the points of quadrature, the axes of energies first."""
        energies = self.at_points
        d, shape = len(self.nodes), self.basis.dx.shape
        at = self.process.at(energies)
        if self.flux_form:
            F = self.process.coefficients(energies[:, 0]).dissipation[:, None]
        else:
            F = at.drift - 0.5 * at.divergence
        return {
            "F": F.T.reshape(d, *shape),
            "b": np.moveaxis(at.diffusion, 0, -1).reshape(d, d, *shape),
            "states": self.states(energies).reshape(shape),
        }

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
        """The matrix of ``flux`` (test functions first), of the free unknowns."""
        return csr_array(flux.assemble(self.basis, **self.coefficients))[self.free][:, self.free]

    @cached_property
    def M(self) -> csr_array:
        """The mass matrix of the free unknowns."""
        return csr_array(mass.assemble(self.basis, **self.coefficients))[self.free][:, self.free]

    @cached_property
    def shares(self) -> Array:
        """∫ T v of the free shape functions v."""
        return np.asarray(share.assemble(self.basis, **self.coefficients))[self.free]

    def stationary(self) -> Array:
        """Return u of A u = 0, ∫p = 1, in the scale of ``coefficients``.

        The vertex functions sum to one, so that one of their equations is redundant and gives way
        to the mass. Raises ``NotCertified`` with an absorbing end, or where A has no single null
        vector.
        """
        if self.absorbing:
            raise NotCertified("with an absorbing end nothing is stationary")
        matrix = self.A.tolil()
        matrix[0] = self.shares
        right = np.zeros(self.shares.size)
        right[0] = 1.0
        try:
            return np.asarray(splu(matrix.tocsc()).solve(right))
        except RuntimeError as error:
            raise NotCertified("the stationary equation has no unique solution") from error

    def density(self, u: Array, *energies: Array) -> Array:
        """Return p of the free unknowns u at energies (points,) within the nodes."""
        full = np.zeros(self.basis.N)
        full[self.free] = u
        points = np.stack(energies, axis=1)
        return np.asarray(self.basis.probes(points.T) @ full * self.states(points))
