"""Finite elements for the stationary FPK equation of two energies, Eq. (19): p itself, expanded.

They need no guess of p, and take the more elements the smaller the smallest p is to be right.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.line.elements import gauss_rule, shape_functions, shapes_at_gauss
from fpk.plane.condensation import null_vector
from fpk.plane.elements import coefficients_at, element_matrices
from fpk.plane.mesh import Survey, axis_nodes, bisected
from fpk.plane.solution import NEGATIVE, PlaneSolution, judged
from fpk.vector_process import VectorProcess

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
ROUND_OFF = 4e-16
CHUNK = 8192


@dataclass(frozen=True, eq=False)
class TensorPolynomial:
    """Continuous piecewise polynomial of two energies on a tensor mesh.

    ``nodes`` along each axis; ``coefficients`` (elements, degree+1, degree+1), the elements running
    along H2 fastest, of products of line shape functions.
    """

    nodes: Nodes
    degree: int
    coefficients: Array

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.degree + 1 for x in self.nodes)
        return first * second

    def rounding(self, H1: Array, H2: Array) -> Array:
        """Relative round-off of p at energies that broadcast together."""
        return np.full(np.broadcast_shapes(H1.shape, H2.shape), ROUND_OFF * self.degree**2)

    def __call__(self, H1: Array, H2: Array) -> Array:
        """Values at energies that broadcast together; 0 outside the mesh."""
        x, y = np.broadcast_arrays(np.asarray(H1, float), np.asarray(H2, float))
        flat = np.empty(x.size)
        for start in range(0, x.size, CHUNK):
            part = slice(start, start + CHUNK)
            flat[part] = self._at(x.ravel()[part], y.ravel()[part])
        return flat.reshape(x.shape)

    def at_gauss(self, rule: int) -> Array:
        """Values (elements, points, points) at the Gauss points that go with degree ``rule``."""
        phi, _ = shapes_at_gauss(self.degree, rule)
        return np.asarray(phi.T @ self.coefficients @ phi)

    def _at(self, x: Array, y: Array) -> Array:
        places, shapes, inside = [], [], np.ones(x.size, dtype=bool)
        for values, nodes in zip((x, y), self.nodes, strict=True):
            k = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, nodes.size - 2)
            t = (values - nodes[k]) / (nodes[k + 1] - nodes[k])
            inside &= (values >= nodes[0]) & (values <= nodes[-1])
            places.append(k)
            shapes.append(shape_functions(self.degree, np.clip(t, 0.0, 1.0))[0])
        element = places[0] * (self.nodes[1].size - 1) + places[1]
        value = np.einsum("ix,xij,jx->x", shapes[0], self.coefficients[element], shapes[1])
        return np.where(inside, value, 0.0)


def solve_by_elements(
    process: VectorProcess, survey: Survey, *, tol: float, degree: int | None, strict: bool = True
) -> PlaneSolution:
    """Return the finite element solution to the L1 tolerance ``tol``, adapting the mesh.

    Degree and first mesh follow from ``tol`` and the ``survey``. The mesh is made longer where mass
    lies beyond, the degree raised where little is missing, and intervals are halved whose highest
    modes are too large or, if ``strict``, where p is negative: until the certificate holds, or
    without ``strict`` the tolerance, or the limits are reached.
    """
    fixed = degree is not None
    degree = int(np.clip(round(-1.6 * np.log10(tol)), 4, 18)) if degree is None else degree
    pair = _first_nodes(process, survey, degree, tol)
    if not _affordable(pair, degree):
        raise NotCertified(f"the tolerance {tol:.2g} takes more elements than are affordable")
    for _ in range(MOST_ROUNDS):
        solution = solve_plane_on_mesh(process, pair, degree, tol=tol)
        if solution.certificate.certified or (not strict and solution.l1_error <= tol):
            break
        answer = solution.answer
        assert isinstance(answer, TensorPolynomial)
        tails = _tails(answer)
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


def _first_nodes(process: VectorProcess, survey: Survey, degree: int, tol: float) -> Nodes:
    first, second = (
        scale * axis_nodes(survey, axis, tail=1e-2 * tol, tol=SHARE * tol, degree=degree)
        for axis, scale in enumerate(process.energy_scales)
    )
    return first, second


def solve_plane_on_mesh(
    process: VectorProcess, nodes: Nodes, degree: int, *, tol: float = np.inf
) -> PlaneSolution:
    """Return the finite element solution on a given tensor mesh, for convergence studies."""
    answer, residual, fluxless = _solved(process, nodes, degree)
    enriched, _, _ = _solved(process, nodes, degree + ENRICHMENT)
    weights = _weights(nodes, degree)
    p, better = answer.at_gauss(degree), enriched.at_gauss(degree)
    return judged(
        process,
        answer,
        enriched,
        (p, better, weights),
        tol=tol,
        tail=float(_tails(answer).sum()),
        rounding=ROUND_OFF * degree**2 * weights.shape[0] ** 0.5,
        residual=residual,
        net_flux=fluxless,
    )


def _sizes(nodes: Nodes) -> Array:
    first, second = np.meshgrid(np.diff(nodes[0]), np.diff(nodes[1]), indexing="ij")
    return np.stack([first.ravel(), second.ravel()], axis=1)


def _weights(nodes: Nodes, degree: int) -> Array:
    _, w = gauss_rule(degree)
    return np.asarray(np.prod(_sizes(nodes), axis=1)[:, None, None] * np.multiply.outer(w, w))


def _solved(
    process: VectorProcess, nodes: Nodes, degree: int
) -> tuple[TensorPolynomial, float, float]:
    sizes = _sizes(nodes)
    matrices = element_matrices(coefficients_at(process, nodes, degree), sizes, degree)
    _, w = gauss_rule(degree)
    line = shapes_at_gauss(degree, degree)[0] @ w
    masses = np.prod(sizes, axis=1)[:, None] * np.multiply.outer(line, line).ravel()
    counts = (nodes[0].size - 1, nodes[1].size - 1)
    try:
        found = null_vector(matrices, masses, counts, degree)
    except np.linalg.LinAlgError:
        raise NotCertified("the stationary equation has no unique solution on this mesh") from None
    k = degree + 1
    polynomial = TensorPolynomial(nodes, degree, found.coefficients.reshape(-1, k, k))
    # The vertex functions of an element sum to one: their rows add up to zero in exact arithmetic.
    corners = np.array([0, 1, k, k + 1])
    through = np.abs((matrices[:, corners] @ found.coefficients[:, :, None]).sum(axis=1))
    parts = (np.abs(matrices[:, corners]) @ np.abs(found.coefficients)[:, :, None]).sum(axis=1)
    return polynomial, found.residual, float(through.max() / parts.max())


def _tails(p: TensorPolynomial) -> Array:
    """Mass beyond each far edge: of the marginal, continued at half the rate of its last interval.

    The half allows for a rate that drops with the energy. Infinite where the marginal does not
    fall over that interval.
    """
    _, w = gauss_rule(p.degree)
    line = shapes_at_gauss(p.degree, p.degree)[0] @ w
    counts = (p.nodes[0].size - 1, p.nodes[1].size - 1)
    tails = []
    for axis in (0, 1):
        blocks = p.coefficients.reshape(*counts, p.degree + 1, p.degree + 1)
        if axis == 1:
            blocks = blocks.transpose(1, 0, 3, 2)
        # The two vertex values of the last interval, the other energy integrated out.
        low, high = np.einsum("e,evj,j->v", np.diff(p.nodes[1 - axis]), blocks[-1, :, :2], line)
        length = p.nodes[axis][-1] - p.nodes[axis][-2]
        falls = abs(high) < abs(low)
        rate = 0.5 * np.log(abs(low) / abs(high)) / length if falls else 0.0
        tails.append(abs(high) / rate if falls else np.inf)
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
