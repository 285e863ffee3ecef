"""Plain finite elements for p(H1, H2), without a weight: the fallback.

They need no approximation of p to start from, and the more elements the smaller the smallest p is
that must be right.
"""

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import NEGATIVE
from fpk.errors import NotCertified
from fpk.plane.elements import by_element
from fpk.plane.mesh import axis_nodes, bisected, lengthened
from fpk.plane.on_mesh import ENRICHMENT, solve_plane_on_mesh
from fpk.plane.probe import Probe
from fpk.plane.solution import Nodes, PlaneSolution, gauss_grid, tails
from fpk.process import Process

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

DEGREE_PER_DIGIT = 1.6
"""Degree of the elements per digit asked for, between ``DEGREES``: the cheapest in fig8b."""
DEGREES = (4, 18)
INTERVAL_ERROR = 0.2
"""Part of the tolerance that each interval of the first mesh is planned to use up."""
TAIL = 1e-2
"""Part of the tolerance that the mass beyond the first mesh is planned to be."""
NEARLY = 30.0
"""Error, in tolerances, from which two degrees more reach the tolerance: they gain a factor 30."""
MAX_DEGREE = 20
MAX_ROUNDS = 12
MAX_ENTRIES = 2e7
"""Entries of all element matrices of the enriched solution: 160 MB, several times over."""


def solve_by_elements(
    process: Process, probe: Probe, *, tol: float, degree: int | None, strict: bool = True
) -> PlaneSolution:
    """Return the finite element solution to the L1 tolerance ``tol``, adapting the mesh.

    ``degree`` and first mesh follow from ``tol`` and the ``probe``. The mesh is lengthened where
    mass lies beyond, the degree raised where the error is nearly small enough, and intervals are
    halved where the highest modes are too large or p is negative: until the certificate holds, or
    just the error estimate if not ``strict``, or the limits are reached.

    Raises ``NotCertified`` where the first mesh has more than ``MAX_ENTRIES``.
    """
    fixed = degree is not None
    if degree is None:
        degree = int(np.clip(round(-DEGREE_PER_DIGIT * np.log10(tol)), *DEGREES))
    first, second = (
        scale * axis_nodes(probe, axis, tail=TAIL * tol, tol=INTERVAL_ERROR * tol, degree=degree)
        for axis, scale in enumerate(process.energy_scales)
    )
    nodes = first, second
    if not _affordable(nodes, degree):
        raise NotCertified(f"the tolerance {tol:.2g} takes more elements than are affordable")
    for _ in range(MAX_ROUNDS):
        longer = lengthened(nodes[0]), lengthened(nodes[1])
        solution = solve_plane_on_mesh(process, nodes, degree, tol=tol, longer=longer)
        if solution.certificate.certified or (not strict and solution.l1_error <= tol):
            break
        finer, higher = _refined(solution, tol, fixed=fixed)
        if not _affordable(finer, higher):
            break
        nodes, degree = finer, higher
    return solution


def _refined(solution: PlaneSolution, tol: float, *, fixed: bool) -> tuple[Nodes, int]:
    """The next mesh and degree."""
    nodes, degree = solution.nodes, solution.degree
    energies, weights = gauss_grid(nodes, degree + 2)
    p = solution.density(energies[0][:, None], energies[1])
    mass = tails(p, energies, weights, degree + 2)
    beyond = mass > 0.1 * tol
    near = solution.l1_error - 2.0 * float(mass.sum()) <= NEARLY * tol
    if near and not fixed and not np.any(beyond) and degree + 2 <= MAX_DEGREE:
        return nodes, degree + 2
    first, second = nodes
    if not near or not np.any(beyond):
        marked = _too_coarse(solution, p)
        first, second = bisected(first, marked[0]), bisected(second, marked[1])
    first = lengthened(first) if beyond[0] else first
    second = lengthened(second) if beyond[1] else second
    return (first, second), degree


def _affordable(nodes: Nodes, degree: int) -> bool:
    elements = (nodes[0].size - 1) * (nodes[1].size - 1)
    return bool(elements * (degree + ENRICHMENT + 1) ** 4 <= MAX_ENTRIES)


def _too_coarse(solution: PlaneSolution, p: Array) -> tuple[Flags, Flags]:
    """Intervals whose highest modes hold too much, at least the worst one, or where ``p`` < 0.

    p is on the grid of the Gauss points.
    """
    area = np.multiply.outer(*(np.diff(x) for x in solution.nodes))
    size = np.abs(solution.u.coefficients) * area[:, :, None, None]
    first, second = size[:, :, -2:].sum(axis=(1, 2, 3)), size[..., -2:].sum(axis=(0, 2, 3))
    limit = 0.1 * max(first.max(), second.max())
    negative = by_element(p < NEGATIVE * p.max(), area.shape).any(axis=(1, 2)).reshape(area.shape)
    return (first > limit) | negative.any(axis=1), (second > limit) | negative.any(axis=0)
