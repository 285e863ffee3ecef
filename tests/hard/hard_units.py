"""The same system in other units, and seen in a mirror: what no number may depend on."""

from dataclasses import replace

from fpk.system.damping import DampingTerm
from fpk.system.system import System


def in_units(system: System, *, mass: float, length: float, time: float) -> System:
    """Return ``system`` with its numbers in units of 1/``mass``, 1/``length`` and 1/``time``.

    A mass of 1 becomes ``mass``, a displacement of 1 ``length``, a time of 1 ``time``; an energy
    of 1 then ``mass`` · ``length``²/``time``², and the intensity D of a noise, force² · time,
    ``mass``² ``length``²/``time``³. A contact of the power e has B in force/length^e, a damping
    term its coefficient in mass/time over the units of its powers.
    """
    velocity, energy = length / time, mass * (length / time) ** 2

    def scaled(term: DampingTerm) -> DampingTerm:
        of_q, of_v = (sum(power for _, power in powers) for powers in (term.q, term.v))
        unit = length**of_q * velocity**of_v * energy**term.energy
        return replace(term, coefficient=term.coefficient * mass / time / unit)

    return System(
        mass * system.mass,
        mass / time**2 * system.stiffness,
        mass / time * system.damping,
        mass**2 * length**2 / time**3 * system.noise_intensity,
        system.noise_gain,
        contacts=tuple(
            replace(
                c,
                stiffness=c.stiffness * mass * length / time**2 / length**c.power,
                clearance=c.clearance * length,
            )
            for c in system.contacts
        ),
        damping_terms=tuple(scaled(term) for term in system.damping_terms),
    )


def mirrored(system: System) -> System:
    """Return the system that moves as ``system`` does with the signs of all q and p reversed."""
    other = {"left": "right", "right": "left", "both": "both"}
    return replace(
        system,
        contacts=tuple(replace(c, side=other[c.side]) for c in system.contacts),  # type: ignore[arg-type]
        damping_terms=tuple(
            replace(t, coefficient=t.coefficient * (-1.0) ** t.degree) for t in system.damping_terms
        ),
    )
