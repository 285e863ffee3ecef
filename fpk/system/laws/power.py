"""General power law: force ~ overlap**e with the exponent e >= 1 given by the contact."""

from fpk.system.contact_law import ContactLaw, register_law

register_law(
    ContactLaw(
        name="power",
        exponent=None,
        force=lambda x, e: x**e,
        energy=lambda x, e: x ** (e + 1.0) / (e + 1.0),
        slope=lambda x, e: e * x ** (e - 1.0),
    )
)
