"""The stationary density of two energies p = w u on a tensor mesh, Eq. (19), and its error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from fpk.answer.certificate import Certificate, Measured, certify
from fpk.numeric.arrays import Array
from fpk.numeric.piecewise import PiecewiseTensor
from fpk.numeric.quadrature import gauss_legendre, panel_rule
from fpk.solvers.plane.elements import (
    condensed_null_vector,
    element_matrices,
    flux_coefficients,
    shape_functions,
)
from fpk.solvers.plane.weight import Weight
from fpk.system.process import Process

Nodes = tuple[Array, Array]

SAFETY = 3.0
"""Factor on the distance to the enriched solution: it holds where that one has at the most 2/3 of
the error. In random processes (tests/fpk/test_fpk_plane_random.py) the error is at the most 2.1
times the distance, once in 3,000, and 1.4 times in all others."""
ROUND_OFF = 4e-16
"""Relative round-off of a sum of shape functions, per square of their degree."""
ENRICHMENT = 2
"""Degrees by which the enriched solution exceeds the answer along both axes, and Gauss points by
which the quadrature exceeds the degree."""
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
        """Ends of the elements along H1 and H2."""
        return self.u.nodes

    @property
    def panels(self) -> Nodes:
        """The nodes, halved in √H where a weight has few: between them quadrature of p is exact."""
        first, second = self.nodes
        # On more than four panels a dozen Gauss points integrate w u to round-off.
        while self.weight is not None and first.size <= 4:
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
    def balanced(self) -> bool:
        """Whether no probability flows, so that the weight itself is the density."""
        return self.weight is not None and self.degree == 0

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.degree + 1 for x in self.nodes)
        return first * second

    def density(self, H1: Array, H2: Array) -> Array:
        """p_h at energies that broadcast together; 0 outside the nodes."""
        return weighted(self.u, self.weight, H1, H2)

    def heights(self, H1: Array, H2: Array) -> Array:
        """Return the rise of −ln w from its least value to energies (points,) each."""
        return np.zeros(H1.shape) if self.weight is None else self.weight.exponent(H1, H2)

    def pointwise_error(self, H1: Array, H2: Array) -> Array:
        """Estimate of |p_h − p| at energies that broadcast together."""
        x, y = np.asarray(H1, float), np.asarray(H2, float)
        p = self.density(x, y)
        relative = np.asarray(self.relative_error + ROUND_OFF * self.degree**2)
        if self.weight is not None:
            relative = relative + ROUND_OFF * self.weight.terms(x, y)
        better = weighted(self.enriched, self.weight, x, y)
        return np.asarray(SAFETY * np.abs(p - better) + relative * np.abs(p))


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


def null_function(
    process: Process, nodes: Nodes, degree: int, points: int, weight: Weight | None
) -> tuple[PiecewiseTensor, float]:
    """Return u of a stationary density p = w u on a tensor mesh, and its algebraic residual."""
    counts = (nodes[0].size - 1, nodes[1].size - 1)
    (x, y), _ = gauss_grid(nodes, points)
    coefficients = flux_coefficients(process, x[:, None], y, weight)[1:]
    matrices = element_matrices(coefficients, nodes, degree)
    null, residual = condensed_null_vector(matrices, counts, degree)
    # Shape functions as Legendre series.
    t, share = gauss_legendre(points)
    k = degree + 1
    phi = shape_functions(degree, 0.5 * (1.0 + t))[0] * (0.5 * share)
    series = phi @ legvander(t, degree) * (2.0 * np.arange(k) + 1.0)
    u = (series.T @ null.reshape(-1, k, k) @ series).reshape(*counts, k, k)
    return PiecewiseTensor(nodes, u), residual


def solve_plane_on_mesh(
    process: Process,
    nodes: Nodes,
    degree: int,
    *,
    tol: float = np.inf,
    weight: Weight | None = None,
    longer: bool = False,
    solved: Callable[..., tuple[PiecewiseTensor, float]] = null_function,
) -> PlaneSolution:
    """Return the finite element solution p = w u with u of ``degree`` on a tensor mesh.

    Without a ``weight`` w = 1. If ``longer``, each axis of the mesh of the enriched solution is
    longer, until its marginal has fallen by another e², unless the mass beyond is round-off or the
    marginal does not fall: the estimate then contains 1 − e⁻² = 86 % of the cost of ending the
    mesh. Where probability circulates, zero flux at the far edges is wrong by more than the mass
    beyond. For convergence studies both are on one mesh. ``solved`` is ``null_function`` or another
    function of its arguments.

    Raises ``NotCertified`` where the equations have no unique solution.
    """
    points = degree + ENRICHMENT
    if weight is not None:
        points += WEIGHT_POINTS // min(x.size - 1 for x in nodes)
    (x, y), (v, w) = gauss_grid(nodes, points)

    def of_mass_one(mesh: Nodes, degree: int, count: int) -> tuple[PiecewiseTensor, float]:
        """u by ``count`` points, of mass 1 by a rule of as many, and its residual."""
        u, residual = solved(process, mesh, degree, count, weight)
        energies, weights = gauss_grid(mesh, count)
        p = weighted(u, weight, energies[0][:, None], energies[1])
        return PiecewiseTensor(mesh, u.coefficients / (weights[0] @ p @ weights[1])), residual

    u, residual = of_mass_one(nodes, degree, points)
    p = weighted(u, weight, x[:, None], y)
    mass_defect = abs(float(v @ p @ w) - 1.0)
    beyond, e_fold = tails(p, (x, y), (v, w), points)
    # The mass beyond the mesh is missing there and too much elsewhere, as p has mass 1. The slope
    # of a mass of the size of round-off says nothing.
    tail, reach = float(beyond.sum()), np.where(beyond > ROUND_OFF, 2.0 * longer * e_fold, 0.0)
    first, second = (z * (1.0 + r / z[-1]) for z, r in zip(nodes, reach, strict=True))
    enriched, _ = of_mass_one((first, second), degree + ENRICHMENT, points + ENRICHMENT)
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
