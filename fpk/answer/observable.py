"""Names of what can be observed: q1..qn, p1..pn, H, H1..Hn, or a pair of them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, Literal

from fpk.numeric.errors import InvalidInput


@dataclass(frozen=True)
class Coordinate:
    """One observed quantity: displacement, momentum, energy (index None) or modal energy.

    ``index`` counts from 0 inside; the name that users write and read counts from 1.
    """

    kind: Literal["q", "p", "H"]
    index: int | None = None

    @property
    def row(self) -> int:
        """The index of a coordinate that has one: all but the total energy H."""
        assert self.index is not None
        return self.index

    def __str__(self) -> str:
        """Return the user's name, such as ``q2``."""
        return self.kind if self.index is None else f"{self.kind}{self.index + 1}"


Observable = tuple[Coordinate, ...]
"""One coordinate, or two for a joint density."""

Level = tuple[Observable, float]
"""A level of one coordinate."""


def parse_observable(text: str, n: int) -> Observable:
    """Return the observable that ``text`` names in a system of ``n`` masses.

    Raises ``InvalidInput`` for an unknown name, an index beyond ``n``, or a coordinate named twice.
    """
    remedy = f"is not an observable; use q1..q{n}, p1..p{n}, H, H1..H{n}, or two of them as a,b"
    coordinates = []
    for part in text.split(","):
        match = re.fullmatch(r"([qpH])([1-9][0-9]{0,3})?", part.strip(), flags=re.ASCII)
        if match is None or (match[2] is None and match[1] != "H"):
            raise InvalidInput("observable", text, remedy)
        index = None if match[2] is None else int(match[2]) - 1
        if index is not None and index >= n:
            raise InvalidInput("observable", text, remedy)
        coordinates.append(Coordinate(match[1], index))  # type: ignore[arg-type]
    if not 1 <= len(coordinates) <= 2 or len(set(coordinates)) != len(coordinates):
        raise InvalidInput("observable", text, remedy)
    return tuple(coordinates)


def observable_name(observable: Observable) -> str:
    """Return the name that a user writes, such as ``q2,p2``."""
    return ",".join(map(str, observable))


def displacement_row(observable: Observable) -> int:
    """Return the index of the mass whose displacement is observed, counted from 0.

    Raises ``InvalidInput`` where that is not what is observed.
    """
    require_observables([observable])
    if len(observable) != 1 or observable[0].kind != "q":
        words = "is not a displacement; use q1, q2, ..."
        raise InvalidInput("observable", observable_name(observable), words)
    return observable[0].row


def require_observables(observables: Sequence[Any]) -> None:
    """Raise ``InvalidInput`` for what is no observable: a name has to be parsed first."""
    for observable in observables:
        parsed = isinstance(observable, tuple) and len(observable) in (1, 2)
        if not parsed or not all(isinstance(c, Coordinate) for c in observable):
            raise InvalidInput(
                "observable", observable, 'is not parsed; use parse_observable("q2", system.n)'
            )


def number_text(value: float) -> str:
    """Return the shortest text that reads as ``value`` again, whole numbers without a point."""
    return repr(float(value)).removesuffix(".0")


def parse_numbers(key: str, text: str, remedy: str) -> dict[str, float]:
    """Return the numbers that ``text`` gives by name, as ``a=1,b=2``.

    Raises ``InvalidInput`` of ``key`` where it does not read so, a name comes twice, or a number is
    not finite.
    """
    values: dict[str, float] = {}
    for part in text.split(","):
        name, equals, number = (word.strip() for word in part.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = inf
        if not (name and equals and isfinite(value)) or name in values:
            raise InvalidInput(key, text, remedy)
        values[name] = value
    return values
