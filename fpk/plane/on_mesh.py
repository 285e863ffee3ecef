"""Finite elements for the stationary FPK equation of two energies, Eq. (19).

Without a weight p itself is expanded: that needs no guess of p, and takes the more elements the
smaller the smallest p is to be right. With one it is u of p = w u.
"""

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.line.elements import gauss_rule, shapes_at_gauss
from fpk.plane.condensation import local_order, null_vector
from fpk.plane.elements import coefficients_at, element_matrices, gauss_energies, weighted
from fpk.plane.mesh import Probe, axis_nodes, bisected
from fpk.plane.solution import NEGATIVE, PlaneSolution, judged, mass_beyond
from fpk.plane.tensor import ROUND_OFF, TensorPolynomial, by_element, weight_at_gauss
from fpk.plane.weight import Weight
from fpk.process import Process

Array = NDArray[np.float64]
Nodes = tuple[Array, Array]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer along both axes."""
SHARE = 0.2
"""Part of the tolerance that each interval of the first mesh is planned to use up."""
NEARLY = 30.0
"""An estimate within so many tolerances is met by two degrees more rather than by more elements."""
MOST_DEGREE = 20
MOST_ROUNDS = 12
MOST_ENTRIES = 2e7
"""Entries of all element matrices of the comparison solution: 160 MB, several times over."""
FOR_THE_WEIGHT = 4
"""Gauss points along each axis that integrals of w take on top: with four more nothing changes."""


def solve_by_elements(
    process: Process, probe: Probe, *, tol: float, degree: int | None, strict: bool = True
) -> PlaneSolution:
    """Return the finite element solution to the L1 tolerance ``tol``, adapting the mesh.

    Degree and first mesh follow from ``tol`` and the ``probe``. The mesh is made longer where mass
    lies beyond, the degree raised where little is missing, and intervals are halved whose highest
    modes are too large or, if ``strict``, where p is negative: until the certificate holds, or
    without ``strict`` the tolerance, or the limits are reached.
    """
    fixed = degree is not None
    degree = int(np.clip(round(-1.6 * np.log10(tol)), 4, 18)) if degree is None else degree
    pair = _first_nodes(process, probe, degree, tol)
    if not _affordable(pair, degree):
        raise NotCertified(f"the tolerance {tol:.2g} takes more elements than are affordable")
    for _ in range(MOST_ROUNDS):
        longer = _longer(pair[0], True), _longer(pair[1], True)
        solution = solve_plane_on_mesh(process, pair, degree, tol=tol, longer=longer)
        if solution.certificate.certified or (not strict and solution.l1_error <= tol):
            break
        answer = solution.answer
        assert isinstance(answer, TensorPolynomial)
        rule = answer.degree
        tails = _tails(answer.at_gauss(rule), _weights(pair, rule), pair, rule)
        beyond = tails > 0.1 * tol
        near = solution.l1_error - 2.0 * float(tails.sum()) <= NEARLY * tol
        finer, higher = pair, degree
        if near and not fixed and not np.any(beyond) and degree + 2 <= MOST_DEGREE:
            higher = degree + 2
        else:
            if not near or not np.any(beyond):
                marked = _too_coarse(answer)
                finer = (bisected(pair[0], marked[0]), bisected(pair[1], marked[1]))
            finer = (_longer(finer[0], beyond[0]), _longer(finer[1], beyond[1]))
        if not _affordable(finer, higher):
            break
        pair, degree = finer, higher
    return solution


def _affordable(nodes: Nodes, degree: int) -> bool:
    elements = (nodes[0].size - 1) * (nodes[1].size - 1)
    return bool(elements * (degree + ENRICHMENT + 1) ** 4 <= MOST_ENTRIES)


def _first_nodes(process: Process, probe: Probe, degree: int, tol: float) -> Nodes:
    first, second = (
        scale * axis_nodes(probe, axis, tail=1e-2 * tol, tol=SHARE * tol, degree=degree)
        for axis, scale in enumerate(process.energy_scales)
    )
    return first, second


def solve_plane_on_mesh(
    process: Process,
    nodes: Nodes,
    degree: int,
    *,
    tol: float = np.inf,
    weight: Weight | None = None,
    longer: Nodes | None = None,
) -> PlaneSolution:
    """Return the finite element solution on a given tensor mesh.

    With ``longer`` nodes for the comparison solution the estimate holds what ending the mesh costs,
    too: where probability circulates, zero flux at the far edges is wrong by more than the mass
    beyond. For convergence studies both are on one mesh.
    """
    rule = degree if weight is None else degree + FOR_THE_WEIGHT
    answer, residual = _solved(process, nodes, degree, rule, weight)
    twin = nodes if longer is None else longer
    enriched, _ = _solved(process, twin, degree + ENRICHMENT, rule + ENRICHMENT, weight)
    weights, p = _weights(nodes, rule), answer.at_gauss(rule)
    if longer is None:
        better = enriched.at_gauss(rule)
    else:
        H1, H2 = gauss_energies(nodes, rule)
        better = by_element(enriched(H1.reshape(-1, 1), H2.ravel()), len(H1), len(H2))
    rounding = ROUND_OFF * degree**2 * weights.shape[0] ** 0.5
    if weight is not None:
        H1, H2 = gauss_energies(nodes, rule)
        terms = by_element(weight.terms(H1.reshape(-1, 1), H2.ravel()), len(H1), len(H2))
        rounding += ROUND_OFF * float(np.sum(weights * np.abs(p) * terms))
    return judged(
        process,
        answer,
        enriched,
        (p, better, weights),
        tol=tol,
        tail=float(_tails(p, weights, nodes, rule).sum()),
        rounding=rounding,
        residual=residual,
    )


def _sizes(nodes: Nodes) -> Array:
    first, second = np.meshgrid(np.diff(nodes[0]), np.diff(nodes[1]), indexing="ij")
    return np.stack([first.ravel(), second.ravel()], axis=1)


def _weights(nodes: Nodes, rule: int) -> Array:
    _, w = gauss_rule(rule)
    return np.asarray(np.prod(_sizes(nodes), axis=1)[:, None, None] * np.multiply.outer(w, w))


def _solved(
    process: Process, nodes: Nodes, degree: int, rule: int, weight: Weight | None
) -> tuple[TensorPolynomial, float]:
    sizes, weights = _sizes(nodes), _weights(nodes, rule)
    coefficients = coefficients_at(process, nodes, rule)
    if weight is not None:
        w, slopes = weight_at_gauss(weight, nodes, rule)
        coefficients, weights = weighted(coefficients, w, slopes), weights * w
    matrices = element_matrices(coefficients, sizes, degree, rule)
    phi, _ = shapes_at_gauss(degree, rule)
    masses = (phi @ weights @ phi.T).reshape(len(sizes), -1)[:, local_order(degree)[0]]
    counts = (nodes[0].size - 1, nodes[1].size - 1)
    try:
        found = null_vector(matrices, masses, counts, degree)
    except np.linalg.LinAlgError:
        raise NotCertified("the stationary equation has no unique solution on this mesh") from None
    k = degree + 1
    polynomial = TensorPolynomial(nodes, degree, found.coefficients.reshape(-1, k, k), weight)
    return polynomial, found.residual


def _tails(p: Array, weights: Array, nodes: Nodes, rule: int) -> Array:
    """Mass beyond each far edge, from p and its quadrature weights at the Gauss points."""
    counts = (nodes[0].size - 1, nodes[1].size - 1)
    _, w = gauss_rule(rule)
    mass = (p * weights).reshape(*counts, w.size, w.size)
    tails = []
    for axis, (H, n) in enumerate(zip(gauss_energies(nodes, rule), nodes, strict=True)):
        blocks = mass if axis == 0 else mass.transpose(1, 0, 3, 2)
        along = np.abs(blocks[-1].sum(axis=(0, 2))) / (w * (n[-1] - n[-2]))
        tails.append(mass_beyond(H[-1], along))
    return np.array(tails)


def _too_coarse(p: TensorPolynomial) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Intervals whose highest modes hold too much, at least the worst one, or where p < 0."""
    counts = (p.nodes[0].size - 1, p.nodes[1].size - 1)
    area = np.prod(_sizes(p.nodes), axis=1)
    size = np.abs(p.coefficients) * area[:, None, None]
    first = size[:, -2:, :].sum(axis=(1, 2)).reshape(counts).sum(axis=1)
    second = size[:, :, -2:].sum(axis=(1, 2)).reshape(counts).sum(axis=0)
    limit = 0.1 * max(first.max(), second.max())
    values = p.at_gauss(p.degree)
    negative = (values.min(axis=(1, 2)) < NEGATIVE * values.max()).reshape(counts)
    return (first > limit) | negative.any(axis=1), (second > limit) | negative.any(axis=0)


def _longer(nodes: Array, wanted: bool) -> Array:
    """The nodes with another interval as long as the last one, where ``wanted``."""
    return np.append(nodes, 2.0 * nodes[-1] - nodes[-2]) if wanted else nodes
