"""The stationary density of two energies p = w u on a tensor mesh, Eq. (19), and its error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fpk.arrays import Array
from fpk.certificate import Certificate, Measured
from fpk.piecewise import PiecewiseTensor
from fpk.plane.weight import Weight
from fpk.process import Process
from fpk.quadrature import panel_rule

Nodes = tuple[Array, Array]

SAFETY = 3.0
"""Factor on the distance to the enriched solution: it holds where that one has at the most 2/3 of
the error. In random processes (tests/fpk/test_fpk_plane_random.py) the error is at the most 2.1
times the distance, once in 3,000, and 1.4 times in all others."""
ROUND_OFF = 4e-16
"""Relative round-off of a sum of shape functions, per square of their degree."""
PANELS = 4
"""Panels along each axis on which a dozen Gauss points integrate p = w u to round-off."""


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
        first, second = self.u.nodes
        return first, second

    @property
    def panels(self) -> Nodes:
        """The nodes, halved in √H where a weight has few: between them quadrature of p is exact."""
        first, second = self.nodes
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
        first, second = ((x.size - 1) * self.degree + 1 for x in self.nodes)
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
