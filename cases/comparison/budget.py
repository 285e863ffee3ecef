"""The wall time of a command's simulations, shared among its questions and their routes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from fpk.clock import working_time

Answer = TypeVar("Answer")

LEAST = 1e-3
"""Seconds that a simulation gets at the least: one that is late leaves none to those that follow,
which then say that they had too little."""


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
