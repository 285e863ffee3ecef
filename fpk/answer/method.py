"""Methods, their plans for a system and results, and the registry of all routes to densities."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Literal, Self

from fpk.answer.density import AnyDensity, Density
from fpk.answer.observable import Observable, require_observables
from fpk.answer.question import Progress as Progress
from fpk.answer.question import silent as silent
from fpk.numeric.errors import NotApplicable
from fpk.system.escape import require_held
from fpk.system.system import System

Solves = Literal["full", "averaged"]


@dataclass(frozen=True)
class Identity:
    """An equation that holds exactly in any stationary state, evaluated on an answer.

    ``value`` should equal ``expected``; ``error`` is one standard error of the difference for
    sampling and an estimate of its numerical error otherwise.
    """

    name: str
    value: float
    expected: float
    error: float

    @property
    def z(self) -> float:
        """The difference in units of its error."""
        return (self.value - self.expected) / self.error if self.error > 0 else float("inf")


@dataclass(frozen=True)
class Result:
    """The answer of one method: a density per observable asked for, and its own statements.

    ``neglected`` names in words the effects of the system that the method leaves out, empty where
    none; ``partial`` says that the work was interrupted and the answer is what there was by then;
    ``report`` is the typed report of a simulation, None otherwise. ``settings`` is for readers
    alone: no decision rests on it. ``beside`` are densities of the same solution that were not
    asked for, from which numbers follow.
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
    """A method prepared for one system: what it refuses, and how it solves.

    ``refusal(observable)`` returns why the observable is not given, None where it is;
    ``solve(observables, progress)`` returns the result for observables that are. One that gives
    more densities with little more work has ``solve_beside(observables, others, progress)``, whose
    result has those of ``others`` in ``beside``.
    """

    refusal: Callable[[Observable], str | None]
    solve: Callable[[Sequence[Observable], Progress], Result]
    solve_beside: (
        Callable[[Sequence[Observable], Sequence[Observable], Progress], Result] | None
    ) = None


class Method(ABC):
    """A route with its discretisation: a frozen record that can refine itself.

    Whoever wants the plan of a stationary density asks ``planned``, not ``prepare``.

    A method of one's own derives from it as a frozen dataclass, defines the three below, and is
    registered with ``register``.
    """

    @property
    @abstractmethod
    def route(self) -> "Route":
        """The route that the method follows."""

    @abstractmethod
    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` with the reason why not."""

    @abstractmethod
    def refined(self) -> Self:
        """Return the same method at its next finer level."""

    @property
    def name(self) -> str:
        """The method's name on the command line."""
        return self.route.method

    @property
    def solver(self) -> str:
        """How the method's equation is solved, on the command line."""
        return self.route.solver

    def unasked(self, system: System, *, share: float = 1.0) -> Self:
        """Return the method as it is taken where nobody named it, as by ``fpk run``.

        A slow one bounds its work, of which it may take ``share`` for this system, and refuses by
        ``NotApplicable`` where nothing is gained. One that is bounded does not fail where the bound
        ends it: it is left out.
        """
        return self

    def refusal(self, system: System, observable: Observable) -> str | None:
        """Return why the method does not give ``observable``, or None where it does."""
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
        progress: Progress = silent,
    ) -> Result:
        """Return the densities of ``observables``; raise ``NotApplicable`` where it refuses.

        An example::

            answer = NonIntegrable().solve(system, [parse_observable("q2", system.n)])
            (p,) = answer.densities

        ``beside`` as of ``solved``.

        Raises ``InvalidInput`` for an observable that is a name instead of a parsed one.
        """
        require_observables(observables)
        plan = self.planned(system, observables)
        return solved(plan, system, observables, beside=beside, progress=progress)

    def planned(self, system: System, observables: Sequence[Observable]) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it refuses an observable.

        Raises it, too, where the method is not for the system, and for every method with one
        reason where the motion escapes, so that no density is stationary.
        """
        require_held(system)
        plan = self.prepare(system)
        for observable in observables:
            if reason := plan.refusal(observable):
                raise NotApplicable(reason)
        return plan


def solved(
    plan: Plan,
    system: System,
    observables: Sequence[Observable],
    *,
    beside: Sequence[Observable] = (),
    progress: Progress = silent,
) -> Result:
    """Return the result of the plan for ``system`` with the seconds that solving took.

    Its densities have its settings as their provenance; those by functions know what they follow
    from and can be pickled. Those of ``beside`` are given where they take little more work.
    """
    start = perf_counter()
    others = [o for o in beside if not plan.refusal(o)] if plan.solve_beside else []
    if plan.solve_beside and others:
        result = plan.solve_beside(observables, others, progress)
    else:
        result = plan.solve(observables, progress)
    source = partial(_density_again, result.method, system)
    known = []
    for densities in (result.densities, result.beside):
        own = (replace(d, provenance=result.settings) for d in densities)
        known.append(tuple(replace(d, source=source) if isinstance(d, Density) else d for d in own))
    seconds = perf_counter() - start
    return replace(result, densities=known[0], beside=known[1], seconds=seconds)


def _density_again(method: Method, system: System, observable: Observable) -> AnyDensity:
    """Return a density solved for again, after unpickling for instance."""
    (density,) = method.solve(system, [observable]).densities
    return density


@dataclass(frozen=True)
class Route:
    """One METHOD with one SOLVER of the command line, and all that others need to know of it.

    ``method`` and ``solver`` are the names on the command line; ``words`` says for legends what is
    solved and how, ``equation`` the number of the paper's equation. ``solves`` is "full" for
    Eq. (6) itself and "averaged" for a theory's equation; ``sampled`` says that the errors are
    those of sampling. ``colour`` is the curve's (#rrggbb). ``make()`` returns the method with its
    default settings. ``quick``: an answer does not take seconds, so that ``fpk export`` and the
    references of studies take the route without being told. ``named``: it is taken only where its
    solver is named.
    Of one method's routes the one registered first is the default and the one that is drawn; a
    route that samples comes after those that do not.
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
        """Name for readers: the theory's alone, that of a simulated theory in full."""
        return self.words if self.sampled else self.words.partition(",")[0]

    @property
    def label(self) -> str:
        """Name in tables: the method's own where it has one solver, else method/solver."""
        alone = len(solvers_of(self.method)) <= 1
        return self.method if alone else f"{self.method}/{self.solver}"


ROUTES: dict[tuple[str, str], Route] = {}
"""Every route by (method, solver), in the order of registration."""


def register(route: Route) -> Route:
    """Add a route to the registry and return it; a pair of names is taken once."""
    key = route.method, route.solver
    if key in ROUTES:
        raise ValueError(f"route {route.method}/{route.solver} is registered already")
    ROUTES[key] = route
    return route


def solvers_of(method: str) -> tuple[str, ...]:
    """Return the solvers of a method, its default first and those that sample last."""
    own = [route for route in ROUTES.values() if route.method == method]
    return tuple(route.solver for route in sorted(own, key=lambda route: route.sampled))
