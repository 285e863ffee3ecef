"""Contact laws: force, energy and slope as functions of the overlap; registry; Eqs. (2), (5)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fpk.numeric.arrays import SMALLEST
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

    Raises ``ValueError`` if its name is taken, and ``InvalidInput`` unless the energy is the
    integral of the force from 0, and the force of the slope, to 1 % for overlaps up to 4. Overlaps
    at which a part is not finite are left out. ::

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
    # Panels whose ends grow by 4, so that the scale of the law does not matter. A slope with a jump
    # by a factor of 9 costs trapezoids 0.2 %, an exponential up to its overflow 0.6 %.
    starts, ends = np.append(0.0, 4.0 ** np.arange(-7, 1)), 4.0 ** np.arange(-7, 2)
    x = np.linspace(starts, ends, 2049, axis=1)
    exponent = 1.5 if law.exponent is None else law.exponent
    with np.errstate(all="ignore"):
        energy, force, slope = (
            f(x, exponent) + 0.0 * x for f in (law.energy, law.force, law.slope)
        )
        finite = np.isfinite(energy + force + slope).all(axis=1)
    energy[0, 0] = force[0, 0] = 0.0  # the integrals are from 0
    x, energy, force, slope, ends = (part[finite] for part in (x, energy, force, slope, ends))
    for name, whole, of, part in (
        ("energy", energy, "force", force), ("force", force, "slope", slope),
    ):  # fmt: skip
        rise, integral = whole[:, -1] - whole[:, 0], np.trapezoid(part, x, axis=1)
        wrong = ~(np.abs(rise - integral) <= 0.01 * np.abs(integral) + SMALLEST)
        if wrong.any():
            remedy = f"{name} and {of} do not belong together at the overlap {ends[wrong][0]:.3g}"
            raise InvalidInput("law", law.name, f"{remedy}: {name} must be the integral of {of}")
    LAWS[law.name] = law
    return law
