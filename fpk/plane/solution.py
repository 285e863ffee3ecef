"""A stationary density of two energies, with the estimate of its error and its certificate."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Certificate
from fpk.process import Process

Array = NDArray[np.float64]

SAFETY = 2.0
"""As for one energy: at an algebraic singularity the enriched solution keeps part of the error."""
NEGATIVE = -1e-14
"""Smallest p / max p that counts as round-off, as for one energy."""
RESIDUAL = 1e-12


class PlaneDensity(Protocol):
    """p_h of two energies, smooth between ``nodes`` along each axis and 0 outside them."""

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Ascending energies along each axis."""
        ...

    @property
    def degree(self) -> int:
        """Degree of the polynomials along each axis."""
        ...

    @property
    def unknowns(self) -> int:
        """Number of unknowns solved for."""
        ...

    def rounding(self, H1: Array, H2: Array) -> Array:
        """Relative round-off of p_h at energies that broadcast together."""
        ...

    def __call__(self, H1: Array, H2: Array) -> Array:
        """p_h at energies that broadcast together."""
        ...


@dataclass(frozen=True, eq=False)
class PlaneSolution:
    """Density p(H1, H2) with its error estimate and certificate.

    ``enriched`` is a solution of a higher degree; ``relative_error`` of p comes from what lies
    outside the nodes and from the integral of p.
    """

    process: Process
    answer: PlaneDensity
    enriched: PlaneDensity
    l1_error: float
    relative_error: float
    certificate: Certificate

    @property
    def nodes(self) -> tuple[Array, Array]:
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

    It is continued at half the rate of that panel, as that may drop with the energy. Infinite where
    the marginal does not fall over it.
    """
    low, high = float(along[0]), float(along[-1])
    if not high < low:
        return np.inf
    return high * float(H[-1] - H[0]) / (0.5 * np.log(low / high)) if high > 0.0 else 0.0


def judged(
    process: Process,
    answer: PlaneDensity,
    enriched: PlaneDensity,
    values: tuple[Array, Array, Array],
    *,
    tol: float,
    tail: float,
    rounding: float,
    residual: float,
) -> PlaneSolution:
    """Estimate the error of ``answer`` and check what must hold.

    ``values``: p, the enriched p and quadrature weights at the same places; ``tail`` the mass
    beyond them, which lacks there and is too much elsewhere; ``rounding`` relative to p.
    """
    p, better, weights = values
    distance = float(np.sum(weights * np.abs(p - better)))
    mass_defect = abs(float(np.sum(weights * p)) - 1.0)
    relative = tail + mass_defect
    estimate = SAFETY * distance + tail + relative + rounding
    minimum = float(p.min() / p.max())
    checks = {
        f"the density falls to {minimum:.2g} of its maximum": not minimum >= NEGATIVE,
        f"the estimated error {estimate:.2g} exceeds the tolerance {tol:.2g}": not estimate <= tol,
        f"the algebraic residual is {residual:.2g}": not residual < RESIDUAL,
        "the density does not fall off at the far edges": not np.isfinite(tail),
    }
    certificate = Certificate(
        mass_defect=mass_defect,
        minimum=minimum,
        residual=residual,
        tail_mass=tail,
        failures=tuple(words for words, failed in checks.items() if failed),
    )
    return PlaneSolution(process, answer, enriched, estimate, relative, certificate)
