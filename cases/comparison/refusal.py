"""Routes asked one after the other, and why some of them give no answer."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TypeVar

from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.route import Route

Answer = TypeVar("Answer")

INTERRUPTED = "not finished: the program was interrupted"
"""Reason of a route that Ctrl-C ended or that would have come after it."""


REFUSALS = (NotApplicable, NotCertified, InvalidInput)
"""Errors by which a method says that it gives no answer."""


@dataclass(frozen=True)
class Refusal:
    """A route not taken for some observables; ``failed`` when it was tried and did not succeed."""

    route: Route
    observables: tuple[str, ...]
    reason: str
    failed: bool = False


@dataclass
class Attempts:
    """Asks one route after the other, and collects in ``refused`` those that give no answer.

    With ``partial`` Ctrl-C makes it ``interrupted``: the route that was at work has failed, and
    all later ones are refused. Without it Ctrl-C is raised.
    """

    partial: bool
    refused: list[Refusal] = field(default_factory=list)
    interrupted: bool = False

    def refuse(
        self, route: Route, observables: Iterable[str], reason: str, *, failed: bool = False
    ) -> None:
        """Add a refusal."""
        self.refused.append(Refusal(route, tuple(observables), reason, failed))

    def answer_of(
        self,
        route: Route,
        observables: Iterable[str],
        work: Callable[[], Answer],
        *,
        failures: tuple[type[Exception], ...],
    ) -> Answer | None:
        """Return what ``work()`` does, None where it raises one of ``REFUSALS``.

        Those of ``failures`` count as failed: what was to be expected of the route is missing.
        """
        if self.interrupted:
            self.refuse(route, observables, INTERRUPTED)
            return None
        try:
            return work()
        except KeyboardInterrupt:
            if not self.partial:
                raise
            self.interrupted = True
            self.refuse(route, observables, INTERRUPTED, failed=True)
        except REFUSALS as error:
            self.refuse(route, observables, str(error), failed=isinstance(error, failures))
        return None
