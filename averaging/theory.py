"""Base classes of the methods that solve equations: exact, linear, nonintegrable and integrable."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self

from averaging.back_transformation import back_transformed, crossing_rates
from averaging.shell.laplace import by_lines
from averaging.weyl import StateDensity
from fpk.answer.certificate import tolerance
from fpk.answer.dynamics import Curve
from fpk.answer.method import ROUTES, Method, Plan, Progress, Result, Route, Solves, register
from fpk.answer.names import Observable, observable_name
from fpk.answer.question import Asked, answer
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System

SMALLEST, LARGEST = 1e-12, 0.1
"""Tolerances that can be asked for: double precision meets none smaller, none larger says much."""

DEFAULT, DEFAULT_BY_LINES = 1e-10, 1e-5
"""Tolerance that is met where none is asked for, and over more than two contact masses: there the
density of states was known to 1e-6 at the worst (three masses, stops 1e6 times their springs)."""

UNIFORM = 1e-4
"""Tolerance by scikit-fem where none is asked for: met in all shipped scenes within seconds."""


@dataclass(frozen=True)
class Theory(Method):
    """Method that answers to the L1 tolerance ``tol``, or that of ``wanted``, by a solver.

    A subclass gives its name and colour on the command line and in pictures, and its ``solvers``,
    the default first: (name, words for legends, equation). Each is a route. Raises ``InvalidInput``
    for an unknown solver or a tolerance below ``SMALLEST`` or above ``LARGEST``.
    """

    solver: str = "closed-form"
    tol: float | None = None
    method: ClassVar[str]
    solvers: ClassVar[tuple[tuple[str, str, str], ...]]
    solves: ClassVar[Solves] = "full"
    colour: ClassVar[str]

    def __post_init__(self) -> None:
        """Refuse an unknown solver, or a tolerance that cannot be met."""
        names = sorted(name for name, *_ in self.solvers)
        if self.solver not in names:
            raise InvalidInput("solver", self.solver, f"use one of {names}")
        if self.tol is not None and not SMALLEST <= self.tol <= LARGEST:
            raise InvalidInput("tol", self.tol, f"must lie between {SMALLEST:g} and {LARGEST:g}")

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES[self.method, self.solver]

    def refined(self) -> Self:
        """Return the method with a tolerance ten times smaller, down to ``SMALLEST``."""
        default = UNIFORM if self.route.named else DEFAULT
        return replace(self, tol=max(0.1 * tolerance(self.tol, default), SMALLEST))

    def wanted(self, system: System) -> float:
        """Return the tolerance asked for, or else one that the density of states allows."""
        if self.route.named:
            return tolerance(self.tol, UNIFORM)
        lines = by_lines(system)
        return tolerance(self.tol, DEFAULT_BY_LINES if lines else DEFAULT)

    @classmethod
    def register(cls, **options: Any) -> None:
        """Register a route for each solver, with further ``options`` of the ``Route``."""
        for solver, words, equation in cls.solvers:
            make = partial(cls, solver=solver)
            names = cls.method, solver, words, equation, cls.solves
            named = solver == "scikit-fem"
            register(Route(*names, False, cls.colour, make, named=named, **options))


@dataclass(frozen=True)
class EnergyTheory(Theory):
    """Theory of a state whose density is u(H): marginals of u and crossing rates follow from it."""

    def exponential(self, system: System) -> bool:
        """Return whether u is exp(−αH); raise ``NotApplicable`` where the theory does not hold."""
        raise NotImplementedError

    def state(self, system: System) -> tuple[StateDensity, dict[str, str | float | int]]:
        """Return u, solved for, and the settings of the result."""
        raise NotImplementedError

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it does not hold."""

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            source, settings = self.state(system)
            tol = self.wanted(system)
            densities = tuple(back_transformed(source, o, tol=tol) for o in observables)
            return Result(self, densities, settings=settings)

        refusal = partial(energy_only_refusal, system, exponential=self.exponential(system))
        return Plan(refusal, solve)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the upcrossings per unit time of q, by Rice's formula."""
        tol = asked.tol or self.wanted(asked.system)
        return crossing_rates(self.state(asked.system)[0], asked.row, asked.at, tol=tol)


def energy_only_refusal(
    system: System, observable: Observable, *, exponential: bool = False
) -> str | None:
    """Return why ``observable`` does not follow from a density u(H), or None where it does.

    Where u is ``exponential`` contact masses on either side of the observed ones are integrated out
    by passes along the chain; otherwise all of them at once.
    """
    kinds = {c.kind for c in observable}
    if "H" in kinds and (len(observable) > 1 or observable[0].index is not None):
        return (
            f"{observable_name(observable)}: this theory knows the total energy only; "
            "ask for H, q, p or pairs of q and p"
        )
    seen = [c.row for c in observable if c.kind == "q"]
    hidden = [i for i in system.contact_masses if i not in seen]
    if exponential:
        hidden = [i for i in hidden if seen and min(seen) < i < max(seen)]
    if "H" not in kinds and len(hidden) > 2:
        return (
            f"{observable_name(observable)}: {len(hidden)} contact masses would have to be "
            "integrated out numerically at once, at most 2 are"
        )
    return None
