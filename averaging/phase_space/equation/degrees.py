"""Degrees of the Hermite polynomials and of the functions of y that stand with each of them."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np
from numpy.typing import NDArray

from fpk.arrays import Array

Indices = NDArray[np.intp]

LEAST = 0.5
"""Least number of polynomials beyond a stop at high levels of a high degree in the velocity of the
contact mass alone, as it is the stop that makes these, over the most."""
LEAST_MIXED = 0.3
"""Least number of them of any degrees, over the most."""
FEWER = 1.2
"""Polynomials beyond a stop that each degree in the other variables takes away."""


@dataclass(frozen=True)
class Degrees:
    """How fine an expansion is: highest level, degree in all but the contact velocity, panels.

    ``total`` is the largest |k|, ``others`` the largest sum of the degrees in the other velocities
    and in x; ``outer`` the number of polynomials in y beyond the last stop.
    """

    total: int
    others: int
    outer: int

    def others_at(self, level: int) -> int:
        """Highest degree in the others at a level.

        At the highest levels it falls by two a level: errors of densities stay as they are without
        these products of high degrees, and a fifth of the work is saved.
        """
        return min(level, self.others, 2 * (self.total - level))

    @property
    def least(self) -> int:
        """Least number of polynomials beyond a stop."""
        return int(LEAST_MIXED * self.outer)

    def beyond(self, level: int, others: int) -> int:
        """Number of polynomials beyond a stop, of |k| = ``level`` and a degree in the others.

        Motion turns degrees in y into those in velocities, so that what matters is their sum: the
        higher those of the velocities, the fewer polynomials. Levels go in pairs, as the
        derivatives of the functions of one are those of the next.
        """
        alone = max(self.outer - level // 2 * 2, int(LEAST * self.outer))
        return max(alone - int(FEWER * others), self.least)

    def between(self, width: float) -> int:
        """Number of polynomials of a panel between stops, odd; one without end has ``outer`` + 1.

        ``width`` is in standard deviations of the weight without stops.
        """
        return 2 * ceil(0.5 * min(6.0 + 0.12 * width * self.outer, self.outer)) + 1

    def fewer(self, most: int, beyond: int) -> int:
        """Number of polynomials of a panel between stops that goes with ``beyond``; odd.

        It falls half as fast: with fewer, errors were ten times larger between distant stops.
        """
        return 2 * int(0.25 * most * (1.0 + beyond / self.outer)) + 1


@dataclass(frozen=True, eq=False)
class Others:
    """Degrees in the variables other than the contact velocity, of one sum.

    ``k`` (count, d − 1) are all of the sum ``total``; ``raising[i]`` (count of the next sum, count)
    is a_i⁺: √(k_i + 1) where k + e_i stands in the next sum.
    """

    total: int
    k: Indices
    raising: tuple[Array, ...]


@lru_cache(maxsize=4)
def others_to(most: int, d: int) -> tuple[Others, ...]:
    """Return the degrees of sums 0 to ``most`` in ``d`` variables less the first."""
    sets = [_of_sum(total, d - 1) for total in range(most + 2)]
    out = []
    for total in range(most + 1):
        k, above = sets[total], {tuple(row): i for i, row in enumerate(sets[total + 1].tolist())}
        raising = []
        for i in range(d - 1):
            A, up = np.zeros((len(above), k.shape[0])), k + np.eye(d - 1, dtype=np.intp)[i]
            A[[above[tuple(row)] for row in up.tolist()], np.arange(k.shape[0])] = np.sqrt(up[:, i])
            raising.append(A)
        out.append(Others(total, k, tuple(raising)))
    return tuple(out)


def degrees_of_level(others: tuple[Others, ...], n: int) -> Indices:
    """Return the degrees k of level n, (count, d), by their sum in the others."""
    parts = [np.insert(o.k, 0, n - o.total, axis=1) for o in others[: n + 1]]
    return np.concatenate(parts)


def lowered(others: tuple[Others, ...], level: int, v: Array, e: Array) -> Array:
    """Return Σ_i e_i a_i v, for ``level``, of coefficients v of the level above."""
    highest = len(others) - 1
    parts = np.split(v, np.cumsum([o.k.shape[0] for o in others[: level + 2]])[:-1])
    out = [e[0] * np.sqrt(level - m + 1.0) * part for m, part in enumerate(parts[: level + 1])]
    for m in range(min(level, highest - 1) + 1):
        for a, A in zip(e[1:], others[m].raising, strict=True):
            out[m] = out[m] + a * (A.T @ parts[m + 1])
    return np.concatenate(out)


def _of_sum(total: int, d: int) -> Indices:
    """All d numbers >= 0 of this sum, (count, d)."""
    if d == 0:
        return np.zeros((int(total == 0), 0), dtype=np.intp)
    grid = np.indices((total + 1,) * d).reshape(d, -1).T
    return np.asarray(grid[grid.sum(axis=1) == total], dtype=np.intp)


def raised(others: tuple[Others, ...], level: int, v: Array, e: Array) -> Array:
    """Return Σ_i e_i a_i⁺ v of coefficients v (count of ``level``, ...), for the level above.

    A level has its k by their sum in the others, in the order of ``others``.
    """
    highest = len(others) - 1
    parts = np.split(v, np.cumsum([o.k.shape[0] for o in others[: level + 1]])[:-1])
    out = [e[0] * np.sqrt(level - m + 1.0) * part for m, part in enumerate(parts)]
    if level < highest:
        out.append(np.zeros((others[level + 1].k.shape[0], *v.shape[1:])))
    for m in range(min(level, highest - 1) + 1):
        for a, A in zip(e[1:], others[m].raising, strict=True):
            out[m + 1] = out[m + 1] + a * (A @ parts[m])
    return np.concatenate(out)
