"""The equations as a chain of stages of levels: their matrix, and its unknowns in order."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from averaging.phase_space.equation.others import Matrix, Others
from averaging.phase_space.equation.terms import Group
from fpk.arrays import Array, Integers


@dataclass(frozen=True, eq=False)
class Chain:
    """The equations between stages: of each one what it meets in itself and in the others.

    ``factor`` C. ``groups[level]`` are the unknowns of a level by their degree in the others, and
    ``stages[n]`` the levels of stage n, one each unless damping terms connect more of them; the
    highest one of a stage stands first. ``matrix`` is that of all equations and all unknowns:
    stage n meets itself, stages n + 1, n − 1 and n − 2. The highest level of each degree in the
    others meets itself by l₁ (∂* ∂)^½, too, which stands for the levels above it.
    """

    factor: Array
    others: tuple[Others, ...]
    stages: tuple[range, ...]
    groups: tuple[tuple[Group, ...], ...]
    matrix: Matrix

    @property
    def top(self) -> int:
        """The highest stage."""
        return len(self.stages) - 1

    @cached_property
    def ends(self) -> Integers:
        """Where each stage ends in a vector of all unknowns, lowest first."""
        return ends_of(self.stages, self.groups)

    def size(self, n: int) -> int:
        """Number of unknowns of stage n."""
        return int(np.diff(self.ends, prepend=0)[n])

    def span(self, n: int) -> slice:
        """Where stage n stands in a vector of all unknowns."""
        return slice(self.ends[n] - self.size(n), self.ends[n])

    def starts(self, n: int) -> list[int]:
        """Where the groups of stage n begin among its unknowns, ascending."""
        first = self.span(n).start
        levels = self.stages[n][::-1]
        return [group.start - first for level in levels for group in self.groups[level]]

    def within(self, n: int, *, shift: complex = 0.0, kind: type = np.float64) -> Array:
        """Return the equations of stage n in itself, less ``shift`` times its unknowns.

        ``kind`` is that of the numbers. A shift that is not real makes them and all that follows
        from them complex.
        """
        A = self.matrix[self.span(n), self.span(n)].toarray()
        A = A.astype(np.result_type(kind, shift), copy=False)
        if shift:
            A[np.diag_indices_from(A)] -= shift
        return np.asarray(A)

    def split(self, u: Array) -> list[Array]:
        """Return the parts of a vector of all unknowns, one a stage."""
        return np.split(u, self.ends[:-1])

    def blocks(self, matrix: sparse.csr_array, away: int) -> list[sparse.csr_array]:
        """Return the blocks of a matrix of all unknowns by which stages meet those ``away`` above.

        They are lowest first, of the stages that have such a one.
        """
        stages = range(max(-away, 0), self.top + 1 - max(away, 0))
        return [matrix[self.span(n), self.span(n + away)] for n in stages]

    def packed(self, levels: Sequence[Array]) -> Array:
        """Return the vector of all unknowns of ``levels`` (count, functions)."""
        out = np.zeros(self.ends[-1], levels[0].dtype)
        for u, groups in zip(levels, self.groups, strict=True):
            row = 0
            for g in groups:
                out[g.span] = u[row : row + g.count, : g.functions].ravel()
                row += g.count
        return out

    def shaped(self, u: Array) -> list[Array]:
        """Return the levels of a vector as (count, functions), 0 where a degree has no function."""
        levels = []
        for n, groups in enumerate(self.groups):
            count = sum(o.count for o in self.others[: n + 1])
            out, row = np.zeros((count, max(g.functions for g in groups)), u.dtype), 0
            for g in groups:
                out[row : row + g.count, : g.functions] = u[g.span].reshape(g.count, g.functions)
                row += g.count
            levels.append(out)
        return levels


def ends_of(stages: Sequence[range], groups: Sequence[tuple[Group, ...]]) -> Integers:
    """Return where each stage ends among all unknowns: with the last group of its lowest level."""
    return np.array([groups[stage[0]][-1].span.stop for stage in stages])
