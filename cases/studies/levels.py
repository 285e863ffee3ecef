"""Levels of refinement of one averaged equation: discretisations that refine themselves.

A study is a loop: ``refined_levels`` solves, measures the error against the reference, and goes on
with ``refined()``. Convergence and cost differ in what they do with the levels only.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from math import exp, inf, nan, sqrt
from typing import Any, Literal

import numpy as np

from cases.studies.answer import Answer, errors, functionals
from cases.studies.timing import Clock, Timing, timed_first
from fpk.density import Array
from fpk.observable import Observable
from fpk.route import Route

Nodes = tuple[Array, ...]
OnMesh = Callable[[Nodes, int], Answer]
Work = Callable[[], Any]

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
    """What a study loops over: it solves, and gives itself one level finer.

    ``name`` is that of the family in tables and legends, ``settings`` the level in words; in the
    family "h" elements of ``degree`` are halved, in "p" the degree grows, in "tol" the tolerance
    ``promised`` falls. ``size(answer)`` is h, or that of which a logarithm counts: exp(−p), whose
    order is the nats of error that a degree takes off, and exp(−√N), that of a unit of √unknowns.
    """

    name: str
    family: Literal["h", "p", "tol"]
    settings: str
    solve: Callable[[], Answer]
    refined: Callable[[], "Discretisation"]
    size: Callable[[Answer], float]
    degree: int | None = None
    promised: float = inf


def elements(on_mesh: OnMesh, nodes: Nodes, degree: int, level: int = 0) -> Discretisation:
    """Return elements of one degree, refined by bisection from the mesh of level 0 on."""
    return Discretisation(
        f"elements of degree {degree}",
        "h",
        " x ".join(str(x.size - 1) for x in nodes) + " elements",
        solve=partial(on_mesh, nodes, degree),
        refined=lambda: elements(on_mesh, bisected(nodes), degree, level + 1),
        size=lambda answer: 2.0**-level,
        degree=degree,
    )


def degrees(on_mesh: OnMesh, nodes: Nodes, level: int = 0) -> Discretisation:
    """Return elements on a fixed mesh, refined from degree to degree of ``P_DEGREES``."""
    degree = P_DEGREES[level]
    return Discretisation(
        "p on a fixed mesh",
        "p",
        f"p = {degree}",
        solve=partial(on_mesh, nodes, degree),
        refined=lambda: degrees(on_mesh, nodes, level + 1),
        size=lambda answer: exp(-degree),
        degree=degree,
    )


@dataclass(frozen=True, eq=False)
class ByTolerance:
    """A route whose ``solve`` is given a tolerance; ``words`` say how it discretises."""

    route: Route
    solve: Callable[[float], Answer]
    words: str

    def at(self, digits: int, stride: int = 1) -> Discretisation:
        """Return the route at 10^−``digits``, refined by ``stride`` digits."""
        tol = 10.0**-digits
        return Discretisation(
            self.route.label,
            "tol",
            f"tol = {tol:.0e}",
            solve=partial(self.solve, tol),
            refined=lambda: self.at(digits + stride, stride),
            size=lambda answer: exp(-sqrt(answer.unknowns)),
            promised=tol,
        )


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
    coarsest: Callable[[int], Nodes]
    on_mesh: OnMesh
    by_tolerance: tuple[ByTolerance, ...]
    coefficients: Clock

    @property
    def dimension(self) -> int:
        """Number of energies."""
        return len(self.observable)

    def elements(self, degree: int) -> Discretisation:
        """Return the coarsest elements of one degree, refined in h."""
        return elements(self.on_mesh, self.coarsest(degree), degree)

    def degrees(self) -> Discretisation:
        """Return degree 1 on a fixed mesh with the contact energies among its nodes."""
        return degrees(self.on_mesh, bisected(self.coarsest(4)))


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
            settings=", ".join(filter(None, (discretisation.settings, answer.variant))),
            error=distances["L1"],
            stated=answer.l1_error,
            timing=Timing(seconds),
            distance=distances["L1"],
            estimate=answer.l1_error + reference.l1_error,
            unknowns=answer.unknowns,
            size=discretisation.size(answer),
            errors=distances,
            functionals=functionals(answer),
            promised=discretisation.promised,
        )
        yield discretisation.solve, level


def bisected(nodes: Nodes) -> Nodes:
    """Return the nodes of every axis with the middles between them."""
    return tuple(np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])])) for x in nodes)
