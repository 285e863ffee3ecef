"""The Gaussian stationary density of a system without contacts, exact for any damping and noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.stats import gamma as gamma_distribution
from scipy.stats import multivariate_normal, norm

from fpk.certificate import Certificate
from fpk.density import Density
from fpk.errors import NotApplicable
from fpk.linear import diffusion_matrix, drift_matrix, stationary_covariance
from fpk.method import Method, Plan, Progress, Result
from fpk.observable import Observable, observable_name
from fpk.route import ROUTES, Route, register
from fpk.system import System

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]

REACH = 8.5
"""Half-width of the support in standard deviations; 2e-17 of the mass lies beyond."""
SERIES_TERMS = 2000
LARGEST_ERROR = 1e-6
"""Relative error of the covariance, a bound from the residual, above which it is not certified."""


@dataclass(frozen=True)
class Linear(Method):
    """Gaussian density with the covariance of the Lyapunov equation, for a scene without contact.

    It is the exact stationary density of the full linear system; averaging does not reproduce it
    unless (8) holds, and the difference is the averaging error.
    """

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["linear", "closed-form"]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it is not Gaussian."""
        if system.contacts:
            raise NotApplicable("the system has contacts, so its density is not Gaussian")
        covariance = stationary_covariance(system)
        if np.min(np.diag(covariance)) <= 0:
            raise NotApplicable("no noise reaches a mass, so its density is concentrated at rest")

        def refusal(observable: Observable) -> str | None:
            kinds = [c.kind for c in observable]
            if "H" in kinds and (len(observable) > 1 or observable[0].index is not None):
                return (
                    f"{observable_name(observable)}: of the energies, only the density of the "
                    "total energy H is available"
                )
            return None

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            A, b = drift_matrix(system), diffusion_matrix(system)
            residual = A @ covariance + covariance @ A.T + b
            error = float(np.max(np.abs(residual)) / np.max(np.abs(A @ covariance)))
            # The covariance answers the residual through the slowest mode.
            rate = -float(np.max(np.linalg.eigvals(A).real))
            relative = error * max(1.0, float(np.max(np.abs(np.linalg.eigvals(A)))) / rate)
            densities = tuple(
                _energy(system, covariance, o, relative)
                if o[0].kind == "H"
                else gaussian_density(
                    covariance, o, relative=relative, provenance={"equation": "Lyapunov"}
                )
                for o in observables
            )
            return Result(self, densities, settings={"equation": "Lyapunov"})

        return Plan(refusal, solve)

    def refined(self) -> Self:
        """Return itself: there is nothing to refine."""
        return self


def _certificate(residual: float, tail: float) -> Certificate:
    failures: tuple[str, ...] = ()
    if not residual < LARGEST_ERROR:
        failures = (f"the covariance is known to a relative {residual:.2g} only",)
    return Certificate(
        mass_defect=tail, minimum=0.0, residual=residual, tail_mass=tail, failures=failures
    )


def gaussian_density(
    covariance: Array, observable: Observable, *, relative: float, provenance: Provenance
) -> Density:
    """Return the density of one or two of x = (q, p) from the covariance of x, shape (2n, 2n).

    ``relative`` is the relative error of the covariance, as a quadratic form.
    """
    n = covariance.shape[0] // 2
    rows = [(c.index or 0) + (n if c.kind == "p" else 0) for c in observable]
    part = covariance[np.ix_(rows, rows)]
    scale = np.sqrt(np.diag(part))
    count = scale.size
    correlation = part / np.outer(scale, scale)
    # Round-off of the single elements counts by the norm of R⁻¹; ``relative`` is that of the form.
    relative += 1e-15 * count / float(np.linalg.eigvalsh(correlation)[0])
    panels = tuple(np.linspace(-REACH * s, REACH * s, 18) for s in scale)
    tail = 2.0 * count * float(norm.sf(REACH))

    def pdf(*x: Array) -> Array:
        points = np.stack(np.broadcast_arrays(*x), axis=-1).astype(float)
        return np.asarray(multivariate_normal(cov=part).pdf(points)).reshape(points.shape[:-1])

    def pointwise(*x: Array) -> Array:
        # With z = x/scale and correlations R: d ln p = ½ zᵀR⁻¹ dR R⁻¹z − ½ tr(R⁻¹ dR), and
        # |dR| <= relative R in the sense of quadratic forms.
        z = np.stack(np.broadcast_arrays(*x), axis=-1) / scale
        distance = np.einsum("...i,ij,...j->...", z, np.linalg.inv(correlation), z)
        return np.asarray(relative * 0.5 * (distance + count) * pdf(*x))

    l1_error = 2.0 * count * relative + tail
    return Density(
        observable,
        panels,
        pdf,
        pointwise,
        l1_error,
        _certificate(relative, tail),
        provenance,
    )


def _energy(system: System, covariance: Array, observable: Observable, relative: float) -> Density:
    """Density of H, a positive quadratic form of a Gaussian vector, as a series of gamma densities.

    Moschopoulos (1985), Ann. Inst. Statist. Math. 37, 541-544: H = ½ Σ λ_j χ²_1 is a mixture of
    gamma densities of the least scale with positive weights, so the weight left out is the error.
    """
    n = system.n
    G = np.zeros((2 * n, 2 * n))
    G[:n, :n] = system.stiffness_matrix
    G[n:, n:] = np.diag(1.0 / system.mass)
    # H = ½ xᵀ G x: scales λ_j of ½ λ_j χ²_1, a gamma density of shape ½ and scale λ_j.
    scales = eigh(covariance, np.linalg.inv(G), eigvals_only=True)
    least = float(scales[0])
    ratio = 1.0 - least / scales
    weights = np.zeros(SERIES_TERMS)
    weights[0] = np.prod(np.sqrt(least / scales))
    powers = 0.5 * np.sum(np.cumprod(np.tile(ratio, (SERIES_TERMS, 1)), axis=0), axis=1)
    count = SERIES_TERMS
    for k in range(1, SERIES_TERMS):
        weights[k] = np.dot(powers[:k], weights[k - 1 :: -1][:k]) / k
        if 1.0 - weights[: k + 1].sum() < 1e-15:
            count = k + 1
            break
    weights = weights[:count]
    left_out = max(1.0 - float(weights.sum()), 0.0)
    end = float(scales[-1]) * 40.0 + float(np.sum(scales))
    tail = float(gamma_distribution.sf(end, n, scale=scales[-1]))
    shapes = n + np.arange(count)

    def pdf(energy: Array) -> Array:
        x = np.asarray(energy, dtype=float)
        terms = gamma_distribution.pdf(x[..., None], shapes, scale=least)
        return np.asarray(terms @ weights)

    def pointwise(energy: Array) -> Array:
        x = np.asarray(energy, dtype=float) / least
        return np.asarray((relative + 1e-15) * (x + n) * pdf(energy) + left_out / least)

    return Density(
        observable,
        (np.linspace(0.0, end, 41),),
        pdf,
        pointwise,
        4.0 * n * (relative + 1e-15) + left_out + tail,
        _certificate(relative, tail + left_out),
        {"equation": "Lyapunov"},
    )


register(
    Route(
        "linear",
        "closed-form",
        "Gaussian, exact without contact",
        "(6)",
        "full",
        False,
        "#5b8def",
        make=Linear,
    )
)
