"""Contact of a mass with a stop, Eqs. (2) and (5)."""

from dataclasses import dataclass, field, replace
from math import inf
from numbers import Integral, Real
from typing import Any, Literal, get_args

import numpy as np

import fpk.system.laws  # noqa: F401  (its modules register the laws)
from fpk.numeric.errors import require
from fpk.numeric.recognition import REGISTRY
from fpk.system.contact_law import LAWS

MAX_EXPONENT = 100.0
"""Largest exponent of a contact law: the force at an overlap of 1e3 (1e-3) units is then 1e300
(1e-300) times its value at one unit, near the limits of double precision."""

Side = Literal["left", "right", "both"]


@dataclass(frozen=True)
class Contact:
    """Stop beside one mass, Eq. (2): ``stiffness · law(overlap)``, ``overlap = ±q − clearance``
    with + for a stop on the right.

    ``mass`` counts from 1; ``side`` is the side of the mass on which the stop stands; ``stiffness``
    is B > 0 of Eq. (2), in force / length**exponent; ``clearance`` δ >= 0 is the distance from rest
    to the stop. The law "power" needs an ``exponent``, from 1 to ``MAX_EXPONENT``; a law with its
    own refuses any other.

    A Hertzian stop, and one whose force grows with the square of the overlap::

        stop = fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.5)
        stop.force(0.1), stop.energy(0.1), stop.slope(0.1), stop.one_sided()
        fpk.Contact(1, "left", 10.0, 0.5, law="power", exponent=2.0)

    Raises ``InvalidInput`` with the name of the field that cannot be used.
    ``System`` refuses a mass that it does not have.
    """

    mass: int
    side: Side
    stiffness: float
    clearance: float
    law: str = field(default="hertz", metadata={REGISTRY: LAWS})
    exponent: float | None = None

    def __post_init__(self) -> None:
        """Check every field, or raise ``InvalidInput``; fill in the law's own exponent."""
        for key, kind, words in (
            ("mass", Integral, "a whole number"),
            ("stiffness", Real, "a number"),
            ("clearance", Real, "a number"),
            ("exponent", Real | None, "a number"),
        ):
            value = getattr(self, key)
            require(isinstance(value, kind), key, value, f"must be {words}")
        for key, fits, words in (
            ("side", self.side in get_args(Side), 'is not a side; use "left", "right" or "both"'),
            ("stiffness", 0 < self.stiffness < inf, "must be a finite number > 0"),
            ("clearance", 0 <= self.clearance < inf, "must be a finite number >= 0"),
            ("law", self.law in LAWS, f"is not a contact law; use one of {sorted(LAWS)}"),
        ):
            require(fits, key, getattr(self, key), words)
        own, given = LAWS[self.law].exponent, self.exponent
        if own is None:
            remedy = f'must be >= 1 and at most {MAX_EXPONENT:g} for law "{self.law}"'
            fits = given is not None and 1 <= given <= MAX_EXPONENT
        else:
            remedy = f'leave it out: the law "{self.law}" has its own, {own}'
            fits = given in (None, own)
        require(fits, "exponent", given, remedy)
        object.__setattr__(self, "exponent", given if own is None else own)

    @property
    def index(self) -> int:
        """Number of the mass, counted from 0."""
        return self.mass - 1

    @property
    def sign(self) -> float:
        """Sign of a displacement towards a one-sided stop: +1 on the right, −1 on the left."""
        return 1.0 if self.side == "right" else -1.0

    def one_sided(self) -> tuple["Contact", ...]:
        """Return the contact as one-sided stops: itself, or left and right for "both"."""
        if self.side != "both":
            return (self,)
        return (replace(self, side="left"), replace(self, side="right"))

    @property
    def power(self) -> float:
        """The exponent of the law, never None."""
        assert self.exponent is not None
        return self.exponent

    def force(self, overlap: Any) -> Any:
        """Size >= 0 of the contact force at an ``overlap`` >= 0 of any shape, Eq. (2)."""
        return self.stiffness * LAWS[self.law].force(overlap, self.power)

    def energy(self, overlap: Any) -> Any:
        """Contact energy U at an ``overlap`` >= 0 of any shape, Eq. (5)."""
        return self.stiffness * LAWS[self.law].energy(overlap, self.power)

    def slope(self, overlap: Any) -> Any:
        """Tangent contact stiffness dg/dx at an ``overlap`` >= 0 of any shape."""
        return self.stiffness * LAWS[self.law].slope(overlap, self.power)

    def overlap_at(self, energy: float) -> float:
        """Return the overlap at a contact ``energy`` > 0, to round-off for power laws, else with a
        relative error of about 1e-5."""
        high = 1.0
        while self.energy(high) < energy:
            high *= 2.0
        while self.energy(0.5 * high) > energy:
            high *= 0.5
        # ln U is linear in ln x for a power law, and nearly so between x and 2 x for others.
        x = high * 2.0 ** np.linspace(-1.0, 0.0, 65)
        return float(np.exp(np.interp(np.log(energy), np.log(self.energy(x)), np.log(x))))
