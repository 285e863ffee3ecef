"""Quantities by name, such as ``rms(q2)`` and ``failure_rate(H=1.5)``: parsed, never evaluated.

Each is defined here once: its name, the density or answer it follows from, and its number. A run
shows the ``definitions_of`` each density, a sweep gives any.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan

from cases.scene.errors import misspelt
from fpk.answer.contacts import contact_quantity, ratio
from fpk.answer.density import AnyDensity
from fpk.answer.names import (
    Coordinate,
    Level,
    Limit,
    Observable,
    displacement_row,
    number_text,
    observable_name,
    parse_limit,
    parse_observable,
)
from fpk.answer.quantities import Number
from fpk.numeric.errors import InvalidInput, require
from fpk.system.contact import Contact
from fpk.system.system import System

MOMENTS = ("mean", "rms", "std", "skewness", "kurtosis")
PLAIN = (*MOMENTS, "variance")
PAIR = ("covariance", "correlation")
AT_NUMBER = ("quantile", "exceedance", "cdf")
"""Methods of a density of one coordinate that take a number: a probability, or a level. ``PLAIN``
methods take none, ``PAIR`` methods are of a pair of coordinates."""
QUANTILES = {"quantile 1 %": 0.01, "median": 0.5, "quantile 99 %": 0.99}
"""Quantiles that a run shows, by their names there."""
UPCROSSING = "upcrossing_rate"
AT_STOP = (
    *("contact_probability", UPCROSSING, "mean_overlap", "overlap_in_contact"),
    *("mean_force", "force_in_contact"),
)
"""Numbers of one stop in the order of the tables; its impact rate is ``UPCROSSING``."""
PASSAGE = {"failure_rate": "rate", "mean_passage": "mean"}
"""Quantities of a first passage from rest: attribute of ``Passage``."""
RELAXATION = "relaxation_rate"
AVERAGING = "averaging_error"
MOST_RATES = 100
RESOLVED = 0.01
"""Largest error of a force that is certified although the force itself is smaller, in units of the
force of the springs at the rms displacement."""
FORMS = (
    *(f"{name}(q1)" for name in PLAIN), "quantile(q1,0.99)", "exceedance(q1,1.2)", "cdf(q1,1.2)",
    *(f"{name}(q1,p1)" for name in PAIR), *(f"{name}(1)" for name in AT_STOP),
    "mean_force(1,left)", f"{UPCROSSING}(q1,1.2)", *(f"{name}(H=1.5)" for name in PASSAGE),
    f"{RELAXATION}(1)", f"{AVERAGING}(q1)",
)  # fmt: skip


@dataclass(frozen=True)
class Definition:
    """A quantity such as ``quantile(q2,0.99)``: ``kind`` stands before the parenthesis.

    ``observable`` is the coordinate or pair, and ``at`` a probability, a level, or the number of a
    relaxation rate, from 1. ``contact`` counts the contacts from 0, ``side`` names one of its
    stops, empty for both. ``limit``: of a first passage from rest. Fields that a kind does not need
    are empty or None.
    """

    kind: str
    observable: Observable = ()
    at: float | None = None
    contact: int | None = None
    side: str = ""
    limit: Limit | None = None

    def __str__(self) -> str:
        """Return the name that a user writes."""
        if self.contact is not None:
            inside = [str(self.contact + 1), self.side]
        else:
            inside = [observable_name(self.observable), str(self.limit or "")]
        inside += [] if self.at is None else [number_text(self.at)]
        return f"{self.kind}({','.join(filter(None, inside))})"

    def words(self, system: System) -> str:
        """Return the name in tables of a run, such as ``contact probability, left stop``."""
        for words, p in QUANTILES.items():
            if (self.kind, self.at) == ("quantile", p):
                return words
        words = self.kind.replace("_", " ")
        if self.kind == "exceedance" and self.at is not None:
            return f"probability above {number_text(self.at)}"
        if self.contact is None:
            return words
        (stop,) = self.stops(system)
        alone = [(s.mass, s.side) for s in system.stops].count((stop.mass, stop.side)) == 1
        where = "" if alone else f" at {stop.sign * stop.clearance:g}"
        return f"{words}, {stop.side} stop{where}"

    def stops(self, system: System) -> tuple[Contact, ...]:
        """Return the stops of the contact on ``side``, empty: on both; none without a contact."""
        if self.contact is None:
            return ()
        sides = system.contacts[self.contact].one_sided()
        return tuple(stop for stop in sides if self.side in ("", stop.side))

    def levels(self, system: System) -> tuple[float, ...]:
        """Return the displacements of the upcrossings: ``at``, or the stops' positions."""
        if self.at is not None:
            return (self.at,)
        return tuple(stop.sign * stop.clearance for stop in self.stops(system))

    def of(self, density: AnyDensity, system: System) -> Number:
        """Return the number that follows from ``density``, stationary and of ``observable``.

        Numbers and errors of both sides of a contact are added; a kind "…_in_contact" is the sum of
        the means over the sum of the contact probabilities.
        """
        if self.contact is None:
            number: Number = getattr(density, self.kind)(*(() if self.at is None else (self.at,)))
            return number
        what, _, share = self.kind.partition("_in_")
        names = [f"mean {what}", "contact probability"] if share else [what.replace("_", " ")]
        stops = self.stops(system)
        sums = [total([contact_quantity(name, stop, density) for stop in stops]) for name in names]
        return ratio(*sums) if share else sums[0]

    def failures(
        self, number: Number, density: AnyDensity | None, system: System
    ) -> tuple[str, ...]:
        """Return why ``number`` of a certified answer is not certified itself: none or one reason.

        The error of a failure rate, a time or a force must be below its value; a force that is zero
        up to rounding is certified if its error is small beside the forces of the springs. The
        errors of other quantities are bounded by the certificate of the answer. ``density``: the
        density from which the number follows, None if from none.
        """
        force = 0.0
        if density is not None and self.contact is not None and "force" in self.kind:
            index = system.contacts[self.contact].index
            force = system.stiffness_matrix[index, index] * density.rms().value
        elif self.kind not in PASSAGE:
            return ()
        if abs(number.value) > number.error or number.error < RESOLVED * force:
            return ()
        return (f"the error {number.error:.2g} is not below the value {number.value:.2g}",)


def total(numbers: Sequence[Number]) -> Number:
    """Return the sum of ``numbers``; errors are added, as they may have the same sign."""
    return Number(sum(x.value for x in numbers), sum(x.error for x in numbers))


def definitions_of(
    system: System, observable: Observable, exceedance: Sequence[Level] = ()
) -> tuple[Definition, ...]:
    """Return the quantities of ``observable`` that a run shows, in the order of its tables.

    For a coordinate: ``MOMENTS``, ``QUANTILES``, and P(X > a) of its levels in ``exceedance``; for
    a displacement also ``AT_STOP`` of every stop of its mass. For a pair: ``PAIR``.
    """
    if len(observable) > 1:
        return tuple(Definition(kind, observable) for kind in PAIR)
    own = [Definition(kind, observable) for kind in MOMENTS]
    own += [Definition("quantile", observable, p) for p in QUANTILES.values()]
    own += [Definition("exceedance", observable, a) for of, a in exceedance if of == observable]
    for k, contact in enumerate(system.contacts):
        if observable == (Coordinate("q", contact.index),):
            for stop in contact.one_sided():
                own += [Definition(x, observable, contact=k, side=stop.side) for x in AT_STOP]
    return tuple(own)


def parse_definition(text: str, system: System) -> Definition:
    """Return the quantity that ``text``, as rms(q2), names; raise ``InvalidInput`` for none."""
    match = re.fullmatch(r"\s*(\w+)\s*\((.*)\)\s*", text)
    kind, inside = (match[1], match[2].strip()) if match else (text, "")
    name, _, rest = (part.strip() for part in inside.partition(","))
    try:
        if match and kind in (*PLAIN, *PAIR, AVERAGING):
            sizes = {AVERAGING: (1, 2)}.get(kind, (1 + (kind in PAIR),))
            return Definition(kind, _observable(inside, system, sizes))
        if match and (kind in AT_NUMBER or (kind == UPCROSSING and name.startswith("q"))):
            observable = _observable(name, system)
            if kind == UPCROSSING:
                displacement_row(observable)
            return Definition(kind, observable, _number(kind, rest))
        if match and kind in PASSAGE:
            return Definition(kind, limit=parse_limit(inside, system.n))
        if match and kind == RELAXATION:
            words = f"counts the rates from 1 to {MOST_RATES}, the slowest first"
            return Definition(kind, at=float(_parse_count("rate", inside, MOST_RATES, words)))
        if match and kind in AT_STOP:
            count = len(system.contacts)
            given = f"use 1 to {count}" if count else "the scene has no [[contact]]"
            words = f"is no contact of the scene; {given}"
            index = _parse_count("contact", name, count, words) - 1
            contact = system.contacts[index]
            sides = [stop.side for stop in contact.one_sided()]
            remedy = f"is no side of contact {name}; use {' or '.join(sides)}"
            require(rest in ("", *sides), "side", rest, remedy)
            mass = (Coordinate("q", contact.index),)
            return Definition(kind, mass, contact=index, side=rest)
    except InvalidInput as error:
        raise InvalidInput("quantity", text, f'"{error.value}" {error.remedy}') from None
    near = misspelt(kind, [form.partition("(")[0] for form in FORMS])
    hint = f"did you mean {near}? " if near and near != kind else ""
    raise InvalidInput("quantity", text, f"is no quantity; {hint}use one of {', '.join(FORMS)}")


def _observable(text: str, system: System, sizes: Sequence[int] = (1,)) -> Observable:
    observable = parse_observable(text, system.n)
    if len(observable) not in sizes:
        one = "is one coordinate; name a pair, as q1,p1"
        words = one if sizes == (2,) else "is a pair; name one coordinate"
        raise InvalidInput("observable", text, words)
    return observable


def _parse_count(key: str, text: str, most: int, remedy: str) -> int:
    require(re.fullmatch(r"[0-9]{1,4}", text) and 1 <= int(text) <= most, key, text, remedy)
    return int(text)


def _number(kind: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not isfinite(value):
        raise InvalidInput("number", text.strip(), "must be a finite number, as exceedance(q1,1.2)")
    if kind == "quantile" and not 0.0 < value < 1.0:
        raise InvalidInput("number", value, "must be a probability between 0 and 1")
    return value
