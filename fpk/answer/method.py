"""Methods, their plans and results for a system, and the registry of all routes to densities."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any, Literal, Self

from fpk.answer.density import AnyDensity, Density
from fpk.answer.names import Observable, require_observables
from fpk.answer.question import Progress as Progress
from fpk.answer.question import silent as silent
from fpk.numeric.errors import NotApplicable
from fpk.system.escape import require_held
from fpk.system.system import System

Solves = Literal["full", "averaged"]


@dataclass(frozen=True)
class Identity:
    """Identity ``value`` = ``expected`` that holds in stationary states, with the ``error`` of
    ``value − expected``: numerical, or one standard error of sampling."""

    name: str
    value: float
    expected: float
    error: float

    @property
    def z(self) -> float:
        """``(value − expected)/error``; inf unless the error is > 0."""
        return (self.value - self.expected) / self.error if self.error > 0 else float("inf")


@dataclass(frozen=True)
class Result:
    """Answer of one method: a density for each observable requested, and how it was obtained.

    ``seconds`` is wall time; ``identities`` check the answer; ``settings`` are for readers only;
    ``neglected`` names effects left out, "" for none; ``partial``: the work was interrupted;
    ``report`` is the report of a simulation; ``beside`` are densities of further observables.
    """

    method: "Method"
    densities: tuple[AnyDensity, ...]
    seconds: float = 0.0
    identities: tuple[Identity, ...] = ()
    settings: Mapping[str, str | float | int] = field(default_factory=dict)
    neglected: str = ""
    partial: bool = False
    report: object | None = None
    beside: tuple[AnyDensity, ...] = ()

    def __repr__(self) -> str:
        """Return the route and the observables in one line."""
        names = ", ".join(density.name for density in self.densities)
        partial = ", partial" if self.partial else ""
        return f"Result({self.method.route.label}: {names}; {self.seconds:.3g} s{partial})"


@dataclass(frozen=True)
class Plan:
    """A method prepared for one system.

    ``refusal(observable)`` returns the reason why the method does not give an observable, or None;
    ``solve(observables, progress)`` returns the result. ``beside``: ``solve`` accepts further
    observables as ``beside``, whose densities take little more work. ``attempt(observables,
    progress)`` returns why ``solve`` would give up after its first solutions, or None.
    """

    refusal: Callable[[Observable], str | None]
    solve: Callable[..., Result]
    beside: bool = False
    attempt: Callable[[Sequence[Observable], Progress], str | None] = lambda *_: None


class Method(ABC):
    """A route with its discretisation: a frozen dataclass, registered with ``register_route``.

    Callers get its plan from ``planned``, not ``prepare``.
    """

    @property
    @abstractmethod
    def route(self) -> "Route":
        """The registered route of the method."""

    @abstractmethod
    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``, or raise ``NotApplicable`` with the reason."""

    @abstractmethod
    def refined(self) -> Self:
        """Return the method at its next finer level of discretisation."""

    def unasked(self, system: System, *, share: float = 1.0) -> Self:
        """Return the method to use if no user named it: itself. A slow method returns a copy whose
        work is limited, to ``share`` of a fixed amount, or raises ``NotApplicable``."""
        return self

    def refusal(self, system: System, observable: Observable) -> str | None:
        """Return the reason why the method does not give ``observable``, or None if it does."""
        try:
            self.planned(system, [observable])
        except NotApplicable as reason:
            return str(reason)
        return None

    def solve(
        self,
        system: System,
        observables: Sequence[Observable],
        *,
        beside: Sequence[Observable] = (),
        plan: Plan | None = None,
        progress: Progress = silent,
    ) -> Result:
        """Return the densities of ``observables``, and of ``beside`` if they take little more work.

        The latter are in ``Result.beside``, without refused observables. Densities get the settings
        of the result as ``provenance`` and, if they are functions, a ``source`` that solves for
        them again. ``plan`` is the plan of the method, if the caller has it already; then refusals
        are not checked. ``progress`` is called as the work advances. Raises ``NotApplicable`` if
        the method refuses, ``InvalidInput`` for names not parsed. ::

            answer = NonIntegrable().solve(system, [parse_observable("q2", system.n)])
            (p,) = answer.densities
        """
        require_observables(observables)
        plan = plan or self.planned(system, observables)
        start = perf_counter()
        others = [o for o in beside if plan.beside and not plan.refusal(o)]
        result = plan.solve(observables, progress, **({"beside": others} if others else {}))
        source = partial(result.method.solve, system)

        def known(density: AnyDensity) -> AnyDensity:
            own: dict[str, Any] = {"source": source} if isinstance(density, Density) else {}
            return replace(density, provenance=result.settings, **own)

        densities, others_given = (tuple(map(known, d)) for d in (result.densities, result.beside))
        seconds = perf_counter() - start
        return replace(result, densities=densities, beside=others_given, seconds=seconds)

    def planned(self, system: System, observables: Sequence[Observable]) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` if there is none, if the method
        refuses one of the ``observables``, or if the motion escapes."""
        require_held(system)
        plan = self.prepare(system)
        for observable in observables:
            if reason := plan.refusal(observable):
                raise NotApplicable(reason)
        return plan


@dataclass(frozen=True)
class Route:
    """One METHOD with one SOLVER of the command line; plots show the first route of each method.

    ``words`` is the legend, equation solved and solver; ``equation`` is the number of the equation
    in the paper. ``solves`` is "full" for Eq. (6) itself, "averaged" for the equation of a theory;
    ``sampled``: the errors are sampling errors; ``colour`` is #rrggbb. ``make()`` returns the
    method with its default settings. ``quick``: answers take less than a second, so that
    ``fpk export`` and the references of studies use the route unasked. ``named``: the route is used
    only if its solver is named.
    """

    method: str
    solver: str
    words: str
    equation: str
    solves: Solves
    sampled: bool
    colour: str
    make: Callable[[], Method]
    quick: bool = True
    named: bool = False

    @property
    def name(self) -> str:
        """Name for readers: ``words`` up to the comma, or in full if the route is sampled."""
        return self.words if self.sampled else self.words.partition(",")[0]

    @property
    def label(self) -> str:
        """Name in tables: the method if it has one solver, else method/solver."""
        alone = len(solvers_of(self.method)) <= 1
        return self.method if alone else f"{self.method}/{self.solver}"


ROUTES: dict[tuple[str, str], Route] = {}
"""Every route by (method, solver), in the order of registration."""


def register_route(route: Route) -> Route:
    """Add ``route`` to the registry and return it; raise ``ValueError`` if its names are taken."""
    key = route.method, route.solver
    if key in ROUTES:
        raise ValueError(f"route {route.method}/{route.solver} is registered already")
    ROUTES[key] = route
    return route


def solvers_of(method: str) -> tuple[str, ...]:
    """Return the solvers of ``method``: the default first, sampling solvers last; () if unknown."""
    own = [route for route in ROUTES.values() if route.method == method]
    return tuple(route.solver for route in sorted(own, key=lambda route: route.sampled))
