"""Certified finite element solution of the stationary FPK equation of two energies, Eq. (19)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.density import Certificate
from fpk.errors import InvalidInput, NotCertified
from fpk.line.elements import gauss_rule, shape_functions, shapes_at_gauss
from fpk.plane.condensation import null_vector
from fpk.plane.elements import coefficients_at, element_matrices
from fpk.plane.mesh import Survey, axis_nodes, bisected, surveyed
from fpk.vector_process import VectorProcess

Array = NDArray[np.float64]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer along both axes."""
SAFETY = 2.0
"""As for one energy: at an algebraic singularity the enriched solution keeps part of the error."""
SHARE = 0.2
"""Part of the tolerance that each interval of the first mesh is planned to use up."""
NEARLY = 30.0
"""An estimate within so many tolerances is met by two degrees more rather than by more elements."""
MOST_DEGREE = 20
MOST_ROUNDS = 12
MOST_UNKNOWNS = 100_000
ROUND_OFF = 4e-16
NEGATIVE = 0.1
"""Share of the estimated error that the mass of negative values may make up: a polynomial of the
right size everywhere else undershoots where p is far smaller than the tolerance."""
RESIDUAL = 1e-12
CHUNK = 8192


@dataclass(frozen=True, eq=False)
class TensorPolynomial:
    """Continuous piecewise polynomial of two energies on a tensor mesh.

    ``nodes`` along each axis; ``coefficients`` (elements, degree+1, degree+1), the elements running
    along H2 fastest, of products of line shape functions.
    """

    nodes: tuple[Array, Array]
    degree: int
    coefficients: Array

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


@dataclass(frozen=True, eq=False)
class PlaneSolution:
    """Finite element density p(H1, H2) with its error estimate and certificate.

    ``undershoot`` is ∫ max(−p, 0), the mass of its negative values.
    """

    process: VectorProcess
    answer: TensorPolynomial
    enriched: TensorPolynomial
    l1_error: float
    undershoot: float
    certificate: Certificate

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Nodes along H1 and H2."""
        return self.answer.nodes

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.answer.degree + 1 for x in self.nodes)
        return first * second

    def density(self, H1: Array, H2: Array) -> Array:
        """p_h at energies that broadcast together; 0 outside the mesh."""
        return self.answer(H1, H2)

    def pointwise_error(self, H1: Array, H2: Array) -> Array:
        """Estimate of |p_h − p| at energies that broadcast together."""
        p = self.answer(H1, H2)
        floor = self.certificate.tail_mass + ROUND_OFF * self.answer.degree**2
        return np.asarray(SAFETY * np.abs(p - self.enriched(H1, H2)) + floor * np.abs(p))


def solve_plane(
    process: VectorProcess, *, tol: float = 1e-10, degree: int | None = None
) -> PlaneSolution:
    """Return the stationary density of two energies to the L1 tolerance ``tol``.

    No boundary condition is imposed: at H_i = 0 the diffusion across vanishes, and zero flux is
    natural there and at the far edges. Degree and first mesh follow from ``tol`` and from what the
    density would be if no probability flowed. The estimate is the distance to a solution of two
    degrees more; until it meets ``tol`` the mesh is made longer where mass lies beyond, the degree
    raised where little is missing, and intervals whose highest modes are too large are halved.

    Raises ``NotCertified`` where the density does not fall off, ``InvalidInput`` for a process
    that has not two energies.
    """
    if process.dimension != 2:
        raise InvalidInput("process", process.dimension, "must have two energies")
    fixed = degree is not None
    degree = int(np.clip(round(-1.6 * np.log10(tol)), 4, 18)) if degree is None else degree
    survey = surveyed(process)
    pair = _first_nodes(process, survey, degree, tol)
    for _ in range(MOST_ROUNDS):
        solution = solve_plane_on_mesh(process, pair, degree, tol=tol)
        if solution.l1_error <= tol and solution.undershoot <= NEGATIVE * solution.l1_error:
            break
        tails = _tails(solution.answer)
        beyond = tails > 0.1 * tol
        near = solution.l1_error - 2.0 * float(tails.sum()) <= NEARLY * tol
        if near and not fixed and not np.any(beyond) and degree + 2 <= MOST_DEGREE:
            degree += 2
            continue
        finer = pair
        if not near or not np.any(beyond):
            marked = _too_coarse(solution)
            finer = (bisected(pair[0], marked[0]), bisected(pair[1], marked[1]))
        finer = (_longer(finer[0], beyond[0]), _longer(finer[1], beyond[1]))
        if (finer[0].size - 1) * (finer[1].size - 1) * (degree + 1) ** 2 > MOST_UNKNOWNS:
            break
        pair = finer
    return solution


def _first_nodes(
    process: VectorProcess, survey: Survey, degree: int, tol: float
) -> tuple[Array, Array]:
    first, second = (
        scale * axis_nodes(survey, axis, tail=1e-2 * tol, tol=SHARE * tol, degree=degree)
        for axis, scale in enumerate(process.energy_scales)
    )
    return first, second


def solve_plane_on_mesh(
    process: VectorProcess, nodes: tuple[Array, Array], degree: int, *, tol: float = np.inf
) -> PlaneSolution:
    """Return the finite element solution on a given tensor mesh, for convergence studies."""
    answer, residual, fluxless = _solved(process, nodes, degree)
    enriched, _, _ = _solved(process, nodes, degree + ENRICHMENT)
    weights = _weights(nodes, degree)
    p, better = answer.at_gauss(degree), enriched.at_gauss(degree)
    distance = float(np.sum(weights * np.abs(p - better)))
    tails = _tails(answer)
    tail = float(tails.sum())
    estimate = SAFETY * distance + 2.0 * tail + ROUND_OFF * degree**2 * weights.shape[0] ** 0.5
    minimum = float(p.min() / p.max())
    undershoot = float(np.sum(weights * np.maximum(-p, 0.0)))
    checks = {
        f"the density falls to {minimum:.2g} of its maximum, by more than its error explains": (
            undershoot > NEGATIVE * estimate
        ),
        f"the estimated error {estimate:.2g} exceeds the tolerance {tol:.2g}": not estimate <= tol,
        f"the algebraic residual is {residual:.2g}": not residual < RESIDUAL,
        "the density does not fall off at the far edges": not np.isfinite(tail),
    }
    certificate = Certificate(
        mass_defect=abs(float(np.sum(weights * p)) - 1.0),
        minimum=minimum,
        residual=residual,
        tail_mass=tail,
        net_flux=fluxless,
        failures=tuple(words for words, failed in checks.items() if failed),
    )
    return PlaneSolution(process, answer, enriched, estimate, undershoot, certificate)


def _sizes(nodes: tuple[Array, Array]) -> Array:
    first, second = np.meshgrid(np.diff(nodes[0]), np.diff(nodes[1]), indexing="ij")
    return np.stack([first.ravel(), second.ravel()], axis=1)


def _weights(nodes: tuple[Array, Array], degree: int) -> Array:
    _, w = gauss_rule(degree)
    return np.asarray(np.prod(_sizes(nodes), axis=1)[:, None, None] * np.multiply.outer(w, w))


def _solved(
    process: VectorProcess, nodes: tuple[Array, Array], degree: int
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


def _too_coarse(solution: PlaneSolution) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Intervals of each axis whose highest modes hold too much; at least the worst one."""
    p = solution.answer
    counts = (p.nodes[0].size - 1, p.nodes[1].size - 1)
    area = np.prod(_sizes(p.nodes), axis=1)
    size = np.abs(p.coefficients) * area[:, None, None]
    first = size[:, -2:, :].sum(axis=(1, 2)).reshape(counts).sum(axis=1)
    second = size[:, :, -2:].sum(axis=(1, 2)).reshape(counts).sum(axis=0)
    limit = 0.1 * max(first.max(), second.max())
    return first > limit, second > limit


def _longer(nodes: Array, wanted: bool) -> Array:
    """The nodes with another interval as long as the last one, where ``wanted``."""
    return np.append(nodes, 2.0 * nodes[-1] - nodes[-2]) if wanted else nodes
