"""Names that users write: observables q1..qn, p1..pn, H, H1..Hn and pairs; numbers by name."""

import re
from collections.abc import Iterable, Sequence
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
        match = re.fullmatch(r"([qp](?=\d)|H)([1-9][0-9]{0,3})?", part.strip(), flags=re.ASCII)
        index = int(match[2]) - 1 if match and match[2] else None
        if match is None or (index is not None and index >= n):
            raise InvalidInput("observable", text, remedy)
        coordinates.append(Coordinate(match[1], index))  # type: ignore[arg-type]
    if not 1 <= len(coordinates) <= 2 or len(set(coordinates)) != len(coordinates):
        raise InvalidInput("observable", text, remedy)
    return tuple(coordinates)


def observable_name(observable: Observable) -> str:
    """Return the name that a user writes, such as ``q2,p2``."""
    return ",".join(map(str, observable))


def displacement_row(observable: Observable) -> int:
    """Return the index from 0 of the mass whose displacement is observed, else ``InvalidInput``."""
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
            words = 'is not parsed; use parse_observable("q2", system.n)'
            raise InvalidInput("observable", observable, words)


def number_text(value: float) -> str:
    """Return the shortest text that reads as ``value`` again, whole numbers without a point."""
    return repr(float(value)).removesuffix(".0")


def parse_numbers(
    key: str, text: str, kinds: Iterable[tuple[str, Sequence[str], int]], remedy: str
) -> tuple[str, dict[str, float]]:
    """Return the kind and the numbers that ``text`` gives by name, as ``a=1,b=2``, each once.

    The first of ``kinds``, (name, names of its numbers, how many it needs), with all names given is
    the kind. Raises ``InvalidInput`` of ``key`` without such a kind or finite numbers.
    """
    values: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = (word.strip() for word in part.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = inf
        if name in values or not isfinite(value):
            raise InvalidInput(key, text, remedy)
        values[name] = value
    for kind, names, needed in kinds:
        if values.keys() <= {*names} and len(values) >= needed:
            return kind, values
    raise InvalidInput(key, text, remedy)
