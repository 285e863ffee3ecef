"""Integrals over contact masses that are not observed, on grids of their law given the others."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, log2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from averaging.conditional import Conditional, overlap_at, side_sign
from fpk.contact import Contact
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]
Function = Callable[[Array], Array]


WIDTHS_PER_PANEL = 1.8
"""Longest panel in units of √(T/a), T the temperature: ten Gauss points integrate exp(−½x²) over it
to 1e-15."""
DEPTH = 40.0
"""Least height above the potential's minimum, in units of T, that a grid reaches: e^−40 = 4e-18."""
LEVELS = (1e-5, 1e-3, 0.1, 1.0)
"""Contact energies in units of T between which panels lie beyond a stop, where the potential has a
half-integer power; higher ones follow by ``RISE`` as far as energies go."""
RISE = 3.0
"""Ratio of neighbouring levels: a Gauss rule of ten points integrates exp(−x) over [x, 3x] to 1e-9
of e^−x at x = 9, and better below."""
EDGE = {"xatol": 0.0, "xrtol": 1e-2}
"""Accuracy of the ends of a grid, which no integral is sensitive to: e^−40 lies beyond."""
CHUNK = 400_000
"""Points of the innermost integral evaluated at once, to bound memory."""


@dataclass(frozen=True, eq=False)
class HiddenIntegral:
    """∫ f(E + V(hidden | observed)) over one or two hidden displacements, for a falling f.

    ``laws`` are those of the hidden ones given the observed and each other, outermost first;
    ``temperature`` the energy over which f falls by 1/e and ``end`` the energy where it ends.
    """

    laws: tuple[Conditional, ...]
    temperature: float
    end: float

    def __call__(self, f: Function, energy: Array, given: Array, *, points: int) -> Array:
        """Return the integral for energies (N,) of the observed, at ``given`` (observed, N)."""
        if not self.laws:
            return f(energy)
        columns, group = _distinct(given)
        members = _members(group)
        lowest = np.array([energy[part].min() for part in members])
        total = np.zeros(energy.size)
        # About 30 panels are not empty, of the panels of each hidden mass.
        rows = max(1, CHUNK // (30 * points) ** len(self.laws))
        for at in range(0, len(members), rows):
            chunk = slice(at, at + rows)
            row, inner, weights = self._rule(lowest[chunk], columns[:, chunk], points)
            if columns.shape[1] == energy.size:
                count = lowest[chunk].size
                sums = np.bincount(row, weights * f(inner), minlength=count)
                total[np.concatenate(members[chunk])] = sums
                continue
            # Points with the same displacements and other momenta share a grid.
            first = np.searchsorted(row, np.arange(lowest[chunk].size + 1))
            for k, part in enumerate(members[chunk]):
                own = slice(first[k], first[k + 1])
                levels, which = np.unique(energy[part], return_inverse=True)
                above = inner[own] - lowest[at + k]
                total[part] = np.array([f(E + above) @ weights[own] for E in levels])[which]
        return total

    def _rule(
        self, energy: Array, given: Array, points: int
    ) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the row, the energy and the weight of every point of the hidden masses."""
        row, weight = np.arange(energy.size, dtype=np.intp), np.ones(energy.size)
        t, w = gauss_legendre(points)
        for k, law in enumerate(self.laws):
            mean = law.weights @ given
            nodes = self._nodes(k, energy, given, mean)
            half = 0.5 * np.diff(nodes, axis=1)
            which, panel = np.nonzero(half > 0.0)
            half = half[which, panel, None]
            q = (nodes[which, panel, None] + half * (1.0 + t)).ravel()
            at = np.repeat(which, points)
            energy = energy[at] + law.energy(q, mean[at])
            weight = weight[at] * (half * w).ravel()
            given = np.concatenate([given[:, at], q[None]])
            row = row[at]
        return row, energy, weight

    def _nodes(self, k: int, energy: Array, given: Array, mean: Array) -> Array:
        """Ends of the panels (N, panels + 1), ascending; empty ones where stops are out of reach.

        Uniform on either side of the minimum of the potential up to where it has risen by all
        that f can tell, with layers where a stop, or one of the next mass, bends it.
        """
        law, T = self.laws[k], self.temperature
        # The next mass matters here only where this one pulls at it.
        coupled = [other for other in self.laws[k + 1 : k + 2] if other.weights[-1] > 0.0]
        following = _Following(law, coupled[0] if coupled else None, T)
        shift = following.shift(given)
        bottom = following.minimum(mean, shift)
        lowest = following.energy(bottom, mean, shift)
        height = np.maximum(self.end - energy - lowest, DEPTH * T)
        # The potential rises by ½ a x² at least.
        most = np.sqrt(2.0 * height / law.precision)
        count = ceil(float(np.sqrt(2.0 * max(self.end / T, DEPTH))) / WIDTHS_PER_PANEL)
        steps = np.linspace(0.0, 1.0, count + 1)[1:]
        ends = [bottom - following.reach(-most, bottom, mean, shift, lowest + height)]
        ends += [bottom + following.reach(most, bottom, mean, shift, lowest + height)]
        low, high = (end[:, None] for end in ends)
        parts = [bottom[:, None]]
        parts += [bottom[:, None] + (end - bottom)[:, None] * steps for end in ends]
        for stop in law.stops:
            layers = side_sign(stop) * (stop.clearance + overlaps(stop, T, self.end))
            parts.append(np.clip(layers, low, high))
        parts.append(np.clip(following.layers(shift, float(np.max(most))), low, high))
        return np.sort(np.hstack(parts), axis=1)


def _distinct(given: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the distinct columns of ``given`` and of which one each point is."""
    if not len(given):
        return np.zeros((0, 1)), np.zeros(given.shape[1], dtype=np.intp)
    columns, group = np.unique(given, axis=1, return_inverse=True)
    return columns, group.ravel()


def _members(group: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the points of each group, in the order of the groups."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


@dataclass(frozen=True, eq=False)
class _Following:
    """Potential of one hidden mass where the ``next`` one, if any, rests as its own law has it.

    ``mean`` is that of the mass, ``shift`` the part of the mean of the next one that the observed
    cause, both (N,) like q: the arguments of a root finder that drops what has converged.
    """

    law: Conditional
    next: Conditional | None
    temperature: float

    def shift(self, given: Array) -> Array:
        """Return the part (N,) of the mean of the next mass caused by ``given`` (observed, N)."""
        if self.next is None:
            return np.zeros(given.shape[1])
        return np.asarray(self.next.weights[:-1] @ given)

    def energy(self, q: Array, mean: Array, shift: Array) -> Array:
        energy = self.law.energy(q, mean)
        if self.next is None:
            return energy
        centre = shift + self.next.weights[-1] * q
        rest = _Following(self.next, None, self.temperature).minimum(centre, 0.0 * centre)
        return energy + self.next.energy(rest, centre)

    def slope(self, q: Array, mean: Array, shift: Array) -> Array:
        slope = self.law.precision * (q - mean) + self.law.contact_force(q)
        if self.next is None:
            return slope
        share = self.next.weights[-1]
        centre = shift + share * q
        rest = _Following(self.next, None, self.temperature).minimum(centre, 0.0 * centre)
        return np.asarray(slope + share * self.next.precision * (centre - rest))

    def minimum(self, mean: Array, shift: Array) -> Array:
        """Where the potential is least, to a hundredth of T.

        The slope rises at the rate a at least: its root is no further from a point than slope/a,
        and the potential there no more than slope²/2a above the minimum.
        """
        small = 0.1 * float(np.sqrt(self.law.precision * self.temperature))
        slope = self.slope(mean, mean, shift)
        result = mean.astype(float)
        i = np.flatnonzero(np.abs(slope) > small)
        if i.size:
            step = -slope[i] / self.law.precision
            find_root: Any = _root_finder()
            share = find_root(
                lambda s, step, mean, shift: (
                    np.sign(step) * self.slope(mean + s * step, mean, shift)
                ),
                (np.zeros(i.size), np.full(i.size, 1.0 + 1e-9)),
                args=(step, mean[i], shift[i]),
                tolerances={"xatol": 0.0, "fatol": small},
            ).x
            result[i] += share * step
        return result

    def reach(self, most: Array, bottom: Array, mean: Array, shift: Array, level: Array) -> Array:
        """Distance from ``bottom`` at which the potential has risen to ``level``, about."""
        find_root: Any = _root_finder()
        share = find_root(
            lambda s, most, bottom, mean, shift, level: (
                self.energy(bottom + s * most, mean, shift) - level
            ),
            (np.zeros_like(most), np.full_like(most, 1.1)),
            args=(most, bottom, mean, shift, level),
            tolerances=EDGE,
        ).x
        return np.asarray(np.abs(share * most))

    def layers(self, shift: Array, reach: float) -> Array:
        """Where the next mass begins to touch: layers from a part of the width of its law on."""
        if self.next is None or not self.next.stops:
            return np.empty((shift.size, 0))
        share = self.next.weights[-1]
        width = float(np.sqrt(self.temperature / self.next.precision))
        count = max(ceil(log2(max(share * reach / width, 1.0))), 0) + 2
        steps = width * 2.0 ** (np.arange(count) - 1.0)
        around = np.concatenate([-steps[::-1], [0.0], steps])
        touch = np.array([side_sign(stop) * stop.clearance for stop in self.next.stops])
        where = (touch[:, None] + around).ravel()
        return np.asarray((where - shift[:, None]) / share)


def overlaps(stop: Contact, temperature: float, end: float) -> Array:
    """Return overlaps at 0 and at contact energies from ``LEVELS`` of T to ``end``, ascending."""
    top = max(end / temperature, DEPTH)
    levels = [*LEVELS, *RISE ** np.arange(1.0, ceil(np.log(top) / np.log(RISE)) + 1.0)]
    return np.array([0.0, *(overlap_at(stop, level * temperature) for level in levels)])


def _root_finder() -> Any:
    """``scipy.optimize.elementwise.find_root``: late, as it takes 0.2 s; typed for one argument."""
    from scipy.optimize import elementwise  # noqa: PLC0415

    return elementwise.find_root
