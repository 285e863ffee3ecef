"""The null vector of condensed elements by nested dissection: rectangles of elements, merged.

Two neighbours are added up, and what no other element has is eliminated, until one rectangle is
left, whose unknowns are those of one line across the mesh. All matrices are small and dense: the
work grows as unknowns^1.5.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Merge(NamedTuple):
    """Two rectangles, counted in the order in which they come to be, the elements first.

    ``first_at``, ``second_at`` are the places of their unknowns among those of both; the
    ``eliminated`` ones come first.
    """

    first: int
    second: int
    first_at: Integers
    second_at: Integers
    size: int
    eliminated: int


class Plan(NamedTuple):
    """Merges, each after those it rests on, and the unknowns of the last one by global numbers."""

    merges: tuple[Merge, ...]
    last: Integers


class Eliminated(NamedTuple):
    """What a merge left of its matrix: x_eliminated = ``fold`` x_kept."""

    merge: Merge
    fold: Array


def plan_of(numbers: Integers, counts: tuple[int, int]) -> Plan:
    """Return how to merge elements with unknowns ``numbers`` (elements, unknowns of one).

    Of a rectangle the longer side is halved; elements run along H2 fastest.
    """
    total = np.bincount(numbers.ravel())
    merges: list[Merge] = []

    def merged(rows: range, columns: range) -> tuple[int, Integers, Integers]:
        """Its place, its unknowns, and in how many of its elements each is."""
        if len(rows) * len(columns) == 1:
            element = rows[0] * counts[1] + columns[0]
            return element, numbers[element], np.ones(numbers.shape[1], np.int64)
        if len(rows) >= len(columns):
            half = len(rows) // 2
            parts = merged(rows[:half], columns), merged(rows[half:], columns)
        else:
            half = len(columns) // 2
            parts = merged(rows, columns[:half]), merged(rows, columns[half:])
        (first, own, own_count), (second, others, other_count) = parts
        both, at = np.unique(np.concatenate([own, others]), return_inverse=True)
        within = np.bincount(at, np.concatenate([own_count, other_count])).astype(np.int64)
        done = within == total[both]
        if done.all():  # The last one: what is left is not eliminated but solved for.
            done[:] = False
        order = np.argsort(~done, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(order.size)
        at, eliminated = place[at], int(done.sum())
        merges.append(Merge(first, second, at[: own.size], at[own.size :], both.size, eliminated))
        kept = order[eliminated:]
        return numbers.shape[0] + len(merges) - 1, both[kept], within[kept]

    _, last, _ = merged(range(counts[0]), range(counts[1]))
    return Plan(tuple(merges), last)


def solve_by_merging(outer: Array, mass: Array, plan: Plan, vertices: Integers) -> Array:
    """Return the null vector with ``mass`` 1, element by element (elements, unknowns of one).

    ``outer`` (elements, unknowns, unknowns) and ``mass`` (elements, unknowns) add up to the global
    system; of the equations left one of the ``vertices`` gives way to the mass, as the vertex
    functions of all sum to one. Raises ``LinAlgError`` where the rest is singular.
    """
    blocks, masses = list(outer), list(mass)
    passed: list[Eliminated] = []
    for merge in plan.merges:
        matrix, total = np.zeros((merge.size, merge.size)), np.zeros(merge.size)
        for part, at in ((merge.first, merge.first_at), (merge.second, merge.second_at)):
            matrix[at[:, None], at] += blocks[part]
            total[at] += masses[part]
            blocks[part] = masses[part] = np.empty(0)
        n = merge.eliminated
        fold = np.asarray(-np.linalg.solve(matrix[:n, :n], matrix[:n, n:]))
        blocks.append(matrix[n:, n:] + matrix[n:, :n] @ fold)
        masses.append(total[n:] + total[:n] @ fold)
        passed.append(Eliminated(merge, fold))
    system, right = blocks[-1].copy(), np.zeros(plan.last.size)
    row = int(np.flatnonzero(np.isin(plan.last, vertices))[0])
    system[row], right[row] = masses[-1], 1.0
    found = {len(blocks) - 1: np.linalg.solve(system, right)}
    for place, (merge, fold) in zip(range(len(blocks) - 1, 0, -1), reversed(passed), strict=False):
        kept = found.pop(place)
        x = np.concatenate([fold @ kept, kept])
        found[merge.first], found[merge.second] = x[merge.first_at], x[merge.second_at]
    return np.array([found[element] for element in range(len(outer))])
