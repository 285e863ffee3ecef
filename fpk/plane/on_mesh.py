"""Finite element solutions of the stationary FPK equation of two energies, and their errors."""

import numpy as np
from numpy.polynomial.legendre import legvander

from fpk.arrays import Array, Flags
from fpk.certificate import Measured, certify
from fpk.errors import NotCertified
from fpk.piecewise import PiecewiseTensor
from fpk.plane.condensation import local_order, null_vector
from fpk.plane.elements import (
    by_element,
    coefficients_on_grid,
    element_matrices,
    shape_functions,
)
from fpk.plane.probe import Probe
from fpk.plane.solution import (
    ROUND_OFF,
    SAFETY,
    Nodes,
    PlaneSolution,
    gauss_grid,
    graded,
    tails,
    weighted,
)
from fpk.plane.weight import Weight
from fpk.process import Process
from fpk.quadrature import gauss_legendre

ENRICHMENT = 2
"""Degrees by which the enriched solution exceeds the answer along both axes."""
MORE_POINTS = 2
"""Gauss points along each axis of integrals, beyond the degree."""
WEIGHT_POINTS = 20
"""Further points of integrals with a weight, which is no polynomial, shared by the panels; the
enriched solution has two more on each, so that the error estimate contains what they miss."""
FALL = 2.0
"""Nats by which the marginals fall from the ends of the answer to those of the enriched solution:
the difference of the two then holds 86 % of what ending the mesh costs."""
DEGREE_PER_DIGIT = 1.6
"""Degree of the elements per digit asked for, between ``DEGREES``: the cheapest in fig8b."""
DEGREES = (4, 18)
FIRST = 4
"""Intervals along each axis of the first mesh, equidistant in √H, the amplitude."""
TAIL = 1e-2
"""Part of the tolerance that the mass beyond the first mesh is planned to be."""
COARSE = 0.1
"""Size of the highest modes of an interval, relative to the worst one, from which it is halved."""
MAX_ROUNDS = 12
MAX_ENTRIES = 2e7
"""Entries of all element matrices of the enriched solution: 160 MB, several times over."""


def solve_plane_on_mesh(
    process: Process,
    nodes: Nodes,
    degree: int,
    *,
    tol: float = np.inf,
    weight: Weight | None = None,
    longer: Nodes | None = None,
) -> PlaneSolution:
    """Return the finite element solution p = w u with u of ``degree`` on a tensor mesh.

    Without a ``weight`` w = 1. The enriched solution lives on the ``longer`` mesh: the estimate
    then contains what ending the mesh costs. Where probability circulates, zero flux at the far
    edges is wrong by more than the mass beyond. For convergence studies both are on one mesh.

    Raises ``NotCertified`` where the equations have no unique solution.
    """
    points = degree + MORE_POINTS
    if weight is not None:
        points += WEIGHT_POINTS // min(x.size - 1 for x in nodes)
    u, residual = _solved(process, nodes, degree, points, weight)
    (x, y), (v, w) = gauss_grid(nodes, points)
    p = weighted(u, weight, x[:, None], y)
    mass_defect = abs(float(v @ p @ w) - 1.0)
    beyond, e_fold = tails(p, (x, y), (v, w), points)
    # The mass beyond the mesh is missing there and too much elsewhere, as p has mass 1.
    tail, mesh = float(beyond.sum()), nodes
    if longer is not None:
        # A mass of the size of round-off is nothing else: its slope says nothing of p.
        reach = np.where(beyond > ROUND_OFF, FALL * e_fold, 0.0)
        first, second = (
            far * max(1.0, (near[-1] + r) / far[-1])
            for near, far, r in zip(nodes, longer, reach, strict=True)
        )
        mesh = first, second
    enriched, _ = _solved(process, mesh, degree + ENRICHMENT, points + ENRICHMENT, weight)
    better = weighted(enriched, weight, x[:, None], y)
    # Round-off of shape functions averages out over the elements, that of a weight does not.
    elements = (nodes[0].size - 1) * (nodes[1].size - 1)
    rounding = ROUND_OFF * degree**2 * elements**0.5
    if weight is not None:
        rounding += ROUND_OFF * float(v @ (np.abs(p) * weight.terms(x[:, None], y)) @ w)
    relative, distance = tail + mass_defect, SAFETY * np.abs(p - better)
    measured = Measured(
        l1_error=float(v @ distance @ w) + tail + relative + rounding,
        mass_defect=mass_defect,
        minimum=float(p.min() / p.max()),
        residual=residual,
        tail_mass=tail,
        absolute_error=float(np.max(distance) / p.max()),
    )
    certificate = certify(measured, tol=tol)
    return PlaneSolution(process, u, enriched, weight, relative, measured, certificate)


def _solved(
    process: Process, nodes: Nodes, degree: int, points: int, weight: Weight | None
) -> tuple[PiecewiseTensor, float]:
    """u of the density of mass 1, and its algebraic residual."""
    counts = (nodes[0].size - 1, nodes[1].size - 1)
    lengths = np.meshgrid(*(np.diff(x) for x in nodes), indexing="ij")
    sizes = np.stack([h.ravel() for h in lengths], axis=1)
    (x, y), (v, w) = gauss_grid(nodes, points)
    coefficients, values = coefficients_on_grid(process, x, y, weight)
    matrices = element_matrices(by_element(coefficients, counts), sizes, degree)
    t, share = gauss_legendre(points)
    phi, _ = shape_functions(degree, 0.5 * (1.0 + t))
    area = v[:, None] * w
    masses = (phi @ by_element(area * values, counts) @ phi.T).reshape(len(sizes), -1)
    try:
        null, residual = null_vector(matrices, masses[:, local_order(degree)[0]], counts, degree)
    except np.linalg.LinAlgError:
        raise NotCertified("the stationary equation has no unique solution on this mesh") from None
    # Shape functions as Legendre series.
    k = degree + 1
    series = (phi * (0.5 * share)) @ legvander(t, degree) * (2.0 * np.arange(k) + 1.0)
    u = (series.T @ null.reshape(-1, k, k) @ series).reshape(*counts, k, k)
    return PiecewiseTensor(nodes, u), residual


def solve_by_elements(
    process: Process, probe: Probe, *, tol: float, degree: int | None = None
) -> PlaneSolution:
    """Return the plain solution, w = 1, to the L1 tolerance ``tol``, adapting the mesh.

    ``degree`` follows from ``tol`` unless given, the ends of the first mesh from the ``probe``. The
    mesh is lengthened where mass lies beyond, and intervals are halved where the highest modes are
    too large: until the certificate holds or the limits are reached.

    Raises ``NotCertified`` where the first mesh has more than ``MAX_ENTRIES``.
    """
    if degree is None:
        degree = int(np.clip(round(-DEGREE_PER_DIGIT * np.log10(tol)), *DEGREES))
    first, second = graded(np.array(process.energy_scales) * probe.extent(TAIL * tol), FIRST)
    solution = None
    for _ in range(MAX_ROUNDS):
        if (first.size - 1) * (second.size - 1) * (degree + ENRICHMENT + 1) ** 4 > MAX_ENTRIES:
            break
        nodes, longer = (first, second), (_lengthened(first), _lengthened(second))
        solution = solve_plane_on_mesh(process, nodes, degree, tol=tol, longer=longer)
        if solution.certificate.certified:
            break
        first, second = _refined(solution, tol)
    if solution is None:
        raise NotCertified(f"the tolerance {tol:.2g} takes more elements than are affordable")
    return solution


def _lengthened(nodes: Array) -> Array:
    """The nodes with another interval as long as the last one."""
    return np.append(nodes, 2.0 * nodes[-1] - nodes[-2])


def _refined(solution: PlaneSolution, tol: float) -> Nodes:
    """The next mesh: halved where the highest modes are too large, and long enough."""
    points = solution.degree + 2
    energies, weights = gauss_grid(solution.nodes, points)
    p = solution.density(energies[0][:, None], energies[1])
    beyond = tails(p, energies, weights, points)[0] > 0.1 * tol
    area = np.multiply.outer(*(np.diff(x) for x in solution.nodes))
    size = np.abs(solution.u.coefficients) * area[:, :, None, None]
    highest = size[:, :, -2:].sum(axis=(1, 2, 3)), size[..., -2:].sum(axis=(0, 2, 3))
    limit = COARSE * max(highest[0].max(), highest[1].max())
    meshes = []
    for axis, nodes in enumerate(solution.nodes):
        marked: Flags = highest[axis] > limit
        middle = 0.5 * (nodes[1:] + nodes[:-1])
        finer = np.sort(np.concatenate([nodes, middle[marked]]))
        meshes.append(_lengthened(finer) if beyond[axis] else finer)
    return meshes[0], meshes[1]
