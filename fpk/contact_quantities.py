"""Contact probability, overlap and force at a stop, from the density of its mass's displacement."""

from collections.abc import Mapping, Sequence

import numpy as np

from fpk.arrays import Array
from fpk.contact import Contact
from fpk.number import Number
from fpk.observable import Coordinate, Observable
from fpk.quantities import Quantities
from fpk.system import System

OVER_ALL_TIME = ("contact probability", "mean overlap", "mean force")
"""Expectations over all time: 0 while there is no contact."""


def contact_quantities(stop: Contact, displacement: Quantities) -> Mapping[str, Number]:
    """Return numbers of the contact at a one-sided ``stop``, by their names.

    ``displacement`` is the density of the displacement of the stop's mass.
    "contact probability": P(overlap > 0), the share of time in contact; "mean overlap" and "mean
    force": expectations over all time, 0 while there is no contact (force in force units, Eq. (2));
    "overlap in contact" and "force in contact": the same over the time in contact alone, whose
    errors count those of the probability in full. ::

        q2 = fpk.solve(system, ["q2"], methods=["nonintegrable/fem"])["q2"]
        contact_quantities(system.stops[0], q2)["mean force"]
    """

    touching, depth, force = (contact_quantity(name, stop, displacement) for name in OVER_ALL_TIME)
    return {
        **dict(zip(OVER_ALL_TIME, (touching, depth, force), strict=True)),
        "overlap in contact": ratio(depth, touching),
        "force in contact": ratio(force, touching),
    }


def contact_quantity(name: str, stop: Contact, displacement: Quantities) -> Number:
    """Return that of ``contact_quantities`` that ``name`` names, one of ``OVER_ALL_TIME``."""
    at = stop.sign * stop.clearance
    if name == "contact probability":
        return displacement.exceedance(at) if stop.sign > 0 else displacement.cdf(at)

    def overlap(q: Array) -> Array:
        return np.maximum(stop.sign * q - stop.clearance, 0.0)

    if name == "mean overlap":
        return displacement.expectation(overlap, kinks=(at,))
    return displacement.expectation(lambda q: stop.force(overlap(q)), kinks=(at,))


def joint_at_stops(system: System, observables: Sequence[Observable]) -> list[Observable]:
    """Return pairs (q, p) of masses at stops: the rates of touching these follow from them.

    They are those of the masses whose q is one of the ``observables``, less the pairs that are
    among the ``observables`` themselves.
    """
    touching = [Coordinate("q", i) for i in system.contact_masses]
    pairs = [(q, Coordinate("p", q.row)) for q in touching if (q,) in observables]
    return [pair for pair in pairs if pair not in observables]


def ratio(a: Number, b: Number) -> Number:
    """Return a/b and the most that it can be off by; b may be 0: NaN with an infinite error."""
    if not b.value > b.error:
        return Number(np.nan, np.inf)
    value = a.value / b.value
    return Number(value, (a.error + abs(value) * b.error) / (b.value - b.error))
