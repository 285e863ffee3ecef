"""The record of one hard case, and the registry of the groups in which they are run."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from fpk.method import Progress


@dataclass(frozen=True)
class Check:
    """One thing that must hold, with what was measured."""

    what: str
    holds: bool
    measured: str


@dataclass(frozen=True)
class HardCase:
    """What came of one hard case.

    ``hard`` says what makes it so, ``plain`` what a plain method gave when it was run, ``ours``
    what this program gave, ``certificate`` what it says of that. It passes if all ``checks`` hold.
    """

    name: str
    hard: str
    plain: str
    ours: str
    certificate: str
    checks: tuple[Check, ...]
    seconds: float

    @property
    def failures(self) -> tuple[str, ...]:
        """The checks that do not hold, in words."""
        return tuple(f"{c.what}: {c.measured}" for c in self.checks if not c.holds)


Group = Callable[[Progress], Iterator[HardCase]]
"""Runs some cases one after the other."""
