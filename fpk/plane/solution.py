"""The stationary density of two energies p = w u on a tensor mesh, Eq. (19), and its error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from fpk.arrays import Array
from fpk.certificate import Certificate, Measured, certify
from fpk.errors import NotCertified
from fpk.piecewise import PiecewiseTensor
from fpk.plane.condensation import local_order, null_vector
from fpk.plane.elements import (
    by_element,
    coefficients_on_grid,
    element_matrices,
    shape_functions,
)
from fpk.plane.weight import Weight
from fpk.process import Process
from fpk.quadrature import gauss_legendre, panel_rule

Nodes = tuple[Array, Array]

SAFETY = 2.0
"""Factor on the distance to the enriched solution: at an algebraic singularity that one keeps part
of the error."""
ROUND_OFF = 4e-16
"""Relative round-off of a sum of shape functions, per square of their degree."""
FALL = 2.0
"""Nats by which the marginals fall from the ends of the answer to those of the enriched solution:
the difference of the two then holds 86 % of what ending the mesh costs."""
NEGLIGIBLE = 1e-3
"""Mass beyond an edge, relative to the tolerance, at which that is not looked at: where probability
circulates, ending the mesh costs some twenty times the mass beyond."""
PANELS = 4
"""Panels along each axis on which a dozen Gauss points integrate p = w u to round-off."""

ENRICHMENT = 2
"""Degrees by which the enriched solution exceeds the answer along both axes."""
MORE_POINTS = 2
"""Gauss points along each axis of integrals, beyond the degree."""
WEIGHT_POINTS = 20
"""Further points of integrals with a weight, which is no polynomial, shared by the panels; the
enriched solution has two more on each, so that the error estimate contains what they miss."""


@dataclass(frozen=True, eq=False)
class PlaneSolution:
    """Density p(H1, H2) = w u, what was measured on it, and its certificate.

    u is a continuous piecewise polynomial, w = 1 without a ``weight``. ``enriched`` is the u of a
    higher degree that the error estimate compares with; ``relative_error`` of p comes from what
    lies outside the mesh and from the integral of p.
    """

    process: Process
    u: PiecewiseTensor
    enriched: PiecewiseTensor
    weight: Weight | None
    relative_error: float
    measured: Measured
    certificate: Certificate

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    @property
    def nodes(self) -> Nodes:
        """Energies along H1 and H2 between which p_h is smooth; the last is its end.

        With a weight there are ``PANELS`` at least, so that integrals of p_h over them are exact.
        """
        first, second = self.u.nodes
        while self.weight is not None and first.size <= PANELS:
            first, second = (
                np.insert(x, range(1, x.size), 0.25 * (x[1:] ** 0.5 + x[:-1] ** 0.5) ** 2)
                for x in (first, second)
            )
        return first, second

    @property
    def degree(self) -> int:
        """Degree of u along each axis."""
        return int(self.u.coefficients.shape[-1]) - 1

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.degree + 1 for x in self.u.nodes)
        return first * second

    def density(self, H1: Array, H2: Array) -> Array:
        """p_h at energies that broadcast together; 0 outside the nodes."""
        return weighted(self.u, self.weight, H1, H2)

    def enriched_density(self, H1: Array, H2: Array) -> Array:
        """p of the enriched solution at energies that broadcast together; 0 outside its nodes."""
        return weighted(self.enriched, self.weight, H1, H2)

    def pointwise_error(self, H1: Array, H2: Array) -> Array:
        """Estimate of |p_h − p| at energies that broadcast together."""
        x, y = np.asarray(H1, float), np.asarray(H2, float)
        p = self.density(x, y)
        relative = np.asarray(self.relative_error + ROUND_OFF * self.degree**2)
        if self.weight is not None:
            relative = relative + ROUND_OFF * self.weight.terms(x, y)
        return np.asarray(SAFETY * np.abs(p - self.enriched_density(x, y)) + relative * np.abs(p))


def weighted(u: PiecewiseTensor, weight: Weight | None, H1: Array, H2: Array) -> Array:
    """Return w u at energies that broadcast together."""
    values = u(H1, H2)
    return values if weight is None else values * weight(np.asarray(H1), np.asarray(H2))


def graded(ends: Sequence[float] | Array, panels: int) -> Nodes:
    """Return nodes from 0 to the ``ends``, equidistant in √H, the amplitude.

    Where one energy is large the other one's damping may be, and p changes within a layer along the
    axis.
    """
    share = np.linspace(0.0, 1.0, panels + 1) ** 2
    return ends[0] * share, ends[1] * share


def gauss_grid(nodes: Nodes, points: int) -> tuple[Nodes, Nodes]:
    """Return the energies along each axis at the Gauss points of all panels, and their weights."""
    (x, v), (y, w) = (panel_rule(n, points) for n in nodes)
    return (x.ravel(), y.ravel()), (v.ravel(), w.ravel())


def tails(p: Array, energies: Nodes, weights: Nodes, points: int) -> tuple[Array, Array]:
    """Return the mass beyond each far edge (2,) from p on a grid of Gauss points, and an energy.

    ``points`` of each axis belong to the last panel. There the marginal is continued at half its
    logarithmic slope, as the slope may drop with the energy; the mass is infinite where it does not
    fall. The energies (2,) are those over which the marginals fall by the factor e.
    """
    beyond, e_fold = np.zeros(2), np.zeros(2)
    for axis, marginal in enumerate((p @ weights[1], weights[0] @ p)):
        H, along = energies[axis][-points:], np.abs(marginal[-points:])
        low, high = float(along[0]), float(along[-1])
        if not high < low:
            beyond[axis] = np.inf
        elif high > 0.0:
            e_fold[axis] = float(H[-1] - H[0]) / np.log(low / high)
            beyond[axis] = 2.0 * high * e_fold[axis]
    return beyond, e_fold


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
        far = [
            n[-1] + FALL * e * (b > NEGLIGIBLE * tol)
            for n, e, b in zip(nodes, e_fold, beyond, strict=True)
        ]
        first, second = (
            np.append(n[:-1], max(n[-1], end)) for n, end in zip(longer, far, strict=True)
        )
        mesh = first, second
    enriched, _ = _solved(process, mesh, degree + ENRICHMENT, points + ENRICHMENT, weight)
    better = weighted(enriched, weight, x[:, None], y)
    # Round-off of shape functions averages out over the elements, that of a weight does not.
    elements = (nodes[0].size - 1) * (nodes[1].size - 1)
    rounding = ROUND_OFF * degree**2 * elements**0.5
    if weight is not None:
        rounding += ROUND_OFF * float(v @ (np.abs(p) * weight.terms(x[:, None], y)) @ w)
    relative = tail + mass_defect
    measured = Measured(
        l1_error=SAFETY * float(v @ np.abs(p - better) @ w) + tail + relative + rounding,
        mass_defect=mass_defect,
        minimum=float(p.min() / p.max()),
        residual=residual,
        tail_mass=tail,
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
