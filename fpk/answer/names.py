"""Names that users write: observables q1..qn, p1..pn, H, H1..Hn and pairs, limits and starts.

This file imports no numerical library at its top: the command line imports it for its help.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, Literal

from fpk.numeric.errors import InvalidInput, require

if TYPE_CHECKING:
    from fpk.numeric.arrays import Array
    from fpk.system.system import System

LEAST_LIMIT = 1e-100
"""Smallest limit: for smaller limits the square of the mean time may underflow."""


@dataclass(frozen=True)
class Coordinate:
    """One observed quantity: displacement, momentum, total energy (no index) or modal energy.

    ``index`` counts from 0; in the name for users it counts from 1.
    """

    kind: Literal["q", "p", "H"]
    index: int | None = None

    @property
    def row(self) -> int:
        """The ``index``, from 0; ``AssertionError`` for the total energy H, which has none."""
        assert self.index is not None
        return self.index

    def __str__(self) -> str:
        """Return the user's name, such as ``q2``."""
        return self.kind if self.index is None else f"{self.kind}{self.index + 1}"


Observable = tuple[Coordinate, ...]
"""One coordinate, or two for a joint density."""

Level = tuple[Observable, float]
"""An observable of one coordinate and a value of it."""


def parse_observable(text: str, n: int) -> Observable:
    """Return the observable named by ``text``, such as ``H`` or ``q2,p2``, in a system of ``n``
    masses. Raises ``InvalidInput`` for an unknown name, an index above ``n``, more than two names,
    or a coordinate named twice."""
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
    """Return the name of ``observable`` as users write it, such as ``q2,p2``."""
    return ",".join(map(str, observable))


def require_one_array_an_axis(observable: Observable, points: Sequence[Any]) -> None:
    """Raise ``InvalidInput`` unless ``points`` has one entry per coordinate of ``observable``."""
    words = f"{observable_name(observable)} takes {len(observable)}, one for each coordinate"
    require(len(points) == len(observable), "arrays of points", len(points), words)


def displacement_row(observable: Observable) -> int:
    """Return the number, from 0, of the mass whose displacement ``observable`` is. Raises
    ``InvalidInput`` for any observable that is not one displacement."""
    require_observables([observable])
    fits = len(observable) == 1 and observable[0].kind == "q"
    words = "is not a displacement; use q1, q2, ..."
    require(fits, "observable", observable_name(observable), words)
    return observable[0].row


def require_observables(observables: Sequence[Any]) -> None:
    """Raise ``InvalidInput`` unless all are tuples of one or two ``Coordinate``, as
    ``parse_observable`` returns: a name such as "q2" is refused."""
    for observable in observables:
        parsed = isinstance(observable, tuple) and len(observable) in (1, 2)
        if not parsed or not all(isinstance(c, Coordinate) for c in observable):
            words = 'is not parsed; use parse_observable("q2", system.n)'
            raise InvalidInput("observable", observable, words)


def number_text(value: float) -> str:
    """Return the shortest text that parses as ``value``, whole numbers without a decimal point."""
    return repr(float(value)).removesuffix(".0")


Kinds = Iterable[tuple[str, Sequence[str], int]]
"""Kinds of quantities, with the allowed names and the smallest number of names."""


def parse_numbers(
    key: str, text: str, kinds: Kinds, remedy: str, *, relation: str = "="
) -> tuple[str, dict[str, float]]:
    """Return the kind and the numbers by name of ``text``, such as ``a=1,b=2``.

    The first of ``kinds`` that fits is returned. ``relation`` stands between name and number.
    Raises ``InvalidInput(key, text, remedy)`` if none fits, a name is given twice or a number is
    not finite.
    """
    values: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = (word.strip() for word in part.partition(relation))
        try:
            value = float(number)
        except ValueError:
            value = inf
        require(name not in values and isfinite(value), key, text, remedy)
        values[name] = value
    for kind, names, needed in kinds:
        if values.keys() <= {*names} and len(values) >= needed:
            return kind, values
    raise InvalidInput(key, text, remedy)


@dataclass(frozen=True)
class Named:
    """Numbers ``values`` by the names of their quantities, and the ``kind`` of the quantities."""

    kind: str
    values: Mapping[str, float]

    def __str__(self) -> str:
        """Return the text that users write, such as ``H1=0.4,H2=0.6``; ``rest`` without values."""
        return ",".join(f"{k}={number_text(v)}" for k, v in self.values.items()) or "rest"


@dataclass(frozen=True)
class Limit(Named):
    """Limits of safe operation: the system fails when a quantity first exceeds its value.

    ``kind`` is "H" (the total energy; in modal averaging the sum of modal energies), "modal"
    (modal energies H1.., whichever exceeds its limit first), "q" or "v" (displacement or velocity x
    of one mass). ``relation`` is "=" for energies and for |x|, ">" or "<" where x passes its value
    in that direction.
    """

    relation: str = "="

    def __str__(self) -> str:
        """Return the text that users write, such as ``q1>1.2``."""
        return super().__str__().replace("=", self.relation)

    @property
    def value(self) -> float:
        """Value of the only limited quantity; ``ValueError`` if several are limited."""
        (value,) = self.values.values()
        return value

    @property
    def row(self) -> int:
        """Number, from 0, of the mass whose displacement or velocity is limited."""
        (name,) = self.values
        return int(name[1:]) - 1

    @property
    def of_energy(self) -> bool:
        """Whether energies are limited, not a displacement or velocity."""
        return self.kind in ("H", "modal")

    @property
    def bounds(self) -> tuple[float, float]:
        """Ends of the safe interval of the displacement or velocity, −∞ or ∞ where there is no
        limit."""
        low = {"=": -self.value, "<": self.value, ">": -inf}[self.relation]
        return low, inf if self.relation == "<" else self.value

    @property
    def ends(self) -> list[float]:
        """Finite ones of the ``bounds``, the right one first."""
        return [end for end in self.bounds[::-1] if isfinite(end)]

    def distance(self, q: "Array", v: "Array") -> "Array":
        """Return the distance (...) of displacements ``q``, velocities ``v`` (..., n) from the
        nearest of the ``bounds``, <= 0 at the limit and beyond."""
        import numpy as np  # noqa: PLC0415  (see above)

        (low, high), x = self.bounds, (q if self.kind == "q" else v)[..., self.row]
        return np.asarray(np.minimum(high - x, x - low))


def parse_limit(text: str, n: int) -> Limit:
    """Return the limit named by ``text`` in a system of ``n`` masses.

    The energy, modal energies (the first to exceed its limit), or the displacement or velocity of a
    mass may be limited, these on both sides or on one::

        parse_limit("H=1.5", 2), parse_limit("H1=0.4,H2=0.6", 2), parse_limit("q2=1.2", 2)
        parse_limit("q2>1.2", 2), parse_limit("q1<-0.8", 2), parse_limit("v1=0.9", 2)

    Raises ``InvalidInput`` for an unknown name, several limits of other quantities than modal
    energies, or a value that is not finite, or is not ``LEAST_LIMIT`` or more; on one side of a
    displacement or velocity 0 is a limit, too, and so are negative values of that size.
    """
    relation = next((sign for sign in "<>" if sign in text), "=")
    kinds = [("modal", [f"H{i + 1}" for i in range(n)], 1), ("H", ["H"], 1)]
    kinds = kinds if relation == "=" else []
    kinds += [(kind, [f"{kind}{i + 1}"], 1) for kind in "qv" for i in range(n)]
    # Examples that this system has: of two masses both are shown, of one its own.
    several = "H1=0.4 or H1=0.4,H2=0.6 (whichever is passed first)" if n > 1 else "H1=0.4"
    q, v = (f"{kind}{min(n, 2)}" for kind in "qv")
    either = f"{q}=1.2 for |{q}|, {q}>1.2, {q}<-1.2 or {v}=1.2"
    remedy = f"use H=1.5, {several}, {either}, without a unit"
    limit = Limit(*parse_numbers("limit", text, kinds, remedy, relation=relation), relation)
    least = min(limit.values.values())
    if (least if relation == "=" else abs(least) or inf) < LEAST_LIMIT:
        raise InvalidInput("limit", text, f"must be > 0, {LEAST_LIMIT:g} at least")
    return limit


class Start(Named):
    """Initial state of a motion at time 0.

    ``values`` by ``kind``: "state" has displacements q1.. and momenta p1.. (0 unless given, none:
    rest), "energy" has H, "modal" has all modal energies H1.., and "noise" has a factor ``noise``:
    the initial state is stationary under the noise intensity ``noise`` · D.
    """

    @property
    def rest(self) -> bool:
        """Whether all values are 0, so that the motion starts at rest, whatever the kind."""
        return not any(self.values.values())

    def state(self, n: int) -> "tuple[Array, Array]":
        """Return q and p, (``n``,) each, 0 unless given, of a start of the kind "state"."""
        import numpy as np  # noqa: PLC0415  (see above)

        q, p = (np.array([self.values.get(f"{k}{i + 1}", 0.0) for i in range(n)]) for k in "qp")
        return q, p


REST = Start("state", {})


def parse_start(text: str, system: "System") -> Start:
    """Return the start named by ``text`` in ``system``.

    At rest, at an energy, in the stationary state under half the noise, in a given state::

        parse_start("rest", system), parse_start("H=0.3", system), parse_start("noise=0.5", system)
        parse_start("q1=0.2,p1=0.1", system)

    Raises ``InvalidInput`` for an unknown name, a mixture of kinds, a number that is not finite, a
    negative energy or factor, missing modal energies, or a stationary start of a system whose
    motion escapes.
    """
    from fpk.system.escape import escape  # noqa: PLC0415  (see above)

    if text.strip() == "rest":
        return REST
    q, p, modal = ([f"{kind}{i + 1}" for i in range(system.n)] for kind in "qpH")
    kinds = ("state", q + p, 1), ("energy", ["H"], 1), ("modal", modal, system.n)
    start = Start(
        *parse_numbers(
            "start",
            text,
            (*kinds, ("noise", ["noise"], 1)),
            "use rest, H=0.3, modal energies H1=0.1,H2=0.2, a state q1=0.2,p1=0.1,.. (what is left "
            "out is 0), or noise=0.5 for the stationary state under that multiple of the noise "
            "intensity",
        )
    )
    if start.kind != "state" and min(start.values.values()) < 0.0:
        raise InvalidInput("start", text, "must not be negative")
    if start.kind == "noise" and not start.rest and (reason := system.fact(escape)):
        raise InvalidInput("start", text, f"there is no stationary state: {reason}")
    return start
