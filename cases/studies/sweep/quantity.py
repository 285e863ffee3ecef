"""Quantities by name, such as ``rms(q2)`` and ``failure_rate(H=1.5)``: read, never evaluated."""

import re
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite
from typing import Any

from fpk.contact_quantities import contact_quantities, ratio
from fpk.density import AnyDensity
from fpk.errors import InvalidInput
from fpk.limit import Limit, parse_limit
from fpk.number import Number
from fpk.observable import Coordinate, Observable, observable_name, parse_observable
from fpk.system import System

PLAIN = ("mean", "rms", "std", "variance", "skewness", "kurtosis")
AT_NUMBER = ("quantile", "exceedance", "cdf")
"""Methods of a density of one coordinate: of its own, and of a number."""
CONTACT = ("contact_probability", "mean_overlap", "mean_force", "overlap_in_contact",
           "force_in_contact")  # fmt: skip
"""Numbers of ``contact_quantities``."""
PASSAGE = {"failure_rate": "rate", "mean_passage": "mean"}
"""Numbers of a ``Passage`` from rest."""
AVERAGING = "averaging_error"
RESOLVED = 0.01
"""Largest error of a force that is certified although the force itself is smaller, in units of the
force of the springs at the rms displacement."""
FORMS = (
    *(f"{name}(q1)" for name in PLAIN), "quantile(q1,0.99)", "exceedance(q1,1.2)", "cdf(q1,1.2)",
    *(f"{name}(1)" for name in CONTACT), *(f"{name}(H=1.5)" for name in PASSAGE),
    f"{AVERAGING}(q1)",
)  # fmt: skip


@dataclass(frozen=True)
class Quantity:
    """A number of a stationary density of ``observable``, or of the first passage of ``limit``.

    ``kind`` is its name before the parenthesis, ``at`` the number of ``AT_NUMBER``, ``contact``
    counts the contacts from 0.
    """

    kind: str
    observable: Observable = ()
    at: float | None = None
    contact: int = 0
    limit: Limit | None = None

    def __str__(self) -> str:
        """Return the name that a user writes."""
        if self.kind in CONTACT:
            return f"{self.kind}({self.contact + 1})"
        own = observable_name(self.observable) if self.limit is None else str(self.limit)
        return f"{self.kind}({own})" if self.at is None else f"{self.kind}({own},{self.at:.12g})"

    def of(self, density: AnyDensity, system: System) -> Number:
        """Return the number of a stationary density of ``observable``.

        What both sides of a contact feel is added up, as are its errors.
        """
        if self.kind not in CONTACT:
            number: Number = getattr(density, self.kind)(*(() if self.at is None else (self.at,)))
            return number
        name = self.kind.replace("_", " ")
        sides = system.contacts[self.contact].one_sided()
        felt = [contact_quantities(stop, density) for stop in sides]
        if len(felt) == 1:
            return felt[0][name]

        def total(name: str) -> Number:
            return Number(sum(f[name].value for f in felt), sum(f[name].error for f in felt))

        if name.endswith("in contact"):
            return ratio(total(f"mean {name.split()[0]}"), total("contact probability"))
        return total(name)

    def failures(
        self, number: Number, density: AnyDensity | None, system: System
    ) -> tuple[str, ...]:
        """Return why ``number``, of a certified answer, is not certified itself: no reason, or one.

        A rate, a time or a force has no bound but its own size: an error beyond it says nothing. A
        force that is zero but for rounding is known beside those of the springs. Other quantities
        are of the size of a probability or of the displacement, to which the certificate of their
        ``density`` (None of a passage) bounds their errors.
        """
        force = 0.0
        if density is not None:
            if "force" not in self.kind:
                return ()
            index = system.contacts[self.contact].index
            force = system.stiffness_matrix[index, index] * density.rms().value
        if abs(number.value) > number.error or number.error < RESOLVED * force:
            return ()
        return (f"the error {number.error:.2g} is not below the value {number.value:.2g}",)


def parse_quantity(text: str, system: System) -> Quantity:
    """Return the quantity that ``text`` names for ``system``; raise ``InvalidInput`` for none."""
    match = re.fullmatch(r"\s*(\w+)\s*\((.*)\)\s*", text)
    kind, inside = (match[1], match[2].strip()) if match else (text, "")
    try:
        if match and kind in (*PLAIN, AVERAGING):
            return Quantity(kind, _observable(inside, system, pairs=kind == AVERAGING))
        if match and kind in AT_NUMBER:
            name, _, number = inside.partition(",")
            return Quantity(kind, _observable(name, system), _number(kind, number))
        if match and kind in PASSAGE:
            return Quantity(kind, limit=parse_limit(inside, system.n))
        if match and kind in CONTACT:
            count = len(system.contacts)
            if not (inside.isascii() and inside.isdigit() and 1 <= int(inside) <= count):
                given = f"use 1 to {count}" if count else "the scene has no [[contact]]"
                raise InvalidInput("contact", inside, f"is no contact of the scene; {given}")
            index = int(inside) - 1
            mass = (Coordinate("q", system.contacts[index].index),)
            return Quantity(kind, mass, contact=index)
    except InvalidInput as error:
        raise InvalidInput("quantity", text, f'"{error.value}" {error.remedy}') from None
    close = get_close_matches(kind, [form.partition("(")[0] for form in FORMS], n=1)
    hint = f"did you mean {close[0]}? " if close and close[0] != kind else ""
    raise InvalidInput("quantity", text, f"is no quantity; {hint}use one of {', '.join(FORMS)}")


def _observable(text: str, system: System, *, pairs: bool = False) -> Observable:
    observable = parse_observable(text, system.n)
    if len(observable) > 1 and not pairs:
        raise InvalidInput("observable", text, "is a pair; name one coordinate")
    return observable


def _number(kind: str, text: str) -> float:
    try:
        value: Any = float(text)
    except ValueError:
        value = text
    if not (isinstance(value, float) and isfinite(value)):
        raise InvalidInput("number", text.strip(), "must be a finite number, as exceedance(q1,1.2)")
    if kind == "quantile" and not 0.0 < value < 1.0:
        raise InvalidInput("number", value, "must be a probability between 0 and 1")
    return value
