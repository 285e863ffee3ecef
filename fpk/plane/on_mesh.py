"""The stationary FPK equation of two energies, Eq. (19), on a given tensor mesh."""

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.plane.elements import gauss_rule, shapes_at_gauss
from fpk.plane.condensation import local_order, null_vector
from fpk.plane.elements import by_element, coefficients_at, element_matrices, gauss_energies
from fpk.plane.mesh import Nodes
from fpk.plane.solution import PlaneSolution, assessed, mass_beyond
from fpk.plane.weight import Weight
from fpk.plane.weighted import ROUND_OFF, WeightedPolynomial
from fpk.process import Process

Array = NDArray[np.float64]

ENRICHMENT = 2
"""Degrees by which the enriched solution exceeds the answer along both axes."""
WEIGHT_POINTS = 4
"""Further Gauss points along each axis of integrals with a weight, which is no polynomial; the
enriched solution has two more, so that the error estimate contains what they miss."""


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
    rule = degree if weight is None else degree + WEIGHT_POINTS
    answer, residual = _solved(process, nodes, degree, rule, weight)
    mesh = nodes if longer is None else longer
    enriched, _ = _solved(process, mesh, degree + ENRICHMENT, rule + ENRICHMENT, weight)
    H1, H2 = gauss_energies(nodes, rule)
    weights, p = gauss_weights(nodes, rule), answer.at_gauss(rule)
    better = by_element(enriched(H1.reshape(-1, 1), H2.ravel()), len(H1), len(H2))
    # Round-off of shape functions averages out over the elements, that of a weight does not.
    rounding = ROUND_OFF * degree**2 * len(p) ** 0.5
    if weight is not None:
        terms = by_element(weight.terms(H1.reshape(-1, 1), H2.ravel()), len(H1), len(H2))
        rounding += ROUND_OFF * float(np.sum(weights * np.abs(p) * terms))
    return assessed(
        process,
        answer,
        enriched,
        (p, better, weights),
        tol=tol,
        tail=float(tails(answer, rule).sum()),
        rounding=rounding,
        residual=residual,
    )


def gauss_weights(nodes: Nodes, rule: int) -> Array:
    """Return the quadrature weights (elements, points, points) that go with degree ``rule``."""
    _, w = gauss_rule(rule)
    area = np.multiply.outer(*(np.diff(x) for x in nodes))
    return np.asarray(area.reshape(-1, 1, 1) * np.multiply.outer(w, w))


def tails(p: WeightedPolynomial, rule: int) -> Array:
    """Return estimates of the mass beyond each far edge, (2,)."""
    counts = (p.nodes[0].size - 1, p.nodes[1].size - 1)
    _, w = gauss_rule(rule)
    mass = (p.at_gauss(rule) * gauss_weights(p.nodes, rule)).reshape(*counts, w.size, w.size)
    beyond = []
    for axis, (H, n) in enumerate(zip(gauss_energies(p.nodes, rule), p.nodes, strict=True)):
        blocks = mass if axis == 0 else mass.transpose(1, 0, 3, 2)
        along = np.abs(blocks[-1].sum(axis=(0, 2))) / (w * (n[-1] - n[-2]))
        beyond.append(mass_beyond(H[-1], along))
    return np.array(beyond)


def _solved(
    process: Process, nodes: Nodes, degree: int, rule: int, weight: Weight | None
) -> tuple[WeightedPolynomial, float]:
    """The solution of mass 1 and its algebraic residual."""
    lengths = np.meshgrid(*(np.diff(x) for x in nodes), indexing="ij")
    sizes = np.stack([h.ravel() for h in lengths], axis=1)
    coefficients, w = coefficients_at(process, nodes, rule, weight)
    matrices = element_matrices(coefficients, sizes, degree, rule)
    phi, _ = shapes_at_gauss(degree, rule)
    masses = (phi @ (gauss_weights(nodes, rule) * w) @ phi.T).reshape(len(sizes), -1)
    counts = (nodes[0].size - 1, nodes[1].size - 1)
    try:
        null = null_vector(matrices, masses[:, local_order(degree)[0]], counts, degree)
    except np.linalg.LinAlgError:
        raise NotCertified("the stationary equation has no unique solution on this mesh") from None
    k = degree + 1
    return WeightedPolynomial.of_shapes(
        nodes, null.coefficients.reshape(-1, k, k), weight
    ), null.residual
