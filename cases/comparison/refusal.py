"""What a route does not give, and why."""

from dataclasses import dataclass

from fpk.route import Route

INTERRUPTED = "not finished: the program was interrupted"
"""Reason of a route that Ctrl-C ended or that would have come after it."""


@dataclass(frozen=True)
class Refusal:
    """A route not taken for some observables; ``failed`` when it was tried and did not succeed."""

    route: Route
    observables: tuple[str, ...]
    reason: str
    failed: bool = False
