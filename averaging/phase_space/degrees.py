"""Degrees of the Hermite polynomials of each level, and where the neighbours of each stand."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Level:
    """All degrees k (count, d) of a total |k| = ``total``, k₂ + … + k_d at the most ``others``.

    ``raised`` (d, count) is where k + e_i stands in the level above, −1 where it is not in the
    set; ``moved`` (d, d, count) where k − e_j + e_i stands in this one, likewise.
    """

    total: int
    k: Indices
    raised: Indices
    moved: Indices


@lru_cache(maxsize=4)
def levels(total: int, others: int, d: int) -> tuple[Level, ...]:
    """Return the levels 0 to ``total`` in ``d`` variables."""
    rest = _compositions(others, d - 1)
    sums = rest.sum(axis=1)
    sets = []
    for n in range(total + 2):
        fits = sums <= n
        sets.append(np.column_stack([n - sums[fits], rest[fits]]))
    return tuple(_level(n, sets[n], sets[n + 1]) for n in range(total + 1))


def _compositions(most: int, d: int) -> Indices:
    """All d numbers >= 0 with a sum of at most ``most``, by their sum."""
    if d == 0:
        return np.zeros((1, 0), dtype=np.intp)
    grid = np.indices((most + 1,) * d).reshape(d, -1).T
    grid = grid[grid.sum(axis=1) <= most]
    return np.asarray(grid[np.lexsort((*grid.T, grid.sum(axis=1)))], dtype=np.intp)


def _level(n: int, k: Indices, above: Indices) -> Level:
    d, unit = k.shape[1], np.eye(k.shape[1], dtype=np.intp)
    here = {tuple(row): i for i, row in enumerate(k.tolist())}
    there = {tuple(row): i for i, row in enumerate(above.tolist())}

    def places(of: dict[tuple[int, ...], int], rows: Indices) -> Indices:
        return np.array([of.get(tuple(row), -1) for row in rows.tolist()], dtype=np.intp)

    raised = np.array([places(there, k + unit[i]) for i in range(d)])
    moved = np.array([[places(here, k + unit[i] - unit[j]) for j in range(d)] for i in range(d)])
    return Level(n, k, raised, moved)
