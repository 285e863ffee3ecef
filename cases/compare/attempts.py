"""Routes asked one after the other: their wall time, their tolerances, the reasons of refusals.

The simulations of a command share its wall time among its questions and their routes. A route that
misses its default tolerance is asked again at a looser one.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from math import ceil, inf, isnan, log10
from typing import Any, TypeVar

from fpk.answer.certificate import Certificate
from fpk.answer.method import Progress, Route, silent
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.numeric.machine import working_time

Answer = TypeVar("Answer")

INTERRUPTED = "not finished: the program was interrupted"
"""Reason of a route that Ctrl-C ended, and of all routes after it."""

REFUSALS = (NotApplicable, NotCertified, InvalidInput)
"""Errors by which a method says that it gives no answer."""

LOOSEST = 1e-4
"""Largest tolerance to which a missed default tolerance is loosened: well below the sampling errors
of simulations."""


@dataclass
class Budget:
    """Wall time of the simulations of a command, shared among questions and routes.

    ``seconds`` remain for ``questions``; None: simulations are not bounded. Each question gets an
    equal share of the remaining time, and each of its routes an equal share of the question's; time
    that a route does not use passes to the routes after it. ``clock`` returns the time in seconds,
    less the time of compilation.
    """

    seconds: float | None = None
    questions: int = 1
    clock: Callable[[], float] = working_time
    _own: float = 0.0
    _routes: int = 1

    def begin(self, routes: int) -> None:
        """Give the next question its share for ``routes`` routes; subtract 1 from ``questions``."""
        self._own, self._routes = (self.seconds or 0.0) / max(1, self.questions), routes
        self.questions -= 1

    def spend(self, method: Any, work: Callable[[Any], Answer]) -> Answer:
        """Return ``work(method)``; a simulation gets its share of the time as ``seconds``.

        The time that it takes is subtracted, also if it raises; nothing is changed without a bound.
        The share is never below 1 ms: a simulation that starts late then says that its time did not
        suffice.
        """
        if self.seconds is None or not method.route.sampled:
            return work(method)
        share = max(1e-3, round(self._own / max(1, self._routes), 3))  # messages quote it
        begin = self.clock()
        try:
            return work(replace(method, seconds=share))
        finally:
            taken = self.clock() - begin
            self._own, self.seconds = self._own - taken, self.seconds - taken
            self._routes -= 1


@dataclass(frozen=True)
class Refusal:
    """Why a route gives no answer for some observables.

    ``gave_up``: the route was already at work on the answer. ``failed``: an answer was to be
    expected of it, so that the run is not in order.
    """

    route: Route
    observables: tuple[str, ...]
    reason: str
    failed: bool = False
    gave_up: bool = False


@dataclass
class Attempts:
    """Asks one route after the other; ``refused`` collects the routes without an answer.

    ``partial``: Ctrl-C sets ``interrupted``, the running route has failed and all later routes are
    refused; without it ``KeyboardInterrupt`` is raised. ``relax``: all tolerances are defaults,
    which may be loosened; ``notes`` say which were missed. ``budget``: wall time of simulations.
    """

    partial: bool = False
    relax: bool = False
    budget: Budget = field(default_factory=Budget)
    progress: Progress = silent
    refused: list[Refusal] = field(default_factory=list)
    interrupted: bool = False
    notes: list[str] = field(default_factory=list)

    def refuse(self, route: Route, observables: Iterable[str], reason: str, **how: bool) -> None:
        """Add the refusal of a route; ``how`` has the fields ``failed`` and ``gave_up``."""
        self.refused.append(Refusal(route, tuple(observables), reason, **how))

    def answer_of(
        self,
        route: Route,
        observables: Iterable[str],
        work: Callable[[], Answer],
        *,
        failures: tuple[type[Exception], ...],
    ) -> Answer | None:
        """Return ``work()``; if it raises one of ``REFUSALS``, add the refusal and return None.

        The refusal is of ``route`` for ``observables``, failed if the error has a type in
        ``failures``. It is also added, without ``work``, if interrupted before, and as failed if
        interrupted now with ``partial``.
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
            self.refuse(route, observables, INTERRUPTED, failed=True, gave_up=True)
        except REFUSALS as error:
            failed = isinstance(error, failures)
            self.refuse(route, observables, str(error), failed=failed, gave_up=True)
        return None

    def at_default(
        self,
        label: str,
        ask: Callable[..., Answer],
        certificates: Callable[[Answer], Iterable[Certificate]],
    ) -> Answer:
        """Return ``ask(tol=None)``; with ``relax`` the answer of ``loosen_tolerance``.

        ``certificates`` returns the certificates of an answer. A note on a looser tolerance is
        added to ``notes`` behind ``label``.
        """
        if not self.relax:
            return ask(tol=None)
        answer, note = loosen_tolerance(ask, certificates)
        self.notes += [f"{label}: {note}"] if note else []
        return answer


def loosen_tolerance(
    ask: Callable[..., Answer], certificates: Callable[[Answer], Iterable[Certificate]]
) -> tuple[Answer, str]:
    """Return the answer ``ask(tol=)`` at its default tolerance (None), or looser.

    If its error misses the default: the answer at the least power of ten not below this error, up
    to ``LOOSEST``, and a note on that tolerance; the default answer and an empty note if no such
    answer is certified by all its ``certificates``.
    """
    first = answer = ask(tol=None)
    note = ""
    while errors := [c.missed for c in certificates(answer) if c.missed is not None]:
        if not (missed := max(inf if isnan(error) else error for error in errors)) <= LOOSEST:
            break
        tol = 10.0 ** ceil(log10(missed))
        note = f"certified to {tol:.0e}, as the default tolerance could not be met"
        answer = ask(tol=tol)
    certified = all(certificate.certified for certificate in certificates(answer))
    return (answer, note) if certified else (first, "")
