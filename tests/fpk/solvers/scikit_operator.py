"""The matrices of the FPK operator by scikit-fem's own assembly, the judge of our solvers."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from skfem import BilinearForm, LinearForm
from skfem.helpers import dot, grad

from fpk.solvers.operator import coefficients, element_basis, flux, stationary_vector
from fpk.system.process import Process


@dataclass
class Operator:
    """``M ∂u/∂t = A u`` on elements of one ``degree`` between ``nodes``, one array an energy.

    p = T u in the flux form, T relative to its largest value at the points of quadrature; p = u
    otherwise. ``absorbing`` names energies (from 0) at whose last node u = 0.
    """

    process: Process
    nodes: tuple
    degree: int
    points: int
    flux_form: bool = False
    absorbing: tuple = ()

    def __post_init__(self):
        self.basis = element_basis(self.nodes, self.degree, self.points)
        self.fields, unit = coefficients(self.process, self.basis, flux_form=self.flux_form)
        self.fields["states"] *= np.exp(unit - unit.max())[:, None]
        self.largest = unit.max()

    @property
    def free(self):
        held = [
            self.basis.get_dofs(lambda x, k=k: np.isclose(x[k], self.nodes[k][-1])).all()
            for k in self.absorbing
        ]
        return np.setdiff1d(np.arange(self.basis.N), np.concatenate([[], *held]).astype(int))

    def _assembled(self, form):
        matrix = BilinearForm(form).assemble(self.basis, **self.fields).tocsr()
        return matrix[self.free][:, self.free]

    @cached_property
    def A(self):
        return self._assembled(lambda u, v, w: dot(flux(u, w), grad(v)))

    @cached_property
    def M(self):
        return self._assembled(lambda u, v, w: w["states"] * u * v)

    @property
    def shares(self):
        """∫ T v of the free shape functions."""
        form = LinearForm(lambda v, w: w["states"] * v)
        return form.assemble(self.basis, **self.fields)[self.free]

    def stationary(self):
        """u of A u = 0 with ∫p = 1."""
        y, log_scale, _ = stationary_vector(self.process, self.basis, flux_form=self.flux_form)
        u = y * np.exp(self.largest - log_scale)
        return u / (replace(self, absorbing=()).shares @ u)

    def density(self, u, *energies):
        """p of the free unknowns u at energies (points,) within the nodes."""
        full, points = np.zeros(self.basis.N), np.stack(energies)
        full[self.free] = u
        p = self.basis.probes(points) @ full
        if not self.flux_form:
            return p
        log_T = self.process.coefficients(points[0]).log_density_of_states
        return p * np.exp(log_T - self.largest)
