"""Blocks of the matrix of the equations: sums of Kronecker products between groups of unknowns."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from averaging.phase_space.equation.others import Matrix, Space
from fpk.arrays import Array

Entries = tuple[NDArray[np.integer], NDArray[np.integer], Array]
"""Rows, columns and values of entries of a matrix."""


@dataclass(frozen=True)
class Group:
    """Unknowns of a level with one degree in the others: ``count`` of k times ``functions`` of y.

    ``start`` is the first of them among all unknowns (``Chain``).
    """

    start: int
    count: int
    functions: int

    @property
    def span(self) -> slice:
        """Where they stand among all unknowns."""
        return slice(self.start, self.start + self.count * self.functions)


def block(to: Group, of: Group, degrees: Entries, functions: Array | None) -> Entries:
    """Return the entries of a block of the matrix, from unknowns of ``of`` to equations of ``to``.

    It is a Kronecker product: ``degrees`` (count, count) acts on k, ``functions`` on functions of
    y, (functions, functions) or None for those that both groups have, unchanged.
    """
    if functions is None:
        first = second = np.arange(min(to.functions, of.functions))[:, None]
        functions = np.ones((len(first), 1))
    else:
        first, second = np.ix_(*map(np.arange, functions.shape))
    i, j, factor = (x[:, None, None] for x in degrees)
    values = factor * functions
    row, column = (np.empty(values.shape, dtype=np.int32) for _ in range(2))
    row[:] = to.start + to.functions * i + first
    column[:] = of.start + of.functions * j + second
    return row.ravel(), column.ravel(), values.ravel()


Between = Sequence[Sequence[Array | None]]
"""Matrices on functions of y by the parities of the level to which and of which they lead.

None where functions that both levels have stay as they are."""
SAME: Between = ((None, None), (None, None))


def blocks_of(
    A: Matrix, functions: Between, space: Space, groups: Sequence[Sequence[Group]]
) -> Iterator[Entries]:
    """Yield the entries of a matrix on the degrees of ``space``, of one pair of groups at a time.

    ``groups`` are those of each level; degrees of the space that are in none are left out.
    """
    level, others = space.level, space.others
    count = np.zeros((level.max() + 1, others.max() + 1), dtype=np.intp)
    for n, of_level in enumerate(groups):
        count[n, : len(of_level)] = [group.count for group in of_level]
    # Degrees of one group stand together, in the order of its unknowns.
    name = level * (others.max() + 1) + others
    row = np.arange(name.size) - np.searchsorted(name, name)
    inside, X = row < count[level, others], A.tocoo()
    within = np.flatnonzero(inside[X.row] & inside[X.col] & (X.data != 0.0))
    to, of, entry = X.row[within], X.col[within], X.data[within]
    pair = name[to] * (name[-1] + 1) + name[of]
    order = np.argsort(pair, kind="stable")
    for at in np.split(order, np.flatnonzero(np.diff(pair[order])) + 1) if order.size else ():
        first, second = to[at[0]], of[at[0]]
        t, o = groups[level[first]][others[first]], groups[level[second]][others[second]]
        F = functions[level[first] % 2][level[second] % 2]
        F = F if F is None else F[: t.functions, : o.functions]
        yield block(t, o, (row[to[at]], row[of[at]], entry[at]), F)
