"""Clearances in units of the rms motion; probability, overlap and force of a contact."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fpk.answer.quantities import Number, Quantities
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import stationary_covariance
from fpk.system.system import System

CLEARANCE_RULE = 2.0
"""Clearance over rms displacement above which a contact may be neglected, section 6.3."""


@dataclass(frozen=True)
class StopClearance:
    """Clearance of a stop compared with the motion of its mass, counted from 1, without contacts.

    ``rms`` is the displacement in the system without contacts, ``ratio`` is ``clearance``/``rms``.
    Both are None if this motion is not linear or not stationary; ``ratio`` also if ``rms`` is 0.
    """

    mass: int
    side: str
    clearance: float
    rms: float | None
    ratio: float | None

    @property
    def beyond_rule(self) -> bool | None:
        """Whether section 6.3 allows neglecting this contact; None without a ``ratio``."""
        return None if self.ratio is None else self.ratio > CLEARANCE_RULE


def stop_clearances(system: System) -> tuple[StopClearance, ...]:
    """Return the clearances of all one-sided stops, in the order of ``System.stops``."""
    try:
        rms = np.sqrt(np.diag(stationary_covariance(system))).tolist()
    except NotApplicable:
        rms = [None] * system.n
    return tuple(
        StopClearance(s.mass, s.side, s.clearance, scale, s.clearance / scale if scale else None)
        for s in system.stops
        for scale in [rms[s.index]]
    )


def contact_quantities(stop: Contact, displacement: Quantities) -> Mapping[str, Number]:
    """Return quantities of the contact at a one-sided ``stop``, by their names.

    ``displacement`` is the density of the displacement of the stop's mass. "contact probability":
    P(overlap > 0), the share of time in contact; "mean overlap" and "mean force": expectations over
    all time, 0 without contact (force as in Eq. (2)); "overlap in contact" and "force in contact":
    expectations over the time in contact, NaN ± ∞ unless the probability exceeds its error. ::

        q2 = fpk.solve(system, ["q2"], methods=["nonintegrable/fem"])["q2"]
        contact_quantities(system.stops[0], q2)["mean force"]
    """
    names = "contact probability", "mean overlap", "mean force"
    given = {name: contact_quantity(name, stop, displacement) for name in names}
    touching, depth, force = given.values()
    return given | {
        "overlap in contact": ratio(depth, touching),
        "force in contact": ratio(force, touching),
    }


def contact_quantity(name: str, stop: Contact, displacement: Quantities) -> Number:
    """Return the "contact probability", "mean overlap" or "mean force", as ``name`` says, at a left
    or right ``stop``, from the density of the ``displacement`` of its mass."""
    at = stop.sign * stop.clearance
    if name == "contact probability":
        return displacement.exceedance(at) if stop.sign > 0 else displacement.cdf(at)

    def value(q: Array) -> Array:
        overlap = np.maximum(stop.sign * q - stop.clearance, 0.0)
        return overlap if name == "mean overlap" else np.asarray(stop.force(overlap))

    return displacement.expectation(value, kinks=(at,))


def ratio(a: Number, b: Number) -> Number:
    """Return ``a``/``b`` with a bound of its error; NaN ± ∞ if ``b`` is not > its error."""
    if not b.value > b.error:
        return Number(np.nan, np.inf)
    value = a.value / b.value
    return Number(value, (a.error + abs(value) * b.error) / (b.value - b.error))
