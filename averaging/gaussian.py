"""The Gaussian stationary density of a system without contacts, exact for any damping and noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from averaging.gaussian_state import Gaussian
from fpk.errors import NotApplicable
from fpk.linear import LinearCovariance, linear_covariance
from fpk.method import Method, Plan, Progress, Result, check_solver
from fpk.observable import Observable, observable_name
from fpk.route import ROUTES, Route, register
from fpk.system import System


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
        modes = system.fact(linear_covariance)
        if np.max(modes.variance) <= 0.0:
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
            gaussian = _stationary(system, modes)
            densities = tuple(gaussian.density(o, tol=self.tol) for o in observables)
            return Result(self, densities, settings={"equation": "Lyapunov"})

        return Plan(refusal, solve)

    def refined(self) -> Self:
        """Return the method with a tolerance ten times smaller, down to 1e-12."""
        return replace(self, tol=max(0.1 * self.tol, 1e-12))


def _stationary(system: System, modes: LinearCovariance) -> Gaussian:
    to_state = block_diag(modes.shapes / modes.omega, system.mass[:, None] * modes.shapes)
    return Gaussian(
        factor=to_state @ modes.axes * np.sqrt(np.maximum(modes.variance, 0.0)),
        relative_error=modes.relative_error,
        # H = ½ |x|² of x = (ω Q, P).
        scales=np.maximum(modes.variance, 0.0),
        shape=0.5,
        scale_errors=modes.variance_error,
        residual=modes.residual,
    )


WORDS = "Gaussian, exact without contact"
register(Route("linear", "closed-form", WORDS, "(6)", "full", False, "#5b8def", make=Linear))
