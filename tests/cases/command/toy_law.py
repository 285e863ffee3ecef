"""A contact law of one's own: force ~ overlap**3."""

from fpk.system.contact_law import ContactLaw, register_law

CUBIC = register_law(
    ContactLaw(
        name="cubic",
        exponent=3.0,
        force=lambda x, e: x * x * x,
        energy=lambda x, e: 0.25 * x * x * x * x,
        slope=lambda x, e: 3.0 * x * x,
    )
)
