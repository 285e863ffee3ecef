"""Levels of refinement of one averaged equation: discretisations that refine themselves.

A study is a loop: ``refined_levels`` solves, measures the error against the reference, and goes on
with ``refined()``. Convergence and cost differ in what they do with the levels only.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import exp, inf, nan, sqrt
from typing import Any, Literal, Self

import numpy as np

from cases.studies.answer import Answer, errors, functionals
from cases.studies.timing import Clock, Timing, timed_first
from fpk.density import Array
from fpk.observable import Observable
from fpk.route import Route

P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
"""Degrees of a sweep in p on one mesh."""


@dataclass(frozen=True)
class Level:
    """One level of refinement or one setting of a route.

    ``settings`` in words; ``errors`` by norm and moment, of a simulation the expected L1 alone;
    ``stated`` is the answer's own estimate of its L1 error. ``distance`` is the L1 distance to the
    reference and ``estimate`` the largest that both errors allow; ``size`` as in
    ``observed_orders``. ``promised`` is the tolerance of a route that is given one: it holds for
    every scene, where a number of elements is right for this one. ``modelled`` marks a setting
    priced by the law of sampling, not run.
    """

    settings: str
    errors: dict[str, float]
    stated: float
    timing: Timing
    distance: float = nan
    estimate: float = nan
    unknowns: int = 0
    size: float = nan
    functionals: dict[str, float] = field(default_factory=dict)
    promised: float = inf
    modelled: bool = False

    @property
    def error(self) -> float:
        """The L1 error."""
        return self.errors["L1"]

    @property
    def seconds(self) -> float:
        """Median processor time."""
        return self.timing.seconds

    @property
    def honest(self) -> bool:
        """Whether the distance to the reference is allowed."""
        return self.distance <= self.estimate

    def record(self, keys: Sequence[str]) -> dict[str, Any]:
        """Return the fields and properties named as plain data."""
        return {key: getattr(self, key) for key in keys}


@dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one degree on a mesh: refined in "h" by bisection, in "p" by ``P_DEGREES``.

    Sizes are h = 2^−k, or exp(−p): the order then is the nats of error that one degree takes off.
    """

    on_mesh: Callable[[tuple[Array, ...], int], Answer]
    nodes: tuple[Array, ...]
    degree: int
    family: Literal["h", "p"] = "h"
    level: int = 0
    promised: float = inf

    @property
    def name(self) -> str:
        """The family in tables and legends."""
        return f"elements of degree {self.degree}" if self.family == "h" else "p on a fixed mesh"

    def settings(self, answer: Answer) -> str:
        """The level in words."""
        counts = " x ".join(str(x.size - 1) for x in self.nodes)
        return f"{counts} elements" if self.family == "h" else f"p = {self.degree}"

    def size(self, answer: Answer) -> float:
        """Relative size h of the elements, or exp(−p)."""
        return 2.0**-self.level if self.family == "h" else exp(-self.degree)

    def solve(self) -> Answer:
        """Return the solution on this mesh."""
        return self.on_mesh(self.nodes, self.degree)

    def refined(self) -> Self:
        """Return every element halved, or the next degree."""
        level = self.level + 1
        if self.family == "p":
            return replace(self, degree=P_DEGREES[level], level=level)
        return replace(self, nodes=tuple(map(bisected, self.nodes)), level=level)


@dataclass(frozen=True, eq=False)
class ByTolerance:
    """A route that is given tol = 10^−``digits``, refined by ``stride`` digits.

    ``words`` say how it discretises.
    """

    route: Route
    solver: Callable[[float], Answer]
    words: str
    digits: int = 1
    stride: int = 1
    family: Literal["tol"] = "tol"

    @property
    def name(self) -> str:
        """The family in tables and legends."""
        return self.route.label

    @property
    def promised(self) -> float:
        """The tolerance asked for."""
        return 10.0**-self.digits

    def settings(self, answer: Answer) -> str:
        """The level in words."""
        return f"tol = {self.promised:.0e}" + (f", {answer.variant}" if answer.variant else "")

    def size(self, answer: Answer) -> float:
        """exp(−√N): the order then is the nats of error that a unit of √unknowns takes off."""
        return exp(-sqrt(answer.unknowns))

    def solve(self) -> Answer:
        """Return the answer to this tolerance."""
        return self.solver(self.promised)

    def refined(self) -> Self:
        """Return the next tolerance."""
        return replace(self, digits=self.digits + self.stride)


Discretisation = Elements | ByTolerance
Work = Callable[[], Any]


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: how it is solved on a mesh, to a tolerance, and its reference.

    ``coarsest`` gives the nodes of each axis of the first mesh by degree; ``by_tolerance`` are the
    routes that are given a tolerance, elements first; ``coefficients`` is the clock of the
    process's coefficients within every solution.
    """

    theory: str
    name: str
    observable: Observable
    reference: Answer
    reference_words: str
    coarsest: Callable[[int], tuple[Array, ...]]
    on_mesh: Callable[[tuple[Array, ...], int], Answer]
    by_tolerance: tuple[ByTolerance, ...]
    coefficients: Clock

    @property
    def dimension(self) -> int:
        """Number of energies."""
        return len(self.observable)

    def elements(self, degree: int) -> Elements:
        """Return the coarsest elements of one degree, to be refined in h."""
        return Elements(self.on_mesh, self.coarsest(degree), degree)

    def degrees(self) -> Elements:
        """Return degree 1 on a fixed mesh with the contact energies among its nodes."""
        return Elements(self.on_mesh, tuple(map(bisected, self.coarsest(4))), P_DEGREES[0], "p")


def refined_levels(
    first: Discretisation, reference: Answer, count: int
) -> Iterator[tuple[Work, Level]]:
    """Yield ``count`` levels from coarse to fine, each with what solves it again.

    Raises what the solvers raise.
    """
    discretisation = first
    for k in range(count):
        discretisation = discretisation.refined() if k else first
        answer, seconds = timed_first(discretisation.solve)
        distances = errors(answer, reference)
        level = Level(
            settings=discretisation.settings(answer),
            errors=distances,
            stated=answer.l1_error,
            timing=Timing(seconds),
            distance=distances["L1"],
            estimate=answer.l1_error + reference.l1_error,
            unknowns=answer.unknowns,
            size=discretisation.size(answer),
            functionals=functionals(answer),
            promised=discretisation.promised,
        )
        yield discretisation.solve, level


def bisected(nodes: Array) -> Array:
    """Return the nodes with the middles between them."""
    return np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
