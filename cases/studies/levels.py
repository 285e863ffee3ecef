"""Levels of refinement: discretisations that refine themselves, and one record of a level.

A study is a loop: ``refined_levels`` solves, measures the error against the reference, and goes on
with ``refined()``. Convergence and cost differ in what they do with the levels only.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import exp, inf, nan, sqrt
from typing import Any, Literal, Self

import numpy as np

from cases.studies.answer import FUNCTIONALS, NORMS, Answer, errors, functionals
from cases.studies.equations import Equation, Steered
from cases.studies.timing import Timing, timed_first
from fpk.density import Array

P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
"""Degrees of a sweep in p on one mesh."""


@dataclass(frozen=True)
class Level:
    """One level of refinement or one setting of a route.

    ``setting`` in words; ``errors`` by norm and moment, of a simulation L1 alone; ``stated`` is the
    answer's own estimate of its L1 error and ``reference_error`` that of the reference; ``size`` as
    in ``observed_orders``. ``promised`` is the tolerance of a route that is given one: it holds for
    every scene, where a number of elements is right for this one. ``modelled`` marks a setting
    priced by the law of sampling, not run.
    """

    setting: str
    errors: dict[str, float]
    stated: float
    timing: Timing
    unknowns: int = 0
    size: float = nan
    functionals: dict[str, float] = field(default_factory=dict)
    reference_error: float = 0.0
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
    def estimate(self) -> float:
        """What the L1 distance to the reference may be: both estimates."""
        return self.stated + self.reference_error

    @property
    def honest(self) -> bool:
        """Whether the true L1 error is within the estimate."""
        return self.error <= self.estimate

    def convergence_record(self) -> dict[str, Any]:
        """Return the level as ``fpk converge --json`` has it."""
        return {
            "label": self.setting,
            **{k: getattr(self, k) for k in ("size", "unknowns", "errors", "estimate")},
            "functionals": self.functionals,
        }

    def cost_record(self) -> dict[str, Any]:
        """Return the level as ``fpk cost --json`` has it."""
        keys = ("error", "stated", "unknowns", "modelled", "promised")
        values = {key: getattr(self, key) for key in keys}
        return {"settings": self.setting, **values, "timing": vars(self.timing)}


@dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one degree on a given mesh: swept in "h" by bisection, in "p" by ``P_DEGREES``.

    Sizes are h = 2^−k, or exp(−p): the order then is the nats of error that one degree takes off.
    """

    equation: Equation
    degree: int
    nodes: tuple[Array, ...]
    sweep: Literal["h", "p"] = "h"
    level: int = 0
    promised: float = inf

    @property
    def name(self) -> str:
        """The family in tables and legends."""
        return f"elements of degree {self.degree}" if self.sweep == "h" else "p on a fixed mesh"

    def setting(self, answer: Answer) -> str:
        """The level in words."""
        counts = " x ".join(str(x.size - 1) for x in self.nodes)
        return f"{counts} elements" if self.sweep == "h" else f"p = {self.degree}"

    def size(self, answer: Answer) -> float:
        """Relative size h of the elements, or exp(−p)."""
        return 2.0**-self.level if self.sweep == "h" else exp(-self.degree)

    def solve(self) -> Answer:
        """Return the solution on this mesh."""
        return self.equation.on_mesh(self.nodes, self.degree)

    def refined(self) -> Self:
        """Return every element halved, or the next degree."""
        level = self.level + 1
        if self.sweep == "p":
            return replace(self, degree=P_DEGREES[level], level=level)
        return replace(self, nodes=bisected(self.nodes), level=level)


def elements(equation: Equation, degree: int) -> Elements:
    """Return the coarsest elements of one degree, to be swept in h."""
    return Elements(equation, degree, equation.coarsest(degree))


def degrees(equation: Equation) -> Elements:
    """Return degree 1 on a fixed mesh with the contact energies among its nodes, swept in p."""
    return Elements(equation, P_DEGREES[0], bisected(equation.coarsest(4)), "p")


@dataclass(frozen=True, eq=False)
class ByTolerance:
    """A route that is given tol = 10^−``digits``; refined by ``stride`` digits."""

    steered: Steered
    digits: int = 1
    stride: int = 1

    @property
    def name(self) -> str:
        """The family in tables and legends."""
        return self.steered.route.label

    @property
    def promised(self) -> float:
        """The tolerance asked for."""
        return 10.0**-self.digits

    def setting(self, answer: Answer) -> str:
        """The level in words."""
        return f"tol = {self.promised:.0e}" + (f", {answer.made}" if answer.made else "")

    def size(self, answer: Answer) -> float:
        """exp(−√N): the order then is the nats of error that a unit of √unknowns takes off."""
        return exp(-sqrt(answer.unknowns))

    def solve(self) -> Answer:
        """Return the answer to this tolerance."""
        return self.steered.solve(self.promised)

    def refined(self) -> Self:
        """Return the next tolerance."""
        return replace(self, digits=self.digits + self.stride)


Discretisation = Elements | ByTolerance
"""What a study loops over: it solves, and returns itself one level finer."""


def refined_levels(
    first: Discretisation, reference: Answer, count: int
) -> Iterator[tuple[Discretisation, Level]]:
    """Yield ``count`` levels from coarse to fine, each with its discretisation.

    Raises what the solvers raise.
    """
    discretisation: Discretisation = first
    for k in range(count):
        discretisation = discretisation.refined() if k else first
        answer, seconds = timed_first(discretisation.solve)
        level = Level(
            setting=discretisation.setting(answer),
            errors=errors(answer, reference),
            stated=answer.l1_error,
            timing=Timing(seconds),
            unknowns=answer.unknowns,
            size=discretisation.size(answer),
            functionals=functionals(answer),
            reference_error=reference.l1_error,
            promised=discretisation.promised,
        )
        yield discretisation, level


def bisected(nodes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the nodes of every axis with the middles between them."""
    return tuple(np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])])) for x in nodes)


def theoretical_order(key: str, degree: int) -> float:
    """Return p + 1 of the norms, 2 p of the moments (Galerkin duality), smoothness allowing it."""
    assert key in (*NORMS, *FUNCTIONALS)
    return float(degree + 1 if key in NORMS else 2 * degree)
