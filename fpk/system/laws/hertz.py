"""Hertz contact of elastic bodies: force ~ overlap**1.5, Eq. (2)."""

import numpy as np

from fpk.system.contact_law import ContactLaw, register_law

register_law(
    ContactLaw(
        name="hertz",
        exponent=1.5,
        force=lambda x, e: x * np.sqrt(x),
        energy=lambda x, e: 0.4 * x * x * np.sqrt(x),
        slope=lambda x, e: 1.5 * np.sqrt(x),
    )
)
