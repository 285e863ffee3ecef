"""The equations as a chain of stages of levels: products with it, and its unknowns in order."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from averaging.phase_space.equation.others import Others
from averaging.phase_space.equation.terms import Group, Terms, add_matrix
from fpk.arrays import Array


@dataclass(frozen=True, eq=False)
class Chain:
    """The equations between stages: of each one what it meets in itself and in the others.

    ``factor`` C. ``groups[level]`` are the unknowns of a level by their degree in the others, and
    ``stages[n]`` the levels of stage n, one each unless damping terms connect more of them; the
    highest one of a stage stands first. Stage n meets itself by ``own[n]``, stage n + 1 by
    ``above[n]``, n − 1 by ``forced[n]`` and n − 2 by ``paired[n]``. The highest level of each
    degree in the others meets itself by l₁ (∂* ∂)^½, too, which stands for the levels above it.
    """

    factor: Array
    others: tuple[Others, ...]
    stages: tuple[range, ...]
    groups: tuple[tuple[Group, ...], ...]
    own: tuple[Terms, ...]
    above: tuple[Terms, ...]
    forced: tuple[Terms, ...]
    paired: tuple[Terms, ...]

    @property
    def top(self) -> int:
        """The highest stage."""
        return len(self.stages) - 1

    def size(self, n: int) -> int:
        """Number of unknowns of stage n."""
        return size_of(self.stages[n], self.groups)

    def starts(self, n: int) -> list[int]:
        """Where the groups of stage n begin, ascending."""
        return [group.start for level in self.stages[n][::-1] for group in self.groups[level]]

    def within(self, n: int, *, shift: complex = 0.0, kind: type = np.float64) -> Array:
        """Return the equations of stage n in itself, less ``shift`` times its unknowns.

        ``kind`` is that of the numbers. A shift that is not real makes them and all that follows
        from them complex.
        """
        A = np.zeros((self.size(n), self.size(n)), np.result_type(kind, shift))
        add_matrix(A, self.own[n])
        if shift:
            A[np.diag_indices_from(A)] -= shift
        return A

    @cached_property
    def ends(self) -> Array:
        """Where each stage ends in a vector of all unknowns, lowest first."""
        return np.cumsum([self.size(n) for n in range(self.top + 1)])

    def span(self, n: int) -> slice:
        """Where stage n stands in a vector of all unknowns."""
        return slice(self.ends[n] - self.size(n), self.ends[n])

    def split(self, u: Array) -> list[Array]:
        """Return the parts of a vector of all unknowns, one a stage."""
        return np.split(u, self.ends[:-1])

    @cached_property
    def matrix(self) -> sparse.csr_array:
        """The matrix of all equations and all unknowns, for products with vectors."""
        stages = ((0, self.own), (1, self.above), (-1, self.forced), (-2, self.paired))
        rows = []
        for n in range(self.top + 1):
            entries = [
                (row, self.span(n + away).start + column, values)
                for away, of_stages in stages
                for term in (of_stages[n] if 0 <= n + away <= self.top else ())
                for row, column, values in term.entries()
            ]
            row, column, values = (np.concatenate(x) for x in zip(*entries, strict=True))
            shape = (self.size(n), self.ends[-1])
            rows.append(sparse.csr_array((values, (row, column)), shape=shape))
        return sparse.csr_array(sparse.vstack(rows, format="csr"))

    def blocks(self, matrix: sparse.csr_array, away: int) -> list[sparse.csr_array]:
        """Return the blocks of a matrix of all unknowns by which stages meet those ``away`` above.

        They are lowest first, of the stages that have such a one.
        """
        stages = range(max(-away, 0), self.top + 1 - max(away, 0))
        return [matrix[self.span(n), self.span(n + away)] for n in stages]

    def packed(self, n: int, levels: Sequence[Array]) -> Array:
        """Return the unknowns of stage n of ``levels`` (count, functions) of the whole chain."""
        out = np.zeros(self.size(n), levels[0].dtype)
        for level in self.stages[n]:
            row = 0
            for g in self.groups[level]:
                out[g.span] = levels[level][row : row + g.count, : g.functions].ravel()
                row += g.count
        return out

    def shaped(self, n: int, u: Array) -> list[Array]:
        """Return the levels of stage n as (count, functions), 0 where a degree has no function."""
        levels = []
        for level in self.stages[n]:
            count = sum(o.count for o in self.others[: level + 1])
            most = max(g.functions for g in self.groups[level])
            out, row = np.zeros((count, most), u.dtype), 0
            for g in self.groups[level]:
                out[row : row + g.count, : g.functions] = u[g.span].reshape(g.count, g.functions)
                row += g.count
            levels.append(out)
        return levels


def size_of(stage: range, groups: Sequence[tuple[Group, ...]]) -> int:
    """Number of unknowns of a stage, the last of which are those of its lowest level."""
    last = groups[stage[0]][-1]
    return last.start + last.count * last.functions
