"""Linear scenes: the Gaussian density whose covariance solves the Lyapunov equation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from averaging.gaussian_state import Gaussian, state_rows
from averaging.linear_dynamics import (
    autocovariance,
    eigenvalue_sums,
    rice_rates,
    spectral_density,
)
from averaging.theory import Theory, energy_only_refusal
from fpk.certificate import Measured, certify, tolerance
from fpk.density import Density
from fpk.dynamics import Curve, Question, Rates, StationaryMotionMethod, certified_curve
from fpk.errors import NotApplicable
from fpk.linear import linear_covariance, stationary_covariance
from fpk.method import Plan, Progress, Result, silent
from fpk.observable import Coordinate, Observable
from fpk.system import System


@dataclass(frozen=True)
class Linear(StationaryMotionMethod, Theory):
    """Gaussian density with the covariance of the Lyapunov equation, for a scene without contact.

    It is the exact stationary density of the full linear system, Eq. (6); averaging does not
    reproduce it unless (8) holds, and the difference is the averaging error. ::

        free = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])
        fpk.solve(free, ["q2"], methods=[Linear()])

    Of the second mass crossings of levels, spectrum and autocovariance::

        Linear().crossings(free, parse_observable("q2", 2), np.array([0.0, 0.5])).values
        Linear().spectrum(free, parse_observable("q2", 2), np.linspace(0.0, 2.0, 5)).values
        Linear().correlation(free, parse_observable("q2", 2), np.linspace(0.0, 20.0, 5)).values
        Linear().relaxation(free, 3).values
    """

    method = "linear"
    solvers = (("closed-form", "Gaussian, exact without contact", "(6)"),)
    colour = "#b86cfa"

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
            densities = tuple(gaussian.density(o, tol=self.wanted(system)) for o in observables)
            return Result(self, densities, settings={"equation": "Lyapunov"})

        return Plan(lambda observable: energy_only_refusal(system, observable), solve)

    def _crossings(self, asked: Question) -> Curve:
        """Return the upcrossings per unit time of q, by Rice's formula for a Gaussian."""
        density, q, v = self._state(asked)
        error = asked.system.fact(linear_covariance).relative_error
        values, errors = rice_rates(q, v, error, asked.at)
        scale = v / (2.0 * np.pi * q)
        return certified_curve(
            values, errors, scale=scale, of=density, tol=asked.tol or self.wanted(asked.system)
        )

    def _spectrum(self, asked: Question) -> Curve:
        """Return the power spectral density of q from the transfer functions."""
        density, q, v = self._state(asked)
        values, errors = spectral_density(asked.system, asked.row, asked.at)
        return certified_curve(
            values, errors, scale=q**3 / v, of=density, tol=asked.tol or self.wanted(asked.system)
        )

    def _correlation(self, asked: Question) -> Curve:
        """Return the autocovariance of q by the exponential of the drift matrix."""
        density, q, _ = self._state(asked)
        values, errors = autocovariance(asked.system, asked.row, asked.at)
        return certified_curve(
            values, errors, scale=q**2, of=density, tol=asked.tol or self.wanted(asked.system),
            positive=q**2 - np.abs(values),
        )  # fmt: skip

    def relaxation(
        self, system: System, count: int, *, tol: float | None = None, progress: Progress = silent
    ) -> Rates:
        """Return sums of eigenvalues of the drift matrix: those of −L are no others."""
        self.planned(system, ())
        residual = system.fact(linear_covariance).residual
        values, errors = eigenvalue_sums(system, count)
        relative = float(np.max(errors / np.abs(values)))
        certificate = certify(
            Measured(relative, None, None, residual, None), tol=tolerance(tol, self.wanted(system))
        )
        return Rates(values, errors, certificate)

    def _state(self, asked: Question) -> tuple[Density, float, float]:
        """Density of q, and the standard deviations of q and of the velocity; both not 0."""
        system, row = asked.system, asked.row
        (density,) = self.solve(system, [(Coordinate("q", row),)]).densities
        assert isinstance(density, Density)
        at = state_rows((Coordinate("q", row), Coordinate("p", row)), system.n)
        variances = np.diag(stationary_covariance(system))[at]
        if not np.min(variances) > 0.0:
            raise NotApplicable(f"no noise reaches mass {row + 1}, which is at rest")
        q, p = np.sqrt(variances)
        return density, float(q), float(p / system.mass[row])


Linear.register()
