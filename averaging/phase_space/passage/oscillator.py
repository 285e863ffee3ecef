"""One mass as first passage needs it: constants, potential and the scales of its motion."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, pi, sqrt

import numpy as np
from scipy.optimize import brentq

from fpk.arrays import EPS, Array
from fpk.errors import NotApplicable
from fpk.modulation import require_constant_noise
from fpk.system import System


@dataclass(frozen=True, eq=False)
class Oscillator:
    """dq = v dt, m dv = −(c v + V'(q)) dt + √(2D) dB: Eq. (6) of one mass, v = p/m.

    ``potential`` V has its only minimum, 0, at q = 0; ``force`` is V'. ``stops`` are where V' is
    not smooth, as (q, side on which it is a fractional power; 0: on neither). ``even``: V(−q) =
    V(q). ``frequency`` is that of small motion between the stops.
    """

    mass: float
    damping: float
    noise: float
    potential: Callable[[Array], Array]
    force: Callable[[Array], Array]
    stops: tuple[tuple[float, float], ...] = ()
    even: bool = True
    frequency: float = 0.0

    @property
    def inverse_temperature(self) -> float:
        """c/D: the stationary density is exp(−c H/D)."""
        return self.damping / self.noise

    @property
    def diffusion(self) -> float:
        """D/m², the diffusion of the velocity."""
        return self.noise / self.mass**2

    def energy(self, q: Array, v: Array) -> Array:
        """Return H."""
        return np.asarray(0.5 * self.mass * v * v + self.potential(q))

    def turning_points(self, energy: float) -> tuple[float, float]:
        """Return where V = ``energy`` > 0, on the left and on the right."""
        return self.turning_point(energy, -1.0), self.turning_point(energy, 1.0)

    def turning_point(self, energy: float, side: float) -> float:
        """Return where V = ``energy`` > 0, on the left (``side`` −1) or on the right (1)."""

        def excess(q: float) -> float:
            return float(self.potential(np.array(q))) - energy

        far = side
        while excess(far) < 0.0:
            far *= 2.0
        return float(brentq(excess, 0.0, far, xtol=1e-300, rtol=4 * EPS))

    def travel(self, length: float) -> float:
        """Return the time that motion takes over ``length``.

        It is half a period, or the time in which noise alone gets so far, whichever is less.
        """
        cycle = pi / self.frequency if self.frequency else inf
        return min(cycle, float((6.0 * length**2 / self.diffusion) ** (1.0 / 3.0)))

    def kick(self, length: float) -> float:
        """Return the change of v by noise in that time, or in that in which v is forgotten."""
        memory = 0.5 * self.mass / self.damping if self.damping else inf
        return sqrt(2.0 * self.diffusion * min(self.travel(length), memory))


def oscillator_of(system: System) -> Oscillator:
    """Return the one mass of ``system``; raise ``NotApplicable`` where it is not for the method."""
    require_constant_noise(system.modulation)
    if system.n != 1:
        raise NotApplicable(
            f"first passage in phase space is solved for one mass, and there are {system.n}"
        )
    if system.damping_terms:
        raise NotApplicable("first passage in phase space is solved for constant damping only")
    noise = float(system.noise_matrix[0, 0])
    if not noise > 0.0:
        raise NotApplicable("there is no noise, and first passage is not random")
    stiffness = float(system.stiffness_matrix[0, 0])

    def potential(q: Array) -> Array:
        return np.asarray(0.5 * stiffness * q * q + system.contact_energy(0, q))

    def force(q: Array) -> Array:
        total = stiffness * q
        for stop in system.stops:
            overlap = np.maximum(stop.sign * q - stop.clearance, 0.0)
            total = total + stop.sign * stop.force(overlap)
        return np.asarray(total)

    stops = tuple(
        (s.sign * s.clearance, 0.0 if s.power == int(s.power) else s.sign) for s in system.stops
    )
    sides = [
        sorted((s.clearance, s.stiffness, s.law, s.power) for s in system.stops if s.sign == side)
        for side in (-1.0, 1.0)
    ]
    mass = float(system.mass[0])
    return Oscillator(
        mass,
        float(system.damping[0, 0]),
        noise,
        potential,
        force,
        stops,
        sides[0] == sides[1],
        sqrt(stiffness / mass),
    )
