"""Contact laws: force, energy and slope as functions of the overlap; registry; Eqs. (2), (5)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fpk.numeric.errors import InvalidInput

ScalarLaw = Callable[[Any, float], Any]
"""Function of the overlap (>= 0) and the exponent, made of NumPy operations only: the averaging
integrals call it with arrays, the compiled stepper with scalars."""


@dataclass(frozen=True)
class ContactLaw:
    """Force, contact energy and slope of one law at unit contact stiffness, as in Eqs. (2), (5).

    ``force(x, e)``, ``energy(x, e)`` (its integral from 0) and ``slope(x, e)`` (its derivative)
    take the overlap ``x >= 0`` and the exponent ``e``. ``exponent`` is a fixed exponent of the law,
    or None if each contact has its own. All three are non-negative, the force increases with the
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
    """Add ``law`` to the registry and return it.

    Raises ``ValueError`` if its name is taken, and ``InvalidInput`` unless, for overlaps up to 4,
    the energy is the integral of the force and the force the integral of the slope, to 1 %. ::

        register_law(
            ContactLaw(
                "square", exponent=2.0, force=lambda x, e: x * x,
                energy=lambda x, e: x**3 / 3.0, slope=lambda x, e: 2.0 * x,
            )
        )
        fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.5, law="square")
    """
    if law.name in LAWS:
        raise ValueError(f"contact law {law.name!r} is registered already")
    x = np.linspace(0.0, 4.0, 4001)  # trapezoids are right to 1e-3 beyond a kink, too
    exponent = 1.5 if law.exponent is None else law.exponent
    energy, force, slope = (f(x, exponent) + 0.0 * x for f in (law.energy, law.force, law.slope))
    for whole, part, words in ((energy, force, "energy"), (force, slope, "force")):
        integral = np.append(0.0, np.cumsum(0.5 * np.diff(x) * (part[1:] + part[:-1])))
        if not np.all(np.abs(whole - integral) <= 0.01 * integral + 1e-3 * integral[100]):
            remedy = f"is no integral of the {'force' if words == 'energy' else 'slope'} from 0"
            raise InvalidInput(f"{words} of the law {law.name!r}", whole[-1], f"at 4 {remedy}")
    LAWS[law.name] = law
    return law
