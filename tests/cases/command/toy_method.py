"""A method of one's own: momenta by equipartition, at the temperature D_ii/c_ii of each mass."""

from dataclasses import dataclass
from math import erfc, sqrt
from typing import Self

import numpy as np

from fpk.answer.certificate import NEGATIVE, Measured
from fpk.answer.density import certify_density
from fpk.answer.method import Method, Plan, Result, Route, register_route
from fpk.numeric.errors import NotApplicable

REACH = 8.5


@dataclass(frozen=True)
class Equipartition(Method):
    """p(p_i) is a Gaussian of variance m_i D_ii/c_ii, exact where (8) holds."""

    tol: float = 1e-10

    @property
    def route(self):
        return EQUIPARTITION

    def prepare(self, system):
        damping = np.diag(system.damping)
        if np.any(damping <= 0.0):
            raise NotApplicable("a mass without damping of its own has no temperature")
        variance = system.mass * np.diag(system.noise_matrix) / damping

        def refusal(observable):
            (first, *others) = observable
            return None if first.kind == "p" and not others else "momenta only"

        def solve(observables, progress):
            densities = tuple(self._gaussian(o, sqrt(variance[o[0].index])) for o in observables)
            return Result(self, densities, settings={"equation": "equipartition"})

        return Plan(refusal, solve)

    def refined(self) -> Self:
        return self

    def _gaussian(self, observable, scale):
        def pdf(x):
            return np.exp(-0.5 * (x / scale) ** 2) / (sqrt(2.0 * np.pi) * scale)

        tail = erfc(REACH / sqrt(2.0))
        return certify_density(
            observable,
            (np.linspace(-REACH * scale, REACH * scale, 18),),
            pdf,
            lambda x: -NEGATIVE * pdf(x),
            measured=Measured(tail - 2.0 * NEGATIVE, 0.0, 0.0, 0.0, tail),
            tol=self.tol,
        )


EQUIPARTITION = register_route(
    Route(
        "equipartition",
        "closed-form",
        "equipartition",
        "(22)",
        "averaged",
        False,
        "#777777",
        make=Equipartition,
    )
)
