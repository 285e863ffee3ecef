"""One averaged equation and its discretisations, which refine themselves level by level.

A study is a loop: ``refined_levels`` solves, measures the error against the reference, and goes on
with ``refined()``. Convergence and cost differ only in what they do with the levels.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import exp, inf, nan, sqrt
from typing import Any, Literal

from cases.studies.answer import FUNCTIONALS, Answer, errors, given_mesh, sizes, solve_on
from cases.studies.timing import Clock, Timing, timed_first
from fpk.observable import Observable, observable_name
from fpk.process import Process
from fpk.route import Route

P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
"""Degrees of a sweep in p on one mesh."""


@dataclass(frozen=True)
class Level:
    """One level of refinement or one setting of a route, as it was measured.

    ``error`` is the L1 error, of a simulation the expected one; ``errors`` are those by norm and
    moment; ``stated`` is the answer's own estimate. ``distance`` is the L1 distance to the
    reference and ``estimate`` the largest that both errors allow; ``size`` as in
    ``observed_orders``. ``promised`` is the tolerance that was asked for, if any. ``modelled``:
    priced by the law of sampling, not run.
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
    label: str = ""

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
    """One level of a family of discretisations of one equation.

    ``name`` is that of the family in tables and legends: in "h" elements of ``degree`` are halved,
    in "p" the degree grows, in "tol" the tolerance falls. ``settings``, ``size`` and ``promised``
    are those of ``Level``.
    """

    family: Literal["h", "p", "tol"]
    name: str
    settings: str
    solve: Callable[[], Answer]
    refined: Callable[[], "Discretisation"]
    size: float = nan
    promised: float = inf
    degree: int | None = None


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: its process, its reference, and the routes that solve it.

    ``ends`` are the last energies of given meshes along each axis; ``by_tolerance`` are the routes
    that are given a tolerance, elements first, which ``words`` are about; ``clock`` counts the time
    in the coefficients of ``process``.
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

    def description(self) -> dict[str, Any]:
        """Return the equation and its reference in words and numbers."""
        return {
            "theory": self.theory,
            "equation": self.name,
            "observable": observable_name(self.observable),
            "dimension": self.dimension,
            "reference": self.reference_words,
            "reference_error": self.reference.l1_error,
            "by_tolerance": self.words,
        }

    def elements(self, degree: int, halvings: int = 0) -> Discretisation:
        """Return elements of one degree, refined by bisection of the coarsest mesh."""
        nodes = given_mesh(self.process, self.ends, degree, halvings)
        return Discretisation(
            "h",
            f"elements of degree {degree}",
            " x ".join(str(x.size - 1) for x in nodes) + " elements",
            partial(solve_on, self.process, nodes, degree),
            partial(self.elements, degree, halvings + 1),
            size=2.0**-halvings,
            degree=degree,
        )

    def degrees(self, first: int = 0) -> Discretisation:
        """Return ``P_DEGREES`` on one mesh with the contact energies among its nodes."""
        degree, nodes = P_DEGREES[first], given_mesh(self.process, self.ends, 4, 1)
        solve, finer = (
            partial(solve_on, self.process, nodes, degree),
            partial(self.degrees, first + 1),
        )
        return Discretisation(
            "p", "p on a fixed mesh", f"p = {degree}", solve, finer, size=exp(-degree)
        )

    def to_tolerance(self, route: Route, digits: int = 1, stride: int = 1) -> Discretisation:
        """Return a route at the tolerance 10^−``digits``, refined by ``stride`` digits."""
        tol = 10.0**-digits
        solve = partial(self.by_tolerance[route], self.process, tol)
        finer = partial(self.to_tolerance, route, digits + stride, stride)
        return Discretisation("tol", route.label, f"tol = {tol:.0e}", solve, finer, promised=tol)


def refined_levels(
    first: Discretisation, reference: Answer, count: int
) -> Iterator[tuple[Callable[[], Any], Level]]:
    """Yield ``count`` levels from coarse to fine, each with what solves it again.

    Sizes are h; or, so that the order is a rate of exponential convergence, exp(−p) and
    exp(−√unknowns): nats of error a degree, or a unit of √unknowns. Raises what the solvers raise.
    """
    setting = first
    for k in range(count):
        setting = setting.refined() if k else first
        answer, seconds = timed_first(setting.solve)
        distances, moments = errors(answer, reference), sizes(answer)
        words = ", ".join(filter(None, (setting.settings, answer.variant)))
        level = Level(
            settings=words,
            error=distances["L1"],
            stated=answer.l1_error,
            timing=Timing(seconds),
            distance=distances["L1"],
            estimate=answer.l1_error + reference.l1_error,
            unknowns=answer.unknowns,
            size=exp(-sqrt(answer.unknowns)) if first.family == "tol" else setting.size,
            errors=distances,
            functionals={key: moments[key] for key in FUNCTIONALS},
            promised=setting.promised,
            label=words,
        )
        yield setting.solve, level
