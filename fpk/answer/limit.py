"""Limits whose first passage is asked for: of the energy, of modal energies, of a displacement."""

from collections.abc import Mapping
from dataclasses import dataclass

from fpk.answer.observable import Observable, number_text, parse_numbers, parse_observable
from fpk.numeric.errors import InvalidInput

LEAST = 1e-100
"""Least limit: of a smaller one the square of the mean time leaves the range of double precision
in units not far from it."""


@dataclass(frozen=True)
class Limit:
    """The end of safe operation: the first time at which one of ``values`` is passed.

    ``kind`` is "H" (the energy; of the modes alone, the sum of theirs), "modal" (energies H1..,
    any of those named) or "q" (|q_i| of one displacement); ``values`` are by name.
    """

    kind: str
    values: Mapping[str, float]

    @property
    def value(self) -> float:
        """The limit, where there is one."""
        (value,) = self.values.values()
        return value

    def observable(self, n: int) -> Observable:
        """Return what has the limit, where there is one."""
        (name,) = self.values
        return parse_observable(name, n)

    def __str__(self) -> str:
        """Return the name that a user writes."""
        return ",".join(f"{k}={number_text(v)}" for k, v in self.values.items())


def parse_limit(text: str, n: int) -> Limit:
    """Return the limit that ``text`` names in a system of ``n`` masses.

    Of the energy, of modal energies (whichever is passed first), of a displacement::

        parse_limit("H=1.5", 2), parse_limit("H1=0.4,H2=0.6", 2), parse_limit("q2=1.2", 2)

    Raises ``InvalidInput`` for an unknown name, several limits that are not modal energies, or one
    that is not a finite number of at least ``LEAST``.
    """
    kinds = [("modal", [f"H{i + 1}" for i in range(n)], 1), ("H", ["H"], 1)]
    kinds += [("q", [f"q{i + 1}"], 1) for i in range(n)]
    remedy = "use H=1.5, H1=0.4 or H1=0.4,H2=0.6 (whichever is passed first), or q2=1.2 for |q2|"
    kind, values = parse_numbers("limit", text, kinds, remedy)
    if min(values.values()) < LEAST:
        raise InvalidInput("limit", text, f"must be > 0, {LEAST:g} at least")
    return Limit(kind, values)
