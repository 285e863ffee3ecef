"""Linear spring behind the clearance: force ~ overlap (the "bilinear spring" of section 7)."""

from fpk.system.contact_law import ContactLaw, register_law

register_law(
    ContactLaw(
        name="bilinear",
        exponent=1.0,
        force=lambda x, e: x,
        energy=lambda x, e: 0.5 * x * x,
        slope=lambda x, e: 0.0 * x + 1.0,
    )
)
