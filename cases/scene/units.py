"""Units of a scene: names of the units of length, mass and time, and what follows from them."""

import re
from dataclasses import dataclass
from typing import Any

from cases.scene.written import SUPERSCRIPTS
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.errors import InvalidInput

CONSISTENT = "the scene's own consistent units"
"""Attribute ``units`` in files of a scene without ``[units]``."""

DATES = ("days", "hours", "minutes", "seconds", "milliseconds", "microseconds", "nanoseconds")
"""Units of time that xarray decodes to time differences of whole nanoseconds."""

Powers = tuple[float, float, float]
"""Exponents (a, b, c) of a quantity whose unit is length^a mass^b time^c."""

NUMBER: Powers = (0, 0, 0)
"""Exponents of a quantity without a unit, such as a probability."""

DIMENSIONS: dict[str, Powers] = {"q": (1, 0, 0), "v": (1, 0, -1), "p": (1, 1, -1), "H": (2, 1, -2)}
"""Powers of length, mass and time of a displacement, a velocity, a momentum and an energy."""

DERIVED: dict[str, Powers] = {
    "displacement": (1, 0, 0),
    "velocity": (1, 0, -1),
    "momentum": (1, 1, -1),
    "force": (1, 1, -2),
    "energy": (2, 1, -2),
    "frequency": (0, 0, -1),
    "rate": (0, 0, -1),
    "stiffness": (0, 1, -2),
    "damping": (0, 1, -1),
    "noise_intensity": (2, 2, -3),
}
"""Powers of length, mass and time of the quantities whose units JSON lists; D is the intensity of a
force, E[WW'] = 2Dδ."""

NAMED: tuple[tuple[str, Powers], ...] = (
    ("probability|share|exceedance|cdf|correlation|skewness|kurtosis|averaging.error|L1", NUMBER),
    ("force", DERIVED["force"]),
    ("overlap", DERIVED["displacement"]),
    ("rate|per unit time|frequency", DERIVED["rate"]),
    ("time|passage|lag", (0, 0, 1)),
)
"""Regular expression in the name of a quantity, and its dimension; the first match counts. Without
a match, as for a mean, the quantity has the dimension of the observable."""


@dataclass(frozen=True)
class Units:
    """Names of the units of ``length``, ``mass`` and ``time``, as ``mm``, ``kg``, ``s``.

    A scene without ``[units]`` has empty names, and all derived units are empty, too. Numbers are
    never converted.
    """

    length: str = ""
    mass: str = ""
    time: str = ""

    def __post_init__(self) -> None:
        """Raise ``InvalidInput`` if two units have the same name that is not empty."""
        named = [name for name in (self.length, self.mass, self.time) if name]
        if len(set(named)) < len(named):
            key = "time" if self.time in named[:-1] else "mass"
            raise InvalidInput(key, getattr(self, key), "is the unit of something else already")

    def of(self, *dimensions: Powers, inverse: bool = False) -> str:
        """Return the unit of a product of quantities of these powers of length, mass and time.

        As ``kg mm² s⁻²``, which UDUNITS reads, or ``kg m^-0.5 s^-2`` if a power is no integer; "1"
        for a number, empty unless all three have names. ``inverse``: the unit of 1/product.
        """
        if not self:
            return ""
        sign = -1 if inverse else 1
        length, mass, time = (sign * sum(powers) for powers in zip(*dimensions, strict=True))
        named = (self.mass, mass), (self.length, length), (self.time, time)
        caret = any(power != int(power) for _, power in named)
        factors = []
        for name, power in sorted(named, key=lambda factor: factor[1] < 0):
            raised = f"^{power:g}" if caret else str(int(power)).translate(SUPERSCRIPTS)
            factors += [name if power == 1 else name + raised] if power else []
        return " ".join(factors) or "1"

    def __bool__(self) -> bool:
        """Whether length, mass and time all have names."""
        return bool(self.length and self.mass and self.time)

    def coordinate(self, coordinate: Coordinate) -> str:
        """Return the unit of a displacement, momentum or energy."""
        return self.of(DIMENSIONS[coordinate.kind])

    def density(self, observable: Observable) -> str:
        """Return the unit of the density of one coordinate or two: 1/unit of each."""
        return self.of(*(DIMENSIONS[c.kind] for c in observable), inverse=True)

    def quantity(self, name: str) -> str:
        """Return the unit of a quantity of ``DERIVED``."""
        return self.of(DERIVED[name])

    def number(self, name: str, observable: str = "") -> str:
        """Return the unit of a quantity by its name, such as ``rms`` or ``mean force, left stop``.

        ``observable``, as ``q2``, is the coordinate or pair of which the quantity is; it is needed
        if no words of ``NAMED`` are in ``name``: the unit is then its unit, squared for a
        ``variance``, the product of both units for the ``covariance`` of a pair.
        """
        own = [DIMENSIONS[c[0]] for c in observable.split(",") if c[:1] in DIMENSIONS]
        named = next(([powers] for words, powers in NAMED if re.search(words, name)), own)
        return self.of(*named * (2 if re.search(r"\bvariance", name) else 1))

    def record(self) -> dict[str, Any] | None:
        """Return the three names and the units of ``DERIVED`` by key; None unless all are named."""
        return {**vars(self), **{name: self.quantity(name) for name in DERIVED}} if self else None


NO_UNITS = Units()


def attribute(unit: str) -> str:
    """Return the attribute ``units`` of a variable in a file: the unit, or ``CONSISTENT``.

    Names of ``DATES`` lose their s: xarray would turn such numbers into dates.
    """
    return unit.removesuffix("s") if unit in DATES else unit or CONSISTENT


def in_brackets(unit: str) -> str:
    """Return ``unit`` to stand behind a name, as ``" [mm]"``; nothing if it is empty or "1"."""
    return f" [{unit}]" if unit not in ("", "1") else ""
