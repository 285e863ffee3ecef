"""Base class of methods, their plans for a system, and their results."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Self

from fpk.density import AnyDensity, Density
from fpk.errors import NotApplicable
from fpk.escape import require_held
from fpk.observable import Observable, require_observables
from fpk.route import Route
from fpk.system import System

Progress = Callable[[int, int, str], None]
"""Called as ``progress(done, total, what)`` while a method works."""


def silent(done: int, total: int, what: str) -> None:
    """Report no progress."""


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
    registered with ``fpk.route.register``.
    """

    @property
    @abstractmethod
    def route(self) -> Route:
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


@dataclass(frozen=True)
class Source:
    """Method and system of a density: calling it solves again, after unpickling for instance."""

    method: Method
    system: System

    def __call__(self, observable: Observable) -> AnyDensity:
        """Return the density of ``observable``, solved for again."""
        (density,) = self.method.solve(self.system, [observable]).densities
        return density


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
    source = Source(result.method, system)

    def known(densities: Sequence[AnyDensity]) -> tuple[AnyDensity, ...]:
        return tuple(
            replace(d, source=source, provenance=result.settings)
            if isinstance(d, Density)
            else replace(d, provenance=result.settings)
            for d in densities
        )

    return replace(
        result,
        densities=known(result.densities),
        beside=known(result.beside),
        seconds=perf_counter() - start,
    )
