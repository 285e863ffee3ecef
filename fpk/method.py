"""What every route from a system to densities has in common."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from fpk.density import AnyDensity
from fpk.errors import InvalidInput, NotApplicable
from fpk.observable import Observable
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
    """What one method found: a density per observable asked for, and what it can say of itself."""

    method: "Method"
    densities: tuple[AnyDensity, ...]
    seconds: float
    identities: tuple[Identity, ...] = ()
    settings: Mapping[str, str | float | int] = field(default_factory=dict)


class Method(Protocol):
    """A route: a frozen record of its own discretisation that can refine itself."""

    @property
    def name(self) -> str:
        """The method's name on the command line."""
        ...

    @property
    def solver(self) -> str:
        """How the method's equation is solved, on the command line."""
        ...

    def refusal(self, system: System, observable: Observable) -> str | None:
        """Return why the method does not apply, or None where it does."""
        ...

    def solve(
        self,
        system: System,
        observables: Sequence[Observable],
        *,
        progress: Progress = silent,
    ) -> Result:
        """Return the densities of ``observables``; raise ``NotApplicable`` where it refuses."""
        ...

    def refined(self) -> Self:
        """Return the same method at its next finer level."""
        ...


def require_applicable(method: Method, system: System, observables: Sequence[Observable]) -> None:
    """Raise ``NotApplicable`` with the method's reason where it refuses one of ``observables``."""
    for observable in observables:
        if reason := method.refusal(system, observable):
            raise NotApplicable(reason)


def check_solver(solver: str, known: Sequence[str], tol: float) -> None:
    """Raise ``InvalidInput`` for an unknown solver or a tolerance outside 1e-12 to 0.1."""
    if solver not in known:
        raise InvalidInput("solver", solver, f"use one of {sorted(known)}")
    if not 1e-12 <= tol <= 0.1:
        raise InvalidInput("tol", tol, "must lie between 1e-12 and 0.1")
