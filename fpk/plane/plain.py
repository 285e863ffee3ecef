"""Plain finite elements of two energies, which expand p itself: w = 1."""

import numpy as np

from fpk.arrays import Array, Flags
from fpk.certificate import NEGATIVE
from fpk.errors import NotCertified
from fpk.plane.elements import by_element
from fpk.plane.on_mesh import ENRICHMENT, solve_plane_on_mesh
from fpk.plane.probe import Probe
from fpk.plane.solution import Nodes, PlaneSolution, gauss_grid, graded, tails
from fpk.process import Process

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


def solve_by_elements(
    process: Process, probe: Probe, *, tol: float, degree: int | None = None
) -> PlaneSolution:
    """Return the finite element solution to the L1 tolerance ``tol``, adapting the mesh.

    ``degree`` follows from ``tol`` unless given, the ends of the first mesh from the ``probe``. The
    mesh is lengthened where mass lies beyond, and intervals are halved where the highest modes are
    too large or p is negative: until the certificate holds or the limits are reached.

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
    """The next mesh: halved where the highest modes are too large or p < 0, and long enough."""
    points = solution.degree + 2
    energies, weights = gauss_grid(solution.nodes, points)
    p = solution.density(energies[0][:, None], energies[1])
    beyond = tails(p, energies, weights, points)[0] > 0.1 * tol
    area = np.multiply.outer(*(np.diff(x) for x in solution.nodes))
    size = np.abs(solution.u.coefficients) * area[:, :, None, None]
    highest = size[:, :, -2:].sum(axis=(1, 2, 3)), size[..., -2:].sum(axis=(0, 2, 3))
    limit = COARSE * max(highest[0].max(), highest[1].max())
    below = by_element(p - NEGATIVE * p.max(), area.shape).min(axis=(1, 2)) < 0.0
    negative: Flags = below.reshape(area.shape)
    meshes = []
    for axis, nodes in enumerate(solution.nodes):
        marked: Flags = (highest[axis] > limit) | negative.any(axis=1 - axis)
        middle = 0.5 * (nodes[1:] + nodes[:-1])
        finer = np.sort(np.concatenate([nodes, middle[marked]]))
        meshes.append(_lengthened(finer) if beyond[axis] else finer)
    return meshes[0], meshes[1]
