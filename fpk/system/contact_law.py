"""Contact laws: force, energy and slope against overlap, and their registry, Eqs. (2), (5)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

ScalarLaw = Callable[[Any, float], Any]
"""Function of the overlap (>= 0) and the exponent, of NumPy operations only: it serves arrays in
the averaging integrals and is compiled for scalars in the stepper."""


@dataclass(frozen=True)
class ContactLaw:
    """Force, contact energy and slope of one law at unit contact stiffness, as in Eqs. (2), (5).

    ``force(x, e)``, ``energy(x, e)`` (its integral from 0) and ``slope(x, e)`` (its derivative)
    take the overlap ``x >= 0`` and the exponent ``e``. ``exponent`` is the law's own one, or None
    where the contact has to state it. All are non-negative, the force increases with the
    overlap, the slope stays finite at first touch, and all are smooth beyond it: a force with a
    kink at a positive overlap is written as two contacts of one mass and side. ::

        cubic = ContactLaw(
            "cubic", exponent=3.0, force=lambda x, e: x**3,
            energy=lambda x, e: 0.25 * x**4, slope=lambda x, e: 3.0 * x**2,
        )
    """

    name: str
    exponent: float | None
    force: ScalarLaw
    energy: ScalarLaw
    slope: ScalarLaw


LAWS: dict[str, ContactLaw] = {}


def register_law(law: ContactLaw) -> ContactLaw:
    """Add a law to the registry and return it; raises ``ValueError`` for a name that is taken.

    An example::

        register(
            ContactLaw(
                "square", exponent=2.0, force=lambda x, e: x * x,
                energy=lambda x, e: x**3 / 3.0, slope=lambda x, e: 2.0 * x,
            )
        )
        fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.5, law="square")
    """
    if law.name in LAWS:
        raise ValueError(f"contact law {law.name!r} is registered already")
    LAWS[law.name] = law
    return law
