"""One averaged equation and the discretisations of it, which refine themselves level by level.

A study is a loop: ``refined_levels`` solves, measures the error against the reference, and goes on
with ``refined()``. Convergence and cost differ in what they do with the levels only.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import exp, inf, nan, sqrt
from typing import Any, Literal

from cases.studies.answer import FUNCTIONALS, Answer, errors, given_mesh, sizes, solve_on
from cases.studies.timing import Clock, Timing, timed_first
from fpk.observable import Observable
from fpk.process import Process
from fpk.route import Route

P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
"""Degrees of a sweep in p on one mesh."""


@dataclass(frozen=True)
class Level:
    """One level of refinement or one setting of a route.

    ``settings`` in words; ``error`` is the L1 error, of a simulation the expected one, and
    ``errors`` those by norm and moment; ``stated`` is the answer's own estimate of its L1 error.
    ``distance`` is the L1 distance to the reference and ``estimate`` the largest that both errors
    allow; ``size`` as in ``observed_orders``. ``promised`` is the tolerance of a route that is
    given one: it holds for every scene, where a number of elements is right for this one.
    ``modelled`` marks a setting priced by the law of sampling, not run.
    """

    settings: str
    error: float
    stated: float
    timing: Timing
    distance: float = nan
    estimate: float = nan
    unknowns: int = 0
    size: float = nan
    errors: dict[str, float] = field(default_factory=dict)
    functionals: dict[str, float] = field(default_factory=dict)
    promised: float = inf
    modelled: bool = False

    @property
    def seconds(self) -> float:
        """Median processor time."""
        return self.timing.seconds

    @property
    def honest(self) -> bool:
        """Whether the distance to the reference is allowed."""
        return self.distance <= self.estimate


@dataclass(frozen=True, eq=False)
class Discretisation:
    """One level of a family of discretisations: it solves, and gives the next finer level.

    ``name`` is that of the family in tables and legends, ``settings`` the level in words; in the
    family "h" elements of ``degree`` are halved, in "p" the degree grows, in "tol" the tolerance
    ``promised`` falls. ``size(answer)`` is h; or, so that the order is a rate of exponential
    convergence, exp(−p) and exp(−√unknowns): nats of error a degree, or a unit of √unknowns.
    """

    family: Literal["h", "p", "tol"]
    name: str
    settings: str
    solve: Callable[[], Answer]
    refined: Callable[[], "Discretisation"]
    size: Callable[[Answer], float]
    degree: int | None = None
    promised: float = inf


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: its process, its reference, and the routes that solve it.

    ``ends`` are the last energies of given meshes along each axis; ``by_tolerance`` are the
    routes that are given a tolerance, elements first, which ``words`` are about; ``clock`` counts
    the time in the coefficients of ``process``.
    """

    theory: str
    name: str
    observable: Observable
    process: Process
    clock: Clock
    reference: Answer
    reference_words: str
    ends: Sequence[float]
    by_tolerance: Mapping[Route, Callable[[Process, float], Answer]]
    words: str

    @property
    def dimension(self) -> int:
        """Number of energies."""
        return len(self.observable)

    def elements(self, degree: int, level: int = 0) -> Discretisation:
        """Return elements of one degree, refined by bisection of the coarsest mesh."""
        nodes = given_mesh(self.process, self.ends, degree, level)
        return Discretisation(
            "h",
            f"elements of degree {degree}",
            " x ".join(str(x.size - 1) for x in nodes) + " elements",
            solve=partial(solve_on, self.process, nodes, degree),
            refined=partial(self.elements, degree, level + 1),
            size=lambda answer: 2.0**-level,
            degree=degree,
        )

    def degrees(self, level: int = 0) -> Discretisation:
        """Return degree 1 of ``P_DEGREES`` on a mesh with the contact energies among its nodes."""
        degree = P_DEGREES[level]
        return Discretisation(
            "p",
            "p on a fixed mesh",
            f"p = {degree}",
            solve=partial(
                solve_on, self.process, given_mesh(self.process, self.ends, 4, 1), degree
            ),
            refined=partial(self.degrees, level + 1),
            size=lambda answer: exp(-degree),
            degree=degree,
        )

    def to_tolerance(self, route: Route, digits: int = 1, stride: int = 1) -> Discretisation:
        """Return a route at the tolerance 10^−``digits``, refined by ``stride`` digits."""
        tol = 10.0**-digits
        return Discretisation(
            "tol",
            route.label,
            f"tol = {tol:.0e}",
            solve=partial(self.by_tolerance[route], self.process, tol),
            refined=partial(self.to_tolerance, route, digits + stride, stride),
            size=lambda answer: exp(-sqrt(answer.unknowns)),
            promised=tol,
        )


def refined_levels(
    first: Discretisation, reference: Answer, count: int
) -> Iterator[tuple[Callable[[], Any], Level]]:
    """Yield ``count`` levels from coarse to fine, each with what solves it again.

    Raises what the solvers raise.
    """
    discretisation = first
    for k in range(count):
        discretisation = discretisation.refined() if k else first
        answer, seconds = timed_first(discretisation.solve)
        distances, moments = errors(answer, reference), sizes(answer)
        level = Level(
            settings=", ".join(filter(None, (discretisation.settings, answer.variant))),
            error=distances["L1"],
            stated=answer.l1_error,
            timing=Timing(seconds),
            distance=distances["L1"],
            estimate=answer.l1_error + reference.l1_error,
            unknowns=answer.unknowns,
            size=discretisation.size(answer),
            errors=distances,
            functionals={key: moments[key] for key in FUNCTIONALS},
            promised=discretisation.promised,
        )
        yield discretisation.solve, level
