"""A study of one's own: the trapezoidal rule for the mass of the exact p(q), in the step h."""

from functools import partial

import numpy as np

from averaging import Exact
from cases.study import OwnStudy, register_study
from cases.study.levels import Discretisation, Level, Study
from fpk.answer.names import parse_observable

HALF_WIDTH = 3.0
"""End of the interval in units of the rms: the rule is of order 2, as p' is not 0 there."""


def trapezoid(density, points=9):
    """Return the rule on so many points; what it returns is the mass and its number of points."""
    end = HALF_WIDTH * density.rms().value
    q = np.linspace(0.0, end, points)
    return Discretisation(
        family="h",
        name="trapezoidal rule",
        settings=f"{points} points",
        solve=lambda: (np.trapezoid(density.at(q)[0], q), points),
        refined=partial(trapezoid, density, 2 * points - 1),
        size=1.0 / (points - 1),
    )


def studies(scene, seed):
    """Vary the step, measure the mass between 0 and the end, expect the order 2."""
    observable = parse_observable("q1", scene.system.n)
    (density,) = Exact().solve(scene.system, [observable]).densities
    end = HALF_WIDTH * density.rms().value
    exact = density.cdf(end).value - density.cdf(0.0).value

    def measure(answer):
        mass, points = answer
        error = abs(mass - exact)
        return Level(
            settings="", error=error, stated=error, seconds=0.0, distance=error,
            estimate=2.0 * error + 1e-12, unknowns=points, errors={"mass": error},
            functionals={"mass": mass},
        )  # fmt: skip

    first = trapezoid(density)
    return [Study("mass of p(q1)", first, 6, measure, theory={"mass": 2.0}, floor={"mass": 1e-14})]


TRAPEZOID = register_study(
    OwnStudy("trapezoid", "Measure the order of the trapezoidal rule.", studies)
)
