"""Linear scenes: the Gaussian density whose covariance solves the Lyapunov equation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from averaging.gaussian_state import Gaussian
from averaging.theory import Theory, energy_only_refusal
from fpk.errors import NotApplicable
from fpk.linear import linear_covariance
from fpk.method import Plan, Progress, Result
from fpk.observable import Observable
from fpk.system import System


@dataclass(frozen=True)
class Linear(Theory):
    """Gaussian density with the covariance of the Lyapunov equation, for a scene without contact.

    It is the exact stationary density of the full linear system; averaging does not reproduce it
    unless (8) holds, and the difference is the averaging error.
    """

    method = "linear"
    solvers = (("closed-form", "Gaussian, exact without contact", "(6)"),)
    colour = "#5b8def"

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it is not Gaussian."""
        if system.contacts:
            raise NotApplicable("the system has contacts, so its density is not Gaussian")
        modes = system.fact(linear_covariance)
        if np.max(modes.variance) <= 0.0:
            raise NotApplicable("no noise reaches a mass, so its density is concentrated at rest")

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            variance = np.maximum(modes.variance, 0.0)
            # H = ½ |x|² of x = (ω Q, P).
            to_state = block_diag(modes.shapes / modes.omega, system.mass[:, None] * modes.shapes)
            gaussian = Gaussian(
                factor=to_state @ modes.axes * np.sqrt(variance),
                relative_error=modes.relative_error,
                scales=variance,
                shape=0.5,
                scale_errors=modes.variance_error,
                residual=modes.residual,
            )
            densities = tuple(gaussian.density(o, tol=self.tol) for o in observables)
            return Result(self, densities, settings={"equation": "Lyapunov"})

        return Plan(lambda observable: energy_only_refusal(system, observable), solve)


Linear.register()
