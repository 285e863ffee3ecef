"""The record of one hard case: what makes it hard, what was measured, what must hold."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One thing that must hold, with what was measured."""

    what: str
    holds: bool
    measured: str


@dataclass(frozen=True)
class HardCase:
    """The outcome of one hard case; it passes if all ``checks`` hold.

    ``hard`` says what makes it so, ``plain`` what a plain method gave when it was run, ``ours``
    what this program gave, ``certificate`` what it says of that.
    """

    name: str
    hard: str
    plain: str
    ours: str
    certificate: str
    checks: tuple[Check, ...]

    @property
    def failures(self) -> tuple[str, ...]:
        """The checks that do not hold, in words."""
        return tuple(f"{c.what}: {c.measured}" for c in self.checks if not c.holds)
