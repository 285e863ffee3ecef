"""The FPK equation of one or two energies in scikit-fem, with the weak form as it is on paper.

``solve_by_scikit_fem`` gives the stationary density on uniformly refined meshes. Error estimates
and certificates are from the fast solvers, ``fpk.solvers.line`` and ``fpk.solvers.plane``.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from skfem import Basis, MeshLine, MeshQuad
from skfem.element import ElementLineP1, ElementLineP2, ElementLinePp, ElementQuadP
from skfem.helpers import grad, mul

from fpk.numeric.arrays import Array
from fpk.numeric.piecewise import PiecewiseTensor, projection
from fpk.numeric.quadrature import gauss_legendre
from fpk.solvers.line.mesh import GRADED_LAYERS, initial_nodes, probe_process
from fpk.solvers.line.stationary import StationarySolution, solve_on_mesh
from fpk.solvers.plane.elements import Nodes, assemble, null_vector
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.plane.stationary import solve_by_elements
from fpk.solvers.plane.weight import Weight, flux_free_weight
from fpk.system.ends import require_confined
from fpk.system.process import Process

MOST_ENTRIES = 1e5
"""Number of entries of all element matrices of one energy above which no interval is halved."""
SCIKIT_DEGREE = 6
"""Default degree of the elements."""


def flux(u: Any, w: Mapping[str, Array]) -> Any:
    """Return J = T (F ``u`` − ½ b ∇u) of ∂p/∂t = −∇ · J, p = T u; weak form ∫ J · ∇v; (9), (19).

    ``w`` has the fields "states" T, "F" and "b". In the drift-diffusion form T = 1 and
    F = s − ½ ∇ · b, in the flux form F is the dissipation.
    """
    return w["states"] * (w["F"] * u - 0.5 * mul(w["b"], grad(u)))


def element_basis(nodes: tuple[Array, ...], degree: int, points: int) -> Basis:
    """Return the scikit-fem basis of elements of ``degree`` between ascending ``nodes``, one array
    for each axis, one or two. An element has ``points`` Gauss points along each axis."""
    t, w = gauss_legendre(points)
    t, w = 0.5 * (1.0 + t), 0.5 * w
    if len(nodes) == 1:
        low = {1: ElementLineP1, 2: ElementLineP2}
        element = low[degree]() if degree in low else ElementLinePp(degree)
        return Basis(MeshLine(nodes[0]), element, quadrature=(t[None], w))
    square = np.stack([x.ravel() for x in np.meshgrid(t, t, indexing="ij")])
    mesh = MeshQuad.init_tensor(*nodes)
    return Basis(mesh, ElementQuadP(degree), quadrature=(square, np.outer(w, w).ravel()))


def coefficients(
    process: Process, basis: Basis, *, flux_form: bool
) -> tuple[dict[str, Array], Array]:
    """Return the fields of ``flux`` for ``process`` at the points of ``basis``, and ln of T's unit.

    "F" is (d, elements, points), "b" (d, d, elements, points), "states" (elements, points); the
    unit is the largest T in each element, its ln (elements,). In the flux form, for one energy
    only, p = T u; otherwise p = u and T = 1.
    """
    x = np.asarray(basis.global_coordinates())
    d, shape = len(x), basis.dx.shape
    energies = x.reshape(d, -1).T
    c = process.at(energies)
    F, log_T = c.drift - 0.5 * c.divergence, np.zeros(shape)
    if flux_form:
        of_states = process.coefficients(energies[:, 0])
        F, log_T = of_states.dissipation[:, None], of_states.log_density_of_states.reshape(shape)
    unit = log_T.max(axis=1)
    fields = {
        "F": F.T.reshape(d, *shape),
        "b": np.moveaxis(c.diffusion, 0, -1).reshape(d, d, *shape),
        "states": np.exp(log_T - unit[:, None]),
    }
    return fields, unit


def stationary_vector(
    process: Process, basis: Basis, *, flux_form: bool = False
) -> tuple[Array, Array, float]:
    """Return y and ln s of the solution u = y/s of ∫ J(u) · ∇v = 0, and its relative residual.

    y and s are (unknowns,). s is the largest T in the elements of each unknown, so that y is of the
    size of p; the factor of y is arbitrary. For ``flux_form`` see ``coefficients``. Zero flux is
    natural at all ends. Raises ``NotCertified`` if the solution is not unique.
    """
    w, unit = coefficients(process, basis, flux_form=flux_form)
    fields, dx = [u for (u,) in basis.basis], basis.dx
    slope = np.stack([np.broadcast_to(u.grad, (len(w["F"]), *dx.shape)) for u in fields]) * dx
    # (functions, components, elements, points) to one matrix product an element, test first.
    test, trial = (
        np.moveaxis(y, 2, 0).reshape(len(dx), len(fields), -1)
        for y in (slope, np.stack([flux(u, w) for u in fields]))
    )
    dofs, log_scale = basis.element_dofs.T, np.full(basis.N, -np.inf)
    np.maximum.at(log_scale, dofs, unit[:, None])
    entries = test @ trial.transpose(0, 2, 1) * np.exp(unit[:, None] - log_scale[dofs])[:, None, :]
    at = basis.mesh.p.T / np.array(process.energy_scales)
    near = np.argsort(np.sum((at - 1.0) ** 2, axis=1))
    y, residual = null_vector(assemble(entries, dofs), basis.nodal_dofs[0, near])
    return y, log_scale, residual


def null_vectors(process: Process, nodes: Array, degree: int, points: int) -> tuple[Array, float]:
    """Return u = p/T of one energy, scaled to mean 1 in each element, and the relative residual.

    u are Legendre coefficients (elements, ``degree`` + 1) between ``nodes``; ``points`` is the
    number of Gauss points of an element. The residual is the residual of the global equations.
    Raises as ``stationary_vector`` does.
    """
    basis = element_basis((nodes,), degree, points)
    y, log_scale, residual = stationary_vector(process, basis, flux_form=True)
    own = log_scale[basis.element_dofs]
    # u in a scale of each element, as s may vary by decades between the unknowns of an element.
    y = y[basis.element_dofs] * np.exp(own.min(axis=0) - own)
    values = sum(np.asarray(u) * y[k][:, None] for k, (u,) in enumerate(basis.basis))
    series = values @ projection(points - 1)[: degree + 1].T
    return series / series[:, :1], residual


def plane_null_function(
    process: Process, nodes: Nodes, degree: int, points: int, weight: Weight | None = None
) -> tuple[PiecewiseTensor, float]:
    """Return p of two energies up to a factor on a tensor mesh, and its relative residual.

    Elements of ``degree`` between ``nodes`` have ``points`` Gauss points along each axis; the
    ``weight`` is not used. Raises as ``stationary_vector`` does.
    """
    basis = element_basis(nodes, degree, points)
    y, _, residual = stationary_vector(process, basis)
    values = np.asarray(basis.interpolate(y))
    # The first local coordinate of scikit-fem is H2.
    blocks = values.reshape(nodes[0].size - 1, nodes[1].size - 1, points, points)
    series = projection(points - 1)[: degree + 1]
    p = np.einsum("ia,jb,klba->klij", series, series, blocks, optimize=True)
    return PiecewiseTensor(nodes, p), residual


def solve_by_scikit_fem(
    process: Process, *, tol: float, degree: int = SCIKIT_DEGREE, marked: float = 0.0
) -> StationarySolution | PlaneSolution:
    """Return the stationary density of ``process`` by elements of ``degree``, to the L1 ``tol``.

    Meshes are refined until the answer is certified or matrices would be too large. For one energy
    the first mesh is the mesh of the fast solver, and all its elements are halved. For two energies
    it is equidistant in √H; for ``marked`` see ``solve_by_elements``. An answer that misses the
    tolerance is returned with a failed certificate. Raises ``NotCertified`` if no stationary
    density exists, and as ``stationary_vector`` and ``solve_by_elements`` do.
    """
    if process.dimension == 2:
        require_confined(process)
        first = flux_free_weight(process)
        return solve_by_elements(
            process, first, tol=tol, degree=degree, marked=marked, solved=plane_null_function
        )
    probe, layers = probe_process(process), GRADED_LAYERS if process.state_damping else 0
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth, layers=layers)
    while True:
        solution = solve_on_mesh(process, nodes, degree, tol=tol, null_vectors=null_vectors)
        if solution.certificate.certified or nodes.size * (degree + 3) ** 2 > MOST_ENTRIES:
            return solution
        nodes = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
