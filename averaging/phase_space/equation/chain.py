"""The equations as a chain of stages of levels: products with it, and its unknowns in order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from averaging.phase_space.equation.others import Others
from averaging.phase_space.equation.terms import Group, Terms, applied
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
        for term in self.own[n]:
            term.add_matrix_to(A)
        if shift:
            A[np.diag_indices_from(A)] -= shift
        return A

    def times(self, u: Sequence[Array]) -> tuple[list[Array], float]:
        """Return the equations times u, and the size of the terms that cancel in them."""
        out, size = [], 0.0
        for n in range(self.top + 1):
            parts = [applied(self.own[n], u[n][:, None], self.size(n))]
            if n < self.top:
                parts.append(applied(self.above[n], u[n + 1][:, None], self.size(n)))
            for below, terms in ((1, self.forced[n]), (2, self.paired[n])):
                if terms:
                    parts.append(applied(terms, u[n - below][:, None], self.size(n)))
            size = max(size, sum(float(np.max(np.abs(part))) for part in parts))
            out.append(np.sum(parts, axis=0)[:, 0])
        return out, size

    def from_below(self, n: int, u: Sequence[Array], inverses: Sequence[Array]) -> Array:
        """Return what u of the stages below n adds to stage n, directly and through stage n + 1.

        ``inverses`` as of ``Factors``.
        """
        given = applied(self.forced[n], u[n - 1][:, None], self.size(n))
        if n > 1:
            given += applied(self.paired[n], u[n - 2][:, None], self.size(n))
        if n < self.top:
            # What u_(n−1) makes of stage n + 1 without u_n comes back to stage n.
            beyond = applied(self.paired[n + 1], u[n - 1][:, None], self.size(n + 1))
            given -= applied(self.above[n], inverses[n + 1] @ beyond, self.size(n))
        return np.asarray(given[:, 0])

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
