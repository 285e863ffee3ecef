"""The oscillator of one mass: its forces, its orbits, and the weight of densities by energy."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import inf, log, pi, sqrt

import numpy as np
from numpy.polynomial import Polynomial
from scipy.optimize import brentq

from averaging.phase_space.equation.frame import contact_frame
from fpk.answer.names import Limit, Start
from fpk.numeric.arrays import EPS, SMALLEST, Array
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.system.ends import MAX_ENERGY
from fpk.system.modulation import require_constant_noise
from fpk.system.system import System

States = tuple[Array, Array, Array]
"""Displacements, velocities and weights of states, (states,) each."""
FALL = -log(EPS)
"""Largest range of Ψ on a mesh: over it a density falls to round-off."""
HIGHER, TRIALS = 1.5, 12
"""Ratio of successive limits of the energy that are tried for a density that should be nearly 0
there, and their largest number."""
DEEPEST = 100.0
"""Largest −ln of the density at rest over its maximum, on a limit cycle: with 100 a van der Pol
oscillator takes 5 s and 37,000 unknowns, with 333 the elimination does not end in a minute."""
WEIGHT_DEGREE, FITTED, SAMPLED, ORBIT_POINTS = 6, 24, 97, 24
"""Degree of the polynomial fitted to Ψ', energies it is fitted at, energies its extremes are sought
at, and points of an orbit between two stops. Any smooth weight gives the same density; the closer
it is to that of the averaged energy, the fewer elements are needed."""


@dataclass(frozen=True, eq=False)
class Oscillator:
    """dq = v dt, m dv = −(c v + V'(q)) dt + √(2D) dB: Eq. (6) of one mass, v = p/m.

    ``mass`` m, ``damping`` the constant part of c, ``noise`` D. ``potential`` V has its only
    minimum, 0, at q = 0; ``force`` is V'; ``even``: (−q, −v) obeys the same equation. ``stops`` are
    (q, side) at which V' is not smooth, side −1 or 1 if V' is a fractional power of the overlap on
    that side, else 0. ``frequency`` is the angular frequency of small oscillations between the
    stops, 0 without a linear force. ``terms`` are the damping terms, their sum a function of (q,
    v); None if there are none. Densities are expanded about the weight exp(−Ψ(H)), ``fall`` Ψ a
    polynomial; None: Ψ = c H/D, of the stationary density without damping terms.
    """

    mass: float
    damping: float
    noise: float
    potential: Callable[[Array], Array]
    force: Callable[[Array], Array]
    stops: tuple[tuple[float, float], ...] = ()
    even: bool = True
    frequency: float = 0.0
    terms: Callable[[Array, Array], Array] | None = None
    fall: Polynomial | None = None

    @property
    def psi(self) -> Polynomial:
        """Ψ(H) of the weight exp(−Ψ)."""
        return self.fall or Polynomial([0.0, self.damping / self.noise])

    def drag(self, q: Array, v: Array) -> Array:
        """Return c at displacements ``q`` and velocities ``v``, which broadcast."""
        constant = np.full(np.broadcast_shapes(q.shape, v.shape), self.damping)
        return constant if self.terms is None else constant + self.terms(q, v)

    @property
    def diffusion(self) -> float:
        """D/m², half of σ² of the velocity: dv = … + √(2 D/m²) dB."""
        return self.noise / self.mass**2

    def energy(self, q: Array, v: Array) -> Array:
        """Return the energy H of displacements ``q`` and velocities ``v``."""
        return np.asarray(0.5 * self.mass * v * v + self.potential(q))

    def ends_of(self, limit: Limit) -> list[tuple[float, float]]:
        """Return the finite ends of a ``limit`` of q or v, and the least energy at each."""
        states = [(x, 0.0) if limit.kind == "q" else (0.0, x) for x in limit.ends]
        H = self.energy(*np.transpose(states))
        return list(zip(limit.ends, H.tolist(), strict=True))

    def speed(self, q: Array, energy: float) -> Array:
        """Return |v| at ``q`` on the orbit of ``energy``, 0 beyond its turning points."""
        return np.sqrt(2.0 / self.mass * np.maximum(energy - self.potential(q), 0.0))

    def turning_point(self, energy: float, side: float) -> float:
        """Return q with V(q) = ``energy`` > 0 on the left (``side`` −1) or right (``side`` 1)."""

        def excess(q: float) -> float:
            return float(self.potential(np.array(q))) - energy

        far = side
        while excess(far) < 0.0:
            far *= 2.0
        return float(brentq(excess, 0.0, far, xtol=SMALLEST))

    def travel(self, length: float) -> float:
        """Return the time in which noise moves q by 2 ``length`` rms, at most half a period."""
        cycle = pi / self.frequency if self.frequency else inf
        return min(cycle, float((6.0 * length**2 / self.diffusion) ** (1.0 / 3.0)))

    def kick(self, length: float) -> float:
        """Return the rms change of v by noise in the time ``travel(length)``, or m/(2c) if less."""
        memory = 0.5 * self.mass / self.damping if self.damping > 0.0 else inf
        return sqrt(2.0 * self.diffusion * min(self.travel(length), memory))


def oscillator_of(system: System) -> Oscillator:
    """Return the one mass of ``system`` as an oscillator.

    Raises ``NotApplicable`` for more masses, and for noise that is absent or modulated.
    """
    require_constant_noise(system.modulation)
    if system.n != 1:
        words = "the full equation in time is solved for one mass"
        raise NotApplicable(f"{words}, and there are {system.n}")
    noise = float(system.noise_matrix[0, 0])
    if not noise > 0.0:
        raise NotApplicable("there is no noise, and first passage is not random")
    frame, k, mass = contact_frame(system), system.stiffness_matrix[0, 0], float(system.mass[0])
    stops = [(s, 0.0 if s.power == int(s.power) else s.sign) for s in system.stops]
    even = frame.symmetric and all(t.degree % 2 == 0 for t in system.damping_terms)

    def terms(q: Array, v: Array) -> Array:
        H = 0.5 * mass * v * v + 0.5 * k * q * q + system.contact_energy(0, q)
        q, v = np.broadcast_arrays(q, v)
        parts = [t.value(q[..., None], v[..., None], H) for t in system.damping_terms]
        return np.asarray(sum(parts))

    return Oscillator(
        mass,
        float(system.damping[0, 0]),
        noise,
        lambda q: np.asarray(0.5 * k * q * q + system.contact_energy(0, q)),
        lambda q: np.asarray(k * q + frame.root * frame.contact_force(frame.root * q)),
        tuple((s.sign * s.clearance, side) for s, side in stops),
        even,
        sqrt(k / mass),
        terms if system.damping_terms else None,
    )


def require_total(what: str, given: Start | Limit, system: System) -> None:
    """Raise ``NotApplicable`` if ``given`` is of a mode's energy and there are stops.

    ``what`` is "limit" or "start", for the message.
    """
    if given.kind == "modal" and system.contacts:
        words = "the energy of a mode is that of one mass without stops; ask for H"
        raise NotApplicable(f"{what} {given}: {words}")


def orbit(o: Oscillator, energy: float, within: Limit | None, points: int) -> States:
    """Return the states of an ``energy``, weighted by the time that the free motion spends in each.

    Only states ``within`` a limit of q or v are returned (None: all); their weights add up to the
    share of time there. Each piece between turning points, stops and limit has ``points`` Gauss
    points in θ, q = centre + radius sin θ, in which dt = dq/|v| is smooth.
    """
    left, right = (o.turning_point(energy, side) for side in (-1.0, 1.0))
    centre, radius = 0.5 * (left + right), 0.5 * (right - left)
    cuts = [*(q for q, _ in o.stops), 0.0]
    if within is not None:
        for end, height in o.ends_of(within):
            if within.kind == "q":
                cuts.append(end)
            elif height < energy:
                cuts += [o.turning_point(energy - height, side) for side in (-1.0, 1.0)]
    angles = np.arcsin([(q - centre) / radius for q in cuts if left < q < right])
    # No piece begins right next to a turning point, where E − V has too few digits.
    edges = np.unique(np.concatenate([[-0.5 * np.pi, 0.5 * np.pi], angles]))
    theta, w = (a.ravel() for a in panel_rule(edges, points))
    q = centre + radius * np.sin(theta)
    v = o.speed(q, energy)
    weights = w * radius * np.cos(theta) / v
    weights = 0.5 * weights / weights.sum()
    q, v, weights = np.tile(q, 2), np.concatenate([v, -v]), np.tile(weights, 2)
    if within is None:
        return q, v, weights
    inside = within.distance(q[:, None], v[:, None]) > 0.0
    return q[inside], v[inside], weights[inside]


def start_states(
    o: Oscillator, start: Start, system: System, within: Limit | None = None
) -> tuple[float, Callable[[int], States]]:
    """Return the energy of ``start``, and its states by the number of ``points``, see ``orbit``.

    A state, or rest, is one state of the weight 1, none if it is not ``within`` a limit of q or v.
    Raises ``NotApplicable`` for a stationary start, and as ``require_total``.
    """
    if start.kind == "noise" and not start.rest:
        raise NotApplicable("a stationary start is not solved for in phase space; use montecarlo")
    require_total("start", start, system)
    if start.kind in ("energy", "modal") and not start.rest:
        (energy,) = start.values.values()
        return energy, partial(orbit, o, energy, within)
    q, p = start.state(1)
    v = p / o.mass
    past = within is not None and within.distance(q, v) <= 0.0
    return float(o.energy(q, v)[0]), lambda points: (q, v, np.ones(0 if past else 1))


def averaged_fall(o: Oscillator, top: float) -> Polynomial:
    """Return Ψ(H) below the energy ``top``, smallest value 0, with exp(−Ψ) the averaged density.

    Ψ' = <c v²>/(D <v²>), means over the time of an orbit: exp(−Ψ(H)) is the stationary density of
    (q, v) by energy averaging, Eq. (11). Without damping terms it is exact, c/D; else Ψ' is a
    polynomial fitted to the means.
    """
    if o.terms is None:
        psi = o.psi
    else:
        energy = 0.5 * top * (1.0 - np.cos(np.pi * (np.arange(FITTED) + 0.5) / FITTED))
        rates = []
        for E in energy:
            q, v, w = orbit(o, float(E), None, ORBIT_POINTS)
            rates.append((w * v * v) @ o.drag(q, v) / ((w * v) @ v) / o.noise)
        psi = Polynomial.fit(energy, rates, WEIGHT_DEGREE, domain=[0.0, top]).integ()
    lowest = float(np.min(psi(np.linspace(0.0, top, SAMPLED))))
    return Polynomial(psi.coef - np.eye(1, psi.coef.size)[0] * lowest, psi.domain, psi.window)


def weighted(o: Oscillator, top: float) -> Oscillator:
    """Return ``o`` with a weight of energies below ``top`` by ``averaged_fall``.

    Where Ψ ranges over more than ``FALL``, it is scaled to that. Without damping terms, and with a
    weight, ``o`` itself is returned.
    """
    if o.terms is None or o.fall is not None:
        return o
    psi = averaged_fall(o, top)
    return replace(o, fall=psi * min(1.0, FALL / np.max(psi(np.linspace(0.0, top, SAMPLED)))))


def rarest_energy(o: Oscillator) -> float:
    """Return an energy at which the averaged density has fallen to round-off of its maximum.

    Raises ``NotCertified`` if it does not fall so far below ``MAX_ENERGY``.
    """
    top = o.noise / (abs(o.damping) + o.mass * o.frequency)
    while averaged_fall(o, top)(top) < FALL:
        top *= HIGHER
        if top > MAX_ENERGY:
            raise NotCertified("the averaged density does not fall with the energy")
    return top


def require_broad(o: Oscillator) -> None:
    """Raise ``NotApplicable`` if the averaged density at rest is below exp(−``DEEPEST``) of its
    maximum: a thin ring."""
    if o.terms is not None and (depth := averaged_fall(o, rarest_energy(o))(0.0)) > DEEPEST:
        words = f"the density is a thin ring about rest, where it is e^−{depth:.0f} of its maximum"
        raise NotApplicable(f"{words}: too little noise for elements; use montecarlo")
