"""A stationary density of two energies, with the estimate of its error and its certificate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Certificate, Measured, certify
from fpk.plane.mesh import Nodes
from fpk.plane.weighted import WeightedPolynomial
from fpk.process import Process

Array = NDArray[np.float64]

SAFETY = 2.0
"""Factor on the distance to the enriched solution: at an algebraic singularity that one keeps part
of the error."""


@dataclass(frozen=True, eq=False)
class PlaneSolution:
    """Density p(H1, H2), what was measured on it, and its certificate.

    ``enriched`` is the solution of a higher degree that the error estimate compares with;
    ``relative_error`` of p comes from what lies outside the mesh and from the integral of p.
    """

    process: Process
    answer: WeightedPolynomial
    enriched: WeightedPolynomial
    relative_error: float
    measured: Measured
    certificate: Certificate

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    @property
    def nodes(self) -> Nodes:
        """Energies along H1 and H2 between which p_h is smooth; the last is its end."""
        return self.answer.nodes

    @property
    def unknowns(self) -> int:
        """Number of unknowns solved for."""
        return self.answer.unknowns

    def density(self, H1: Array, H2: Array) -> Array:
        """p_h at energies that broadcast together; 0 outside the nodes."""
        return self.answer(H1, H2)

    def pointwise_error(self, H1: Array, H2: Array) -> Array:
        """Estimate of |p_h − p| at energies that broadcast together."""
        x, y = np.asarray(H1, float), np.asarray(H2, float)
        p = self.answer(x, y)
        relative = self.relative_error + self.answer.rounding(x, y)
        return np.asarray(SAFETY * np.abs(p - self.enriched(x, y)) + relative * np.abs(p))


def mass_beyond(H: Array, along: Array) -> float:
    """Mass beyond the last of the energies ``H`` of the last panel, from the marginal ``along``.

    The marginal is continued at half its logarithmic slope over that panel, as the slope may drop
    with the energy. Infinite where the marginal does not fall over the panel.
    """
    low, high = float(along[0]), float(along[-1])
    if not high < low:
        return np.inf
    return high * float(H[-1] - H[0]) / (0.5 * np.log(low / high)) if high > 0.0 else 0.0


def assessed(
    process: Process,
    answer: WeightedPolynomial,
    enriched: WeightedPolynomial,
    values: tuple[Array, Array, Array],
    *,
    tol: float,
    tail: float,
    rounding: float,
    residual: float,
) -> PlaneSolution:
    """Return ``answer`` with the estimate of its L1 error and its certificate.

    ``values``: p, the enriched p and quadrature weights at the same points; ``tail`` the mass
    beyond the mesh, which is missing there and too much elsewhere, as p has mass 1; ``rounding``
    the L1 norm of the round-off of p, ``residual`` that of the algebraic equations.
    """
    p, better, weights = values
    distance = float(np.sum(weights * np.abs(p - better)))
    mass_defect = abs(float(np.sum(weights * p)) - 1.0)
    relative = tail + mass_defect
    measured = Measured(
        l1_error=SAFETY * distance + tail + relative + rounding,
        mass_defect=mass_defect,
        minimum=float(p.min() / p.max()),
        residual=residual,
        tail_mass=tail,
    )
    return PlaneSolution(process, answer, enriched, relative, measured, certify(measured, tol=tol))
