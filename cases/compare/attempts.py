"""Routes asked one after the other: their wall time, their tolerances, and why some do not answer.

A command's simulations share its wall time among its questions and their routes. An answer that
misses a default tolerance is asked for again at a looser one.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, inf, isnan, log10
from typing import Any, TypeVar

from fpk.answer.certificate import Certificate
from fpk.answer.method import Route
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.numeric.machine import working_time

Answer = TypeVar("Answer")

INTERRUPTED = "not finished: the program was interrupted"
"""Reason of a route that Ctrl-C ended or that would have come after it."""

REFUSALS = (NotApplicable, NotCertified, InvalidInput)
"""Errors by which a method says that it gives no answer."""

LEAST = 1e-3
"""Seconds that a simulation gets at the least: one that is late leaves none to those that follow,
which then say that they had too little."""

LOOSEST = 1e-4
"""Largest tolerance that takes the place of a default one that is missed: it is still well below
what simulations resolve."""


@dataclass
class Budget:
    """``seconds`` that are left for ``questions``, None where nothing bounds the simulations.

    Each question gets an equal share of what is left, and each of its routes one of what is left of
    that: time that one does not use goes on to those that follow. ``clock`` tells the time in
    seconds, without that of compiling.
    """

    seconds: float | None = None
    questions: int = 1
    clock: Callable[[], float] = working_time
    _own: float = 0.0
    _routes: int = 1

    def begin(self, routes: int) -> None:
        """Begin the next question, which so many sampled ``routes`` may answer."""
        self._own, self._routes = (self.seconds or 0.0) / max(1, self.questions), routes
        self.questions -= 1

    def spend(self, method: Any, work: Callable[[Any], Answer]) -> Answer:
        """Return ``work(method)``, of a sampled method with its share as ``seconds``."""
        if self.seconds is None or not method.route.sampled:
            return work(method)
        share, begin = max(LEAST, self._own / max(1, self._routes)), self.clock()
        try:
            return work(replace(method, seconds=share))
        finally:
            taken = self.clock() - begin
            self._own, self.seconds = self._own - taken, self.seconds - taken
            self._routes -= 1


def budget_of(methods: Sequence[Any], questions: int) -> Budget:
    """Return the budget of ``methods``: the ``seconds`` of theirs, the most of any."""
    given = [m.seconds for m in methods if m.route.sampled and getattr(m, "seconds", None)]
    return Budget(max(given, default=None), questions)


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
    """Asks one route after the other, and collects in ``refused`` those that give no answer.

    With ``partial`` Ctrl-C makes it ``interrupted``: the route that was at work has failed, and
    all later ones are refused. Without it Ctrl-C is raised. With ``relax`` tolerances are defaults
    that nobody asked for, see ``at_default``; ``notes`` say in words which of them were missed.
    """

    partial: bool
    relax: bool = False
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
            self.refuse(route, observables, INTERRUPTED, failed=True, gave_up=True)
        except REFUSALS as error:
            failed = isinstance(error, failures)
            self.refuse(route, observables, str(error), failed=failed, gave_up=True)
        return None

    def at_default(
        self,
        label: str,
        ask: Callable[[float | None], Answer],
        certificates: Callable[[Answer], Iterable[Certificate]],
    ) -> Answer:
        """Return ``ask(None)``, or with ``relax`` what ``loosened`` does, with a note on ``label``.

        The note says to which tolerance an answer that misses its default one is certified.
        """
        if not self.relax:
            return ask(None)
        answer, tol = loosened(ask, certificates)
        if tol is not None:
            self.notes.append(f"{label}: {missed_words(tol)}")
        return answer


def missed_words(tol: float) -> str:
    """Return the note on an answer that is certified to ``tol`` instead of its default one."""
    return f"certified to {tol:.0e}, as the default tolerance could not be met"


def loosened(
    ask: Callable[[float | None], Answer],
    certificates: Callable[[Answer], Iterable[Certificate]],
) -> tuple[Answer, float | None]:
    """Return ``ask(None)``, the answer at default tolerances, where it does not miss its own.

    Else the answer at the least power of ten that its error meets, up to ``LOOSEST``, and that
    tolerance; the first answer and None where no such answer is certified by ``certificates``.
    """
    first = answer = ask(None)
    tol = None
    while errors := [c.missed for c in certificates(answer) if c.missed is not None]:
        if not (missed := max(inf if isnan(error) else error for error in errors)) <= LOOSEST:
            break
        tol = 10.0 ** ceil(log10(missed))
        answer = ask(tol)
    certified = all(certificate.certified for certificate in certificates(answer))
    return (answer, tol) if certified else (first, None)
