"""Laws of displacements of a chain given those of some other masses, and integrals over them.

A mass depends on its nearest neighbours among these alone, through the springs in between in
series: nothing in its law ½ a (q − μ)² + U(q) cancels at any ratio of the springs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, exp, log2

import numpy as np

from fpk.numeric.arrays import DEPTH, Array
from fpk.numeric.piecewise import Piecewise, fit
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.contact import Contact
from fpk.system.system import System

WIDTHS_PER_PANEL = 1.8
"""Longest panel, in √(T/a), T the temperature: ten Gauss points meet ∫exp(−½x²) to 1e-15."""
LEVELS = (1e-5, 1e-3, 0.1, 1.0)
"""Contact energies in units of T between which panels lie beyond a stop, then twice the one before:
over [x, 2x] a Gauss rule of ten points misses at most 2e-12 of exp(−x), at x = 16."""
FIT_TOLERANCE = 1e-13
"""Largest error of the integral over all masses beyond one, 0 to 1; round-off is a tenth of it."""
RULES = ((1, 1), (10, 14), (8, 10), (14, 18))
"""Gauss points per panel over 0, 1, 2 or more hidden contact masses, and of the finer rule of the
answer: the distance is its error. The errors of passes along a chain add up."""
CHUNK = 50_000
"""Points of the innermost integral evaluated at once: their arrays stay in the cache."""


@dataclass(frozen=True, eq=False)
class Conditional:
    """Law of q_mass (from 0) given others: ½ a (q − Σ w_k q_k)² + U(q), a = ``precision``.

    a is the stiffness of the springs to the neighbours among the others; ``weights`` w (others,).
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
        """½ a (q − mean)² + U(q)."""
        return 0.5 * self.precision * (q - mean) ** 2 + self.system.contact_energy(self.mass, q)


def conditional(system: System, mass: int, given: Sequence[int]) -> Conditional:
    """Return the law of q_mass given the displacements of ``given`` (masses from 0)."""
    flexibility, weights = 1.0 / system.stiffness, np.zeros(len(given))
    below = max((k for k in given if k < mass), default=-1)
    above = min((k for k in given if k > mass), default=None)
    left = 1.0 / float(flexibility[below + 1 : mass + 1].sum())
    right = 0.0 if above is None else 1.0 / float(flexibility[mass + 1 : above + 1].sum())
    for neighbour, stiffness in ((below, left), (above, right)):
        if neighbour is not None and neighbour in given:
            weights[list(given).index(neighbour)] = stiffness / (left + right)
    return Conditional(system, mass, left + right, weights)


def conditionals(system: System, masses: Sequence[int]) -> tuple[Conditional, ...]:
    """Return the law of each displacement given those before it: Π √a_k² is det K_red."""
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
) -> Array:
    """Return ∫ f(E + V(hidden | observed)) over up to two hidden displacements, (N,).

    E = ``energy`` (N,) and ``given`` (observed, N) are of the observed masses, each of the ``laws``
    is given these and the hidden ones before it. f falls by 1/e over ``temperature`` and vanishes
    beyond ``end``. Panels have ``points``. ``beyond`` of the last displacement multiplies f.
    """
    if not laws:
        return f(energy)
    # Opposite momenta have the same energy: each distinct point is integrated once.
    distinct, index = np.unique(np.vstack([energy, given]), axis=1, return_inverse=True)
    count = ceil(np.sqrt(2.0 * max(end / temperature, DEPTH)) / WIDTHS_PER_PANEL)
    shares, (t, w) = np.linspace(-1.0, 1.0, 2 * count + 1), gauss_legendre(points)
    levels = contact_levels(temperature, end)
    stops = [[beyond_stop(stop, levels)[None] for stop in law.stops] for law in laws]
    # About 30 panels of each hidden mass are not empty.
    chunks = distinct.shape[1] * (30 * points) ** len(laws) // CHUNK + 1
    parts = []
    for E, *Q in np.array_split(distinct, min(chunks, distinct.shape[1]), axis=1):
        size = E.size
        row, weight, q = np.arange(size), np.ones(size), np.reshape(Q, (-1, size))
        for k, law in enumerate(laws):
            mean, height = law.weights @ q, np.maximum(end - E, DEPTH * temperature)
            layers = [_first_touch(law, other, q, height, temperature) for other in laws[k + 1 :]]
            layers += [] if beyond is None else [beyond.nodes[None]]
            # Panels are uniform as far as the springs alone let the mass go from its mean.
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
        weight = weight * f(E) if beyond is None else weight * f(E) * beyond(q[-1])
        parts.append(np.bincount(row, weight, minlength=size))
    return np.asarray(np.concatenate(parts)[index.ravel()])


def gibbs_integral(
    system: System, observed: Sequence[int], at: Array, *, temperature: float, points: int
) -> tuple[Array, float]:
    """Return ∫exp(−V(hidden | observed)/T) Π √(a_k/2πT) over all contact masses not ``observed``.

    With it comes the error of interpolation, to which that of the rule of ``points`` adds. ``at``
    (observed, N) are displacements. Up to two hidden masses between them are integrated at once, a
    chain on either side from the last mass to the first: the integral over all that lies beyond a
    mass is a smooth function of its displacement, 0 to 1.
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
    total = len(hidden) * exp(-DEPTH)  # what the grids leave out
    for first, others in (
        (low, [i for i in reversed(hidden) if i < low]),
        (high, [i for i in hidden if i > high]),
    ):
        neighbours = [[first] if observed else [], *([i] for i in others)]
        laws = [conditional(system, *pair) for pair in zip(others, neighbours, strict=False)]
        x = at[observed.index(first)] if observed else np.zeros(at.shape[1])
        x, index = np.unique(x, return_inverse=True)
        reach = np.cumsum([np.sqrt(2.0 * DEPTH * temperature / law.precision) for law in laws])
        beyond, error, scale = None, 0.0, 1.0  # the error in units of the scale
        for law, most in reversed(list(zip(laws[1:], np.max(np.abs(x)) + reach, strict=False))):
            # In units of its value at rest: along many masses it becomes very small.
            top = float(over([law], np.zeros((1, 1)), beyond)[0])
            # The total weight of ``beyond``, and with it of its error, is 1 at the most. It is
            # largest where the mean is between the stops, or far beyond where there is one alone.
            free = [stop.sign * min(stop.clearance, most) for stop in law.stops]
            means = [np.linspace(-most, most, 33), np.linspace(min(free), max(free), 9)]
            weight = float(over([law], np.concatenate(means)[None]).max())

            def in_units(
                x: Array, law: Conditional = law, rest: Piecewise | None = beyond, top: float = top
            ) -> Array:
                return np.asarray(over([law], x[None], rest) / top)

            beyond = fit(in_units, np.linspace(-most, most, 9), FIT_TOLERANCE)
            assert beyond.error is not None
            error, scale = error * weight / top + float(beyond.error.max()), scale * top
        given = x[None] if observed else np.zeros((0, x.size))
        value = value * (scale * over(laws[:1], given, beyond))[index]
        total += scale * error
    return value, total


def _first_touch(
    law: Conditional, other: Conditional, given: Array, height: Array, temperature: float
) -> Array:
    """Layers (N, layers) around where the next hidden mass, at its mean, begins to touch."""
    share = other.weights[-1]
    if share == 0.0 or not other.stops:
        return np.empty((given.shape[1], 0))  # an observed mass lies in between
    width = float(np.sqrt(temperature / other.precision))
    reach = share * float(np.sqrt(2.0 * height.max() / law.precision))
    steps = width * 2.0 ** (np.arange(max(ceil(log2(reach / width)), 0) + 2) - 1.0)
    touch = [stop.sign * stop.clearance for stop in other.stops]
    means = np.add.outer(touch, [*-steps, 0.0, *steps]).ravel()
    return np.asarray((means - (other.weights[:-1] @ given)[:, None]) / share)


def stop_panels(
    system: System, mass: int, *, width: float, end: float, levels: Sequence[float]
) -> Array:
    """Return nodes of q_mass (from 0) up to the energy ``end``, at most ``width`` apart.

    Panels also end where a stop takes up the energies ``levels``.
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
    """Return contact energies at which panels end, from ``LEVELS`` of T to ``end``, ascending."""
    doublings = ceil(log2(max(end / temperature, DEPTH)))
    return [temperature * level for level in (*LEVELS, *2.0 ** np.arange(1.0, doublings + 1.0))]


def beyond_stop(stop: Contact, levels: Sequence[float]) -> Array:
    """Return displacements at the stop and where its contact energy is one of ``levels``."""
    return stop.sign * (stop.clearance + np.array([0.0, *map(stop.overlap_at, levels)]))
