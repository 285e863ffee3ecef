"""Integrals over contact masses that are not observed, on grids of their law given the others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, exp, log2

import numpy as np
from numpy.typing import NDArray

from averaging.conditional import Conditional, conditional, conditionals
from fpk.arrays import Array
from fpk.contact import Contact
from fpk.piecewise import Piecewise, fit
from fpk.quadrature import gauss_legendre
from fpk.system import System

Function = Callable[[Array], Array]

WIDTHS_PER_PANEL = 1.8
"""Longest panel in units of √(T/a), T the temperature: ten Gauss points integrate exp(−½x²) over it
to 1e-15."""
DEPTH = 40.0
"""Least height above rest, in units of T, that a grid reaches: e^−40 = 4e-18."""
LEVELS = (1e-5, 1e-3, 0.1, 1.0)
"""Contact energies in units of T between which panels lie beyond a stop, then by ``RISE``."""
RISE = 2.0
"""Ratio of neighbouring levels: over [x, 2x] a Gauss rule of ten points misses at most 2e-12 of
exp(−x), at x = 16."""
FIT_TOLERANCE = 1e-13
"""Largest error of the integral over all masses beyond one, a number between 0 and 1; round-off is
a tenth of it."""
FIT_ROUNDS = 20
"""Bisections of a panel of that integral, at the most."""
RULES = ((1, 1), (10, 14), (8, 10), (14, 18))
"""Gauss points per panel over 0, 1, 2 or more hidden contact masses, and of the finer rule of the
answer: the distance between the two is its error. The errors of passes along a chain add up."""
CHUNK = 400_000
"""Points of the innermost integral evaluated at once, to bound memory."""


def rules_of(hidden: int) -> tuple[int, int]:
    """Return the points of both rules for a number of hidden contact masses."""
    return RULES[min(hidden, len(RULES) - 1)]


@dataclass(frozen=True, eq=False)
class HiddenIntegral:
    """∫ f(E + V(hidden | observed)) over one or two hidden displacements, for a falling f.

    ``laws`` are those of the hidden displacements, each given the observed ones and the hidden ones
    before it; f falls by 1/e over the energy ``temperature`` and vanishes beyond ``end``.
    """

    laws: tuple[Conditional, ...]
    temperature: float
    end: float

    def __call__(self, f: Function, energy: Array, given: Array, *, points: int) -> Array:
        """Return the integral for energies (N,) of the observed, at ``given`` (observed, N)."""
        if not self.laws:
            return f(energy)
        # Opposite momenta have the same energy: each distinct point is integrated once.
        distinct, index = np.unique(np.vstack([energy, given]), axis=1, return_inverse=True)
        # About 30 panels of each hidden mass are not empty.
        size = max(1, CHUNK // (30 * points) ** len(self.laws))
        parts = []
        for start in range(0, distinct.shape[1], size):
            part = distinct[:, start : start + size]
            row, inner, weights = self._rule(part[0], part[1:], points)
            parts.append(np.bincount(row, weights * f(inner), minlength=part.shape[1]))
        return np.asarray(np.concatenate(parts)[index.ravel()])

    def beyond(self, f: Function, energy: Array) -> Array:
        """Return a bound of what the grids leave out: V is above ``end``, and ``DEPTH`` above E.

        As contact only adds to V, it is less than f at that energy times a width for each mass.
        """
        if not self.laws:
            return np.zeros_like(energy)
        top = np.maximum(self.end, energy + DEPTH * self.temperature)
        widths = [np.sqrt(2.0 * np.pi * self.temperature / law.precision) for law in self.laws]
        return np.asarray(len(self.laws) * np.prod(widths) * f(top))

    def _rule(
        self, energy: Array, given: Array, points: int
    ) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the row, the energy and the weight of every point of the hidden masses."""
        row, weight = np.arange(energy.size, dtype=np.intp), np.ones(energy.size)
        for k, law in enumerate(self.laws):
            mean, height = law.weights @ given, self.end - energy
            layers = self._first_touch(law, self.laws[k + 1 : k + 2], given, float(height.max()))
            at, q, w = _points_of(law, mean, height, layers, self.temperature, self.end, points)
            energy = energy[at] + law.energy(q, mean[at])
            weight, row = weight[at] * w, row[at]
            given = np.concatenate([given[:, at], q[None]])
        return row, energy, weight

    def _first_touch(
        self, law: Conditional, others: tuple[Conditional, ...], given: Array, height: float
    ) -> Array:
        """Layers (N, layers) around where the next hidden mass, at its mean, begins to touch."""
        layers = [np.empty((given.shape[1], 0))]
        for other in others:
            share = other.weights[-1]
            if share == 0.0 or not other.stops:
                continue  # an observed mass lies in between
            width = float(np.sqrt(self.temperature / other.precision))
            reach = share * float(np.sqrt(2.0 * max(height, DEPTH * self.temperature)))
            doublings = max(ceil(log2(reach / np.sqrt(law.precision) / width)), 0) + 2
            steps = width * 2.0 ** (np.arange(doublings) - 1.0)
            touch = [stop.sign * stop.clearance for stop in other.stops]
            means = np.add.outer(touch, [*-steps, 0.0, *steps]).ravel()
            layers.append((means - (other.weights[:-1] @ given)[:, None]) / share)
        return np.hstack(layers)


def gibbs_integral(
    system: System, observed: Sequence[int], at: Array, *, temperature: float, points: int
) -> tuple[Array, float]:
    """Return ∫exp(−V(hidden | observed)/T) Π √(a_k/2πT) over all contact masses not ``observed``.

    With it comes the error of interpolation, to which that of the rule of ``points`` adds. ``at``
    (observed, N) are the displacements of the observed masses. On either side of them the hidden
    ones are a chain; up to two between them are integrated at once.
    """
    hidden = [i for i in system.contact_masses if i not in observed]
    low, high = min(observed, default=-1), max(observed, default=-1)
    value = np.ones(at.shape[1])
    error = len(hidden) * exp(-DEPTH)  # what the grids leave out
    for first, others in (
        (low, [i for i in reversed(hidden) if i < low]),
        (high, [i for i in hidden if i > high]),
    ):
        neighbours = [[first] if observed else [], *([i] for i in others)]
        laws = [conditional(system, *pair) for pair in zip(others, neighbours, strict=False)]
        x = at[observed.index(first)] if observed else np.zeros(at.shape[1])
        distinct, index = np.unique(x, return_inverse=True)
        part, added = chain_integral(laws, distinct, temperature=temperature, points=points)
        value, error = value * part[index], error + added
    between = [i for i in hidden if low < i < high]
    if between:
        laws = list(conditionals(system, [*observed, *between])[len(observed) :])
        integral = HiddenIntegral(tuple(laws), temperature, DEPTH * temperature)
        scale = np.prod([np.sqrt(law.precision / (2.0 * np.pi * temperature)) for law in laws])
        part = integral(lambda V: np.exp(-V / temperature), 0.0 * value, at, points=points)
        value = value * scale * part
    return value, error


def chain_integral(
    laws: Sequence[Conditional], x: Array, *, temperature: float, points: int
) -> tuple[Array, float]:
    """Return ∫exp(−V/T) Π √(a_k/2πT) dq_k over a chain, and its error by interpolation.

    ``laws`` are those of each mass given the one before it, ``x`` (N,) displacements of the mass
    that the first one hangs on, if any. One pass from the last mass to the first: the integral over
    all that lies beyond a mass is a smooth function of its displacement, between 0 and 1. The error
    of the rule of ``points`` comes on top.
    """
    beyond, error, scale = None, 0.0, 1.0  # the error in units of the scale
    reach = np.cumsum([np.sqrt(2.0 * DEPTH * temperature / law.precision) for law in laws])
    over_one: Function = np.ones_like
    for k, law in reversed(tuple(enumerate(laws))):
        over_one = partial(_over_one, law, beyond, temperature, points)
        if k:
            most = float(np.max(np.abs(x)) + reach[k - 1])
            # Where the mean is between the stops, or far beyond where there is one alone.
            free = [stop.sign * min(stop.clearance, most) for stop in law.stops]
            at = np.concatenate(
                [np.linspace(-most, most, 33), np.linspace(min(free), max(free), 9)]
            )
            # In units of its value at rest: along many masses it becomes very small.
            top = float(over_one(np.zeros(1))[0])
            # What weights ``beyond``, and with it its error, in total: at the most 1.
            weight = float(_over_one(law, None, temperature, points, at).max())
            unit = partial(_in_unit, over_one, top)
            beyond = fit(unit, np.linspace(-most, most, 9), FIT_TOLERANCE, rounds=FIT_ROUNDS)
            assert beyond.error is not None
            error, scale = error * weight / top + float(beyond.error.max()), scale * top
    return scale * over_one(x), scale * error


def _in_unit(function: Function, unit: float, x: Array) -> Array:
    return np.asarray(function(x) / unit)


def _over_one(
    law: Conditional, beyond: Piecewise | None, temperature: float, points: int, x: Array
) -> Array:
    """∫exp(−V/T) √(a/2πT) dq of one mass times what is ``beyond`` it, at x (N,) of the other."""
    mean, top = float(law.weights.sum()) * x, DEPTH * temperature
    layers = np.empty((x.size, 0)) if beyond is None else np.tile(beyond.nodes, (x.size, 1))
    at, q, w = _points_of(law, mean, 0.0 * x, layers, temperature, top, points)
    w = w * np.exp(-law.energy(q, mean[at]) / temperature)
    if beyond is not None:
        w = w * beyond(q)
    scale = np.sqrt(law.precision / (2.0 * np.pi * temperature))
    return np.asarray(scale * np.bincount(at, w, minlength=x.size))


def _points_of(
    law: Conditional,
    mean: Array,
    height: Array,
    layers: Array,
    temperature: float,
    end: float,
    points: int,
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the row, displacement and weight of Gauss points, all (points of all rows,).

    Panels are uniform as far as the springs alone let the mass go from its ``mean`` (N,) with the
    energy ``height`` (N,), with layers beyond its stops and those given (N, layers).
    """
    reach = np.sqrt(2.0 * np.maximum(height, DEPTH * temperature) / law.precision)[:, None]
    count = ceil(np.sqrt(2.0 * max(end / temperature, DEPTH)) / WIDTHS_PER_PANEL)
    low, high = mean[:, None] - reach, mean[:, None] + reach
    levels = contact_levels(temperature, end)
    parts = [
        mean[:, None] + reach * np.linspace(-1.0, 1.0, 2 * count + 1),
        np.clip(layers, low, high),
    ]
    for stop in law.stops:
        beyond = stop.sign * (stop.clearance + overlaps(stop, levels))
        parts.append(np.clip(beyond, low, high))
    nodes = np.sort(np.hstack(parts), axis=1)
    half = 0.5 * np.diff(nodes, axis=1)
    row, panel = np.nonzero(half > 0.0)
    half = half[row, panel, None]
    t, w = gauss_legendre(points)
    q = (nodes[row, panel, None] + half * (1.0 + t)).ravel()
    return np.repeat(row, points), q, (half * w).ravel()


def stop_panels(
    system: System, mass: int, *, width: float, end: float, levels: Sequence[float]
) -> Array:
    """Return panel nodes of q_mass (from 0) over the range that the energy ``end`` allows.

    Panels are ``width`` long at the most, and end where a stop of this mass takes up the contact
    energies ``levels``.
    """
    most = float(np.sqrt(2.0 * system.compliance[mass, mass] * end))
    stops = [stop for stop in system.stops if stop.index == mass]
    low, high = (
        min([most, *(s.clearance + s.overlap_at(end) for s in stops if s.side == side)])
        for side in ("left", "right")
    )
    parts = [stop.sign * (stop.clearance + overlaps(stop, levels)) for stop in stops]
    parts.append(np.linspace(-low, high, max(4, ceil((high + low) / width)) + 1))
    return np.unique(np.clip(np.concatenate(parts), -low, high))


def contact_levels(temperature: float, end: float) -> list[float]:
    """Return contact energies at which panels end, from ``LEVELS`` of T to ``end``, ascending."""
    top = max(end / temperature, DEPTH)
    levels = [*LEVELS, *RISE ** np.arange(1.0, ceil(np.log(top) / np.log(RISE)) + 1.0)]
    return [level * temperature for level in levels]


def overlaps(stop: Contact, levels: Sequence[float]) -> Array:
    """Return overlaps at 0 and at the contact energies ``levels``."""
    return np.array([0.0, *map(stop.overlap_at, levels)])
