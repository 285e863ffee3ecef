"""Conditional laws of displacements of a chain given other displacements, and integrals over them.

Given some masses, a mass depends on the nearest of these on either side alone, through the springs
in between in series. So no two terms of its potential ½ a (q − μ)² + U(q) cancel, however different
the springs are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, exp, log2

import numpy as np

from fpk.numeric.arrays import DEPTH, EPS, ROUND_OFF, Array
from fpk.numeric.piecewise import Piecewise, fit
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.contact import Contact
from fpk.system.system import System

WIDTHS_PER_PANEL = 1.8
"""Longest panel over √(T/a), T the temperature, a the ``Conditional.precision``: ten Gauss points
give ∫exp(−½x²) dx to 1e-15."""
CONTACT_LEVELS = (1e-5, 1e-3, 0.1, 1.0)
"""Contact energies in units of T at which panels beyond a stop end; each further energy is twice
the last: over [x, 2x] ten Gauss points integrate exp(−x) to 2e-12, the worst case being x = 16."""
HIDDEN_RULES = ((1, 1), (10, 14), (8, 10), (14, 18))
"""Gauss points per panel of the comparison rule and of the answer, by the number of hidden contact
masses: 0, 1, 2, more. The difference of the two integrals is the stated error; more masses need
more points, as the errors of the passes along a chain add up."""
CACHED_POINTS = 50_000
"""Points of the innermost integral evaluated at once, so that their arrays stay in the cache."""
MOST_POINTS = 4000
"""Largest number of quadrature points along one displacement, as many as two masses need that are
tied by 1e5 times the other stiffness; a pass along a chain then takes seconds."""


@dataclass(frozen=True, eq=False)
class Conditional:
    """Potential of q_mass (0-based) given other displacements q_k: ½ a (q − Σ w_k q_k)² + U(q).

    ``precision`` a is the stiffness of the springs to the nearest of the given masses, ``weights``
    w (given masses,) the effect of each on the mean, 0 unless it is the nearest on its side.
    """

    system: System
    mass: int
    precision: float
    weights: Array

    @property
    def stops(self) -> tuple[Contact, ...]:
        """The one-sided stops of the mass."""
        return tuple(stop for stop in self.system.stops if stop.index == self.mass)

    def energy(self, q: Array, mean: Array) -> Array:
        """Return ½ a (``q`` − ``mean``)² + U(``q``)."""
        return 0.5 * self.precision * (q - mean) ** 2 + self.system.contact_energy(self.mass, q)


def conditional(system: System, mass: int, given: Sequence[int]) -> Conditional:
    """Return the law of q of ``mass`` given the displacements of the masses ``given`` (0-based).

    The masses in between have no contacts here: their springs act in series.
    """
    flexibility = np.append(1.0 / system.stiffness, np.inf)  # no spring beyond the last mass
    below = max((k for k in given if k < mass), default=-1)
    above = min((k for k in given if k > mass), default=system.n)
    left = 1.0 / float(flexibility[below + 1 : mass + 1].sum())
    right = 1.0 / float(flexibility[mass + 1 : above + 1].sum())
    shares = {below: left / (left + right), above: right / (left + right)}
    weights = np.array([shares.get(k, 0.0) for k in given])
    return Conditional(system, mass, left + right, weights)


def conditionals(system: System, masses: Sequence[int]) -> tuple[Conditional, ...]:
    """Return the law of each of ``masses`` (0-based) given the masses before it in the sequence.

    Π a_k is the determinant of the stiffness matrix K_red reduced to ``masses``.
    """
    return tuple(conditional(system, mass, masses[:k]) for k, mass in enumerate(masses))


def hidden_integral(
    f: Callable[[Array], Array],
    energy: Array,
    given: Array,
    laws: Sequence[Conditional],
    *,
    temperature: float,
    end: float,
    points: int,
    beyond: Piecewise | None = None,
    cuts: Array | None = None,
) -> Array:
    """Return ∫ f(E + V(hidden | observed)) over up to two hidden displacements, (N, ...).

    E = ``energy`` (N,) and the displacements ``given`` (observed, N) are of the observed masses;
    each of ``laws`` is the law of a hidden mass given these and the hidden masses before it. f
    falls by a factor e over ``temperature`` and is 0 beyond ``end``. Each panel has ``points``
    Gauss points. ``beyond``, a function of the last hidden displacement, multiplies f; None: 1.
    Panels of one hidden displacement end also where E + V is one of the energies ``cuts``.
    Without ``laws`` the result is f(E), and ``beyond`` has no effect. f maps energies (points,) to
    values (points, ...).
    """
    if not laws:
        return f(energy)
    # Opposite momenta have the same energy: each distinct column is integrated once.
    distinct, index = np.unique(np.vstack([energy, given]), axis=1, return_inverse=True)
    count = ceil(np.sqrt(2.0 * max(end / temperature, DEPTH)) / WIDTHS_PER_PANEL)
    shares, (t, w) = np.linspace(-1.0, 1.0, 2 * count + 1), gauss_legendre(points)
    levels = contact_levels(temperature, end)
    stops = [[beyond_stop(stop, levels)[None] for stop in law.stops] for law in laws]
    # Estimate of the size: about 30 panels of each hidden mass have a positive length.
    panels = 30 + (0 if cuts is None else 2 * cuts.size)
    chunks = distinct.shape[1] * (panels * points) ** len(laws) // CACHED_POINTS + 1
    parts = []
    for E, *Q in np.array_split(distinct, min(chunks, distinct.shape[1]), axis=1):
        size = E.size
        row, weight, q = np.arange(size), np.ones(size), np.reshape(Q, (-1, size))
        for k, law in enumerate(laws):
            mean, height = law.weights @ q, np.maximum(end - E, DEPTH * temperature)
            layers = [first_touch(law, other, q, height, temperature) for other in laws[k + 1 :]]
            layers += [] if beyond is None else [beyond.nodes[None]]
            layers += [] if cuts is None else [_displacements_at(law, E, mean, cuts)]
            # Uniform panels cover the deviations from the mean that the springs alone allow.
            reach = np.sqrt(2.0 * height / law.precision)[:, None]
            uniform = mean[:, None] + reach * shares
            ends = [np.clip(x, uniform[:, :1], uniform[:, -1:]) for x in layers + stops[k]]
            nodes = np.sort(np.hstack([uniform, *ends]), axis=1)
            half = 0.5 * np.diff(nodes, axis=1)
            at, panel = np.nonzero(half > 0.0)
            half = half[at, panel, None]
            new = (nodes[at, panel, None] + half * (1.0 + t)).ravel()
            at = np.repeat(at, points)
            E, q = E[at] + law.energy(new, mean[at]), np.vstack([q[:, at], new])
            row, weight = row[at], weight[at] * (half * w).ravel()
        weight = weight if beyond is None else weight * beyond(q[-1])
        values = np.einsum("m,m...->m...", weight, f(E))
        parts.append(np.add.reduceat(values, np.searchsorted(row, np.arange(size))))
    return np.asarray(np.concatenate(parts)[index.ravel()])


def _displacements_at(law: Conditional, energy: Array, mean: Array, totals: Array) -> Array:
    """Return q (N, 2 totals), left and right of the minimum of V, where E + V is one of ``totals``.

    E is ``energy`` (N,), V(q) the potential of ``law`` about ``mean`` (N,). Where E is above one of
    ``totals``, the q are at the minimum.
    """
    halvings = ceil(-log2(EPS))
    reach = np.sqrt(2.0 * np.maximum(totals[-1] - energy, 0.0) / law.precision)
    low, high = mean - reach, mean + reach
    for _ in range(2 * halvings):
        third = (high - low) / 3.0
        falls = law.energy(low + third, mean) > law.energy(high - third, mean)
        low, high = np.where(falls, low + third, low), np.where(falls, high, high - third)
    outside = np.stack([mean - reach, mean + reach])[..., None] + np.zeros(totals.size)
    inside = 0.5 * (low + high)[:, None] + np.zeros(outside.shape)
    for _ in range(halvings):
        middle = 0.5 * (inside + outside)
        below = energy[:, None] + law.energy(middle, mean[:, None]) < totals
        inside, outside = np.where(below, middle, inside), np.where(below, outside, middle)
    return np.hstack(list(outside))


def gibbs_integral(
    system: System, observed: Sequence[int], at: Array, *, temperature: float, points: int
) -> tuple[Array, float]:
    """Return ∫exp(−V(hidden | observed)/T) Π √(a_k/2πT) (N,) over the contact masses not observed.

    a_k are the ``Conditional.precision`` of the hidden masses: without contact the integral is 1.
    The second result bounds the absolute error by interpolation, without the error of the Gauss
    rule of ``points`` on each panel. ``at`` (observed, N) are the displacements of the masses
    ``observed`` (0-based), T is ``temperature``. Up to two hidden masses between observed masses
    are integrated at once; masses outside one after another, from the farthest inwards.
    """

    def over(laws: Sequence[Conditional], given: Array, beyond: Piecewise | None = None) -> Array:
        value = hidden_integral(
            lambda V: np.exp(-V / temperature),
            np.zeros(given.shape[1]),
            given,
            laws,
            temperature=temperature,
            end=DEPTH * temperature,
            points=points,
            beyond=beyond,
        )
        widths = [np.sqrt(2.0 * np.pi * temperature / law.precision) for law in laws]
        return np.asarray(value / np.prod(widths))

    hidden = [i for i in system.contact_masses if i not in observed]
    low, high = min(observed, default=-1), max(observed, default=-1)
    between = [i for i in hidden if low < i < high]
    value = over(conditionals(system, [*observed, *between])[len(observed) :], at)
    total = len(hidden) * exp(-DEPTH)  # bounds the integral outside the grids
    for first, others in (
        (low, [i for i in reversed(hidden) if i < low]),
        (high, [i for i in hidden if i > high]),
    ):
        neighbours = [[first] if observed else [], *([i] for i in others)]
        laws = [conditional(system, *pair) for pair in zip(others, neighbours, strict=False)]
        x = at[observed.index(first)] if observed else np.zeros(at.shape[1])
        x, index = np.unique(x, return_inverse=True)
        reach = np.cumsum([np.sqrt(2.0 * DEPTH * temperature / law.precision) for law in laws])
        beyond, error, scale = None, 0.0, 1.0  # ``error`` is in units of ``scale``
        for law, most in reversed(list(zip(laws[1:], np.max(np.abs(x)) + reach, strict=False))):
            # In units of the value at rest, since the product along many masses becomes very small.
            top = float(over([law], np.zeros((1, 1)), beyond)[0])
            # Largest factor by which the next integral multiplies the error of ``beyond``: it
            # occurs with the mean between two stops, or far away from a single stop.
            free = [stop.sign * min(stop.clearance, most) for stop in law.stops]
            means = [np.linspace(-most, most, 33), np.linspace(min(free), max(free), 9)]
            weight = float(over([law], np.concatenate(means)[None]).max())

            def in_units(
                x: Array, law: Conditional = law, rest: Piecewise | None = beyond, top: float = top
            ) -> Array:
                return np.asarray(over([law], x[None], rest) / top)

            beyond = fit(in_units, np.linspace(-most, most, 9), 0.1 * ROUND_OFF)
            assert beyond.error is not None
            error, scale = error * weight / top + float(beyond.error.max()), scale * top
        given = x[None] if observed else np.zeros((0, x.size))
        value = value * (scale * over(laws[:1], given, beyond))[index]
        total += scale * error
    return value, total


def first_touch(
    law: Conditional, other: Conditional, given: Array, height: Array, temperature: float
) -> Array:
    """Return panel ends (N, ends) about the q at which ``other`` has its mean at one of its stops.

    ``law`` is of q, ``other`` of the next hidden mass; ``given`` (masses, N) are the displacements
    before q, ``height`` (N,) the largest energy of q, ``temperature`` the scale of energy. There
    are no ends, (N, 0), if ``other`` has no stops or does not depend on q.
    """
    share = other.weights[-1]
    if share == 0.0 or not other.stops:
        return np.empty((given.shape[1], 0))  # an observed mass lies between the two
    width = float(np.sqrt(temperature / other.precision))
    reach = share * float(np.sqrt(2.0 * height.max() / law.precision))
    steps = width * 2.0 ** (np.arange(max(ceil(log2(reach / width)), 0) + 2) - 1.0)
    touch = [stop.sign * stop.clearance for stop in other.stops]
    means = np.add.outer(touch, [*-steps, 0.0, *steps]).ravel()
    return np.asarray((means - (other.weights[:-1] @ given)[:, None]) / share)


def stop_panels(
    system: System, mass: int, *, width: float, end: float, levels: Sequence[float]
) -> Array:
    """Return panel nodes of the displacement of ``mass`` (0-based), at most ``width`` apart.

    The first and the last node are where the springs alone, the other masses at the minimum of
    their energy, or one stop alone has the energy ``end``, whichever is nearer to 0. Panels also
    end at the stops of the mass and where a stop has the contact energies ``levels``.
    """
    most = float(np.sqrt(2.0 * system.compliance[mass, mass] * end))
    stops = [stop for stop in system.stops if stop.index == mass]
    low, high = (
        min([most, *(s.clearance + s.overlap_at(end) for s in stops if s.side == side)])
        for side in ("left", "right")
    )
    uniform = np.linspace(-low, high, max(4, ceil((high + low) / width)) + 1)
    ends = [uniform, *(beyond_stop(stop, levels) for stop in stops)]
    return np.unique(np.clip(np.concatenate(ends), -low, high))


def contact_levels(temperature: float, end: float) -> list[float]:
    """Return contact energies (levels,) at which panels end, ascending.

    ``CONTACT_LEVELS`` times ``temperature``, then each twice its predecessor; the last is at least
    ``end`` and at least ``DEPTH`` times ``temperature``.
    """
    doubled = 2.0 ** np.arange(1.0, ceil(log2(max(end / temperature, DEPTH))) + 1.0)
    return [temperature * level for level in (*CONTACT_LEVELS, *doubled)]


def beyond_stop(stop: Contact, levels: Sequence[float]) -> Array:
    """Return the signed displacements (1 + levels,) with the contact energies 0 and ``levels``."""
    return stop.sign * (stop.clearance + np.array([0.0, *map(stop.overlap_at, levels)]))
