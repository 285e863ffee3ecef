"""The Gaussian stationary density of a system without contacts, exact for any damping and noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from averaging.gamma_sum import gamma_sum_density
from fpk.certificate import Measured
from fpk.density import Density, certified_density
from fpk.errors import NotApplicable
from fpk.linear import LinearCovariance, linear_covariance
from fpk.method import Method, Plan, Progress, Result, check_solver
from fpk.observable import Observable, observable_name
from fpk.route import ROUTES, Route, register
from fpk.system import System

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]

REACH = 8.5
"""Half-width of the support in standard deviations."""
TAIL = 1.9e-17
"""Probability of one coordinate beyond ``REACH`` on both sides, erfc(8.5/√2)."""
WIDTH = 3.0
"""Largest width of a panel in standard deviations of one coordinate given the other."""
PANELS = (17, 120)
"""Least and largest number of panels along an axis. More than the latter would be needed for
correlations above 0.999; the mass is measured in uncorrelated coordinates then."""
EPS = float(np.finfo(float).eps)
PROVENANCE: Provenance = {"equation": "Lyapunov"}


@dataclass(frozen=True)
class Linear(Method):
    """Gaussian density with the covariance of the Lyapunov equation, for a scene without contact.

    It is the exact stationary density of the full linear system; averaging does not reproduce it
    unless (8) holds, and the difference is the averaging error. ``tol`` is the L1 tolerance.
    """

    tol: float = 1e-10

    def __post_init__(self) -> None:
        """Refuse a tolerance that double precision cannot meet."""
        check_solver(self.solver, (self.solver,), self.tol)

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["linear", "closed-form"]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it is not Gaussian."""
        if system.contacts:
            raise NotApplicable("the system has contacts, so its density is not Gaussian")
        modal = system.fact(linear_covariance)
        if np.max(modal.variance) <= 0.0:
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
            densities = tuple(self._density(system, modal, o) for o in observables)
            return Result(self, densities, settings=PROVENANCE)

        return Plan(refusal, solve)

    def refined(self) -> Self:
        """Return the method with a tolerance ten times smaller, down to 1e-12."""
        return replace(self, tol=max(0.1 * self.tol, 1e-12))

    def _density(self, system: System, modal: LinearCovariance, observable: Observable) -> Density:
        if observable[0].kind == "H":
            # H = ½ |x|² of x = (ω Q, P): a sum of gamma variables of shape ½ with the scales λ_j.
            return gamma_sum_density(
                np.maximum(modal.variance, 0.0),
                0.5,
                modal.variance_error,
                observable,
                residual=modal.residual,
                tol=self.tol,
                provenance=PROVENANCE,
            )
        root = modal.axes * np.sqrt(np.maximum(modal.variance, 0.0))
        n = system.n
        factor = np.vstack(
            [
                (modal.shapes / modal.omega) @ root[:n],
                system.mass[:, None] * modal.shapes @ root[n:],
            ]
        )
        return gaussian_density(
            factor,
            observable,
            relative=modal.relative_error,
            residual=modal.residual,
            tol=self.tol,
            provenance=PROVENANCE,
        )


def gaussian_density(
    factor: Array,
    observable: Observable,
    *,
    relative: float,
    residual: float,
    tol: float,
    provenance: Provenance | None = None,
) -> Density:
    """Return the density of one or two of x = (q, p) = F ξ, ξ independent standard Gaussians.

    ``factor`` F (2n, k), so that F Fᵀ is the covariance; nothing of it is lost between strongly
    correlated coordinates. ``relative`` is the relative error of the covariance as a quadratic
    form, ``residual`` that of the equation which it solves.
    """
    n = factor.shape[0] // 2
    rows = factor[[(c.index or 0) + (n if c.kind == "p" else 0) for c in observable]]
    count = len(observable)
    scale = np.linalg.norm(rows, axis=1)
    # x/scale = L y with independent standard y: L of the rows' QR.
    L = np.asarray(qr((rows / scale[:, None]).T, mode="r")[0][:count].T)
    # Round-off of the rows counts by the condition of L.
    relative += 8.0 * EPS * factor.shape[1] * float(np.linalg.cond(L))
    norm = (2.0 * np.pi) ** (-0.5 * count) / float(np.abs(np.prod(np.diag(L))) * np.prod(scale))
    pieces = int(np.clip(np.ceil(2.0 * REACH / WIDTH / np.min(np.abs(np.diag(L)))), *PANELS))
    panels = tuple(np.linspace(-REACH * s, REACH * s, pieces + 1) for s in scale)

    standard = np.linspace(-REACH, REACH, PANELS[0] + 1)

    def distance(x: Sequence[Array]) -> Array:
        z = np.stack(np.broadcast_arrays(*x), axis=0) / scale.reshape(-1, *[1] * np.ndim(sum(x)))
        y = solve_triangular(L, z.reshape(count, -1), lower=True)
        return np.asarray(np.sum(y * y, axis=0).reshape(z.shape[1:]))

    def pointwise(*x: Array) -> Array:
        # d ln p = ½ yᵀ E y − ½ tr E, where E = L⁻¹ dR L⁻ᵀ is at most ``relative`` in norm.
        square = distance(x)
        return np.asarray(0.5 * relative * (square + count) * norm * np.exp(-0.5 * square))

    tail = TAIL * count
    return certified_density(
        observable,
        panels,
        lambda *x: norm * np.exp(-0.5 * distance(x)),
        pointwise,
        measured=Measured(count * relative + tail, np.nan, np.inf, residual, tail),
        tol=tol,
        frame=(scale[:, None] * L, (standard,) * count) if pieces == PANELS[1] else None,
        provenance=provenance,
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
