"""The FPK equation as a chain of levels of Hermite functions.

The density is p = w(y) N(z; 0, S) Σ_k u_k(y) He_k(C⁻¹ z)/√k!, S = C Cᵀ, z = (v, x) as in ``frame``.
With a_i He_k = √k_i He_(k−e_i) and a_i⁺ its adjoint, Galerkin's method in L²(w N) turns Eq. (6)
into

    Σ_ij F'_ij a_i⁺ a_j u + Σ_ij (½ (F' + F'ᵀ) + G')_ij a_i⁺ a_j⁺ u
        + Σ_i h'_i(y) a_i⁺ u + Σ_i l_i (a_i + a_i⁺) ∂* u = 0,

F' = C⁻¹ F C, G' = C⁻¹ G C⁻ᵀ, h' = C⁻¹ h, z₁ = l·C⁻¹ z, ∂* the adjoint of ∂/∂y in L²(w). C is lower
triangular, so that z₁ has one term. A level is all k of one sum: it meets itself, the two below and
the one above. Where S is not that of the linear part alone the second term is not zero.

Levels of even degree have continuous functions of y, those of odd degree broken ones (``Basis``).
∂* connects the two only; for a broken f and a continuous u, (f, ∂* u) is −(f, u' + (ln w)' u).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from averaging.phase_space.basis import Basis
from averaging.phase_space.degrees import Degrees, Others, others_to
from averaging.phase_space.frame import Frame, Reference, linear_part
from fpk.arrays import Array


@dataclass(frozen=True)
class Group:
    """Unknowns of a level with one degree in the others: ``count`` of k times ``functions`` of y.

    ``start`` is the first of them among those of the level.
    """

    start: int
    count: int
    functions: int

    @property
    def span(self) -> slice:
        """Where they stand among the unknowns of the level."""
        return slice(self.start, self.start + self.count * self.functions)


@dataclass(frozen=True, eq=False)
class Term:
    """A block of the matrix of the equations, from unknowns of one group to equations of another.

    The groups are ``of`` and ``to``; the block is a Kronecker product. ``degrees`` acts on k,
    (count, count) or a multiple of the unit matrix, ``functions`` on functions of y, (functions,
    functions) or None for those that both groups have, unchanged.
    """

    to: Group
    of: Group
    degrees: Array | float
    functions: Array | None = None

    def transposed(self) -> "Term":
        """The term of the transposed matrix."""
        degrees = self.degrees if isinstance(self.degrees, float) else self.degrees.T
        functions = None if self.functions is None else self.functions.T
        return Term(self.of, self.to, degrees, functions)

    def add_to(self, out: Array, X: Array) -> None:
        """Add the term times X (unknowns, columns) to ``out`` (equations, columns)."""
        part = X[self.of.span].reshape(self.of.count, self.of.functions, -1)
        if self.functions is not None:
            part = np.matmul(self.functions.astype(X.real.dtype, copy=False), part)
        common = min(part.shape[1], self.to.functions)
        part = part[:, :common]
        if isinstance(self.degrees, float):
            part = self.degrees * part
        else:
            part = np.tensordot(self.degrees.astype(X.real.dtype, copy=False), part, axes=1)
        whole = out[self.to.span].reshape(self.to.count, self.to.functions, -1)
        whole[:, :common] += part

    def add_matrix_to(self, A: Array) -> None:
        """Add the term itself to a matrix (equations, unknowns).

        It is of functions unchanged, or of a multiple of the unit matrix on k.
        """
        to, of = self.to, self.of
        whole = A[to.span, of.span].reshape(to.count, to.functions, of.count, of.functions)
        if self.functions is None:
            each = np.arange(min(to.functions, of.functions))
            whole[:, each, :, each] += self.degrees
        else:
            k = np.arange(to.count)
            whole[k, :, k] += self.degrees * self.functions


Terms = Sequence[Term]


def applied(terms: Terms, X: Array, size: int) -> Array:
    """Return the matrix (``size``, unknowns) of terms times X (unknowns, columns)."""
    out = np.zeros((size, X.shape[1]), X.dtype)
    for term in terms:
        term.add_to(out, X)
    return out


def applied_from_right(X: Array, terms: Terms, size: int) -> Array:
    """Return X (rows, equations) times the matrix (equations, ``size``) of terms."""
    transposed = applied([t.transposed() for t in terms], np.ascontiguousarray(X.T), size)
    return np.ascontiguousarray(transposed.T)


@dataclass(frozen=True, eq=False)
class Chain:
    """The equations between levels: of each level what it meets in itself and in the others.

    ``factor`` C. ``groups[n]`` are the unknowns of level n by their degree in the others. Level n
    meets itself by ``own[n]``, level n + 1 by ``above[n]``, level n − 1 by ``forced[n]`` and
    n − 2 by ``paired[n]``. The highest level of each degree in the others meets itself by
    l₁ (∂* ∂)^½, too, which stands for the levels above it.
    """

    factor: Array
    others: tuple[Others, ...]
    groups: tuple[tuple[Group, ...], ...]
    own: tuple[Terms, ...]
    above: tuple[Terms, ...]
    forced: tuple[Terms, ...]
    paired: tuple[Terms, ...]

    @classmethod
    def of(cls, frame: Frame, reference: Reference, functions: Basis, degrees: Degrees) -> "Chain":
        """Return the equations about a reference in the functions of a basis."""
        F, G, h = linear_part(frame, reference)
        C = np.asarray(np.linalg.cholesky(reference.covariance), dtype=float)
        inverse = np.linalg.inv(C)
        drift, noise = inverse @ F @ C, inverse @ G @ inverse.T
        pair = 0.5 * (drift + drift.T) + noise
        y = functions.points
        force = h[0][:, None] + h[1][:, None] * y
        force[0] -= frame.contact_force(y)
        adjoint, force_by_y = _between_sets(functions, C, inverse @ force)
        top, others = degrees.total, others_to(degrees.others, frame.n * 2 - 1)
        groups = tuple(_groups(functions, degrees, others, n) for n in range(top + 1))
        own, above, forced, paired = [], [], [], []
        for n in range(top + 1):
            own.append(_own(others, drift, groups[n], n))
            up = adjoint[n % 2]
            above.append(
                [
                    Term(to, of, float(np.sqrt(n - m + 1.0)), up[: to.functions, : of.functions])
                    for m, (to, of) in enumerate(zip(groups[n], groups[n + 1], strict=False))
                ]
                if n < top
                else []
            )
            forced.append(_forced(others, force_by_y[n % 2], groups, n) if n else [])
            paired.append(_paired(others, pair, groups, n) if n > 1 else [])
        for m in range(max(map(len, groups))):
            # The level above the highest would have as many functions as the one below it.
            n = max(n for n, level in enumerate(groups) if len(level) > m)
            group, beyond = groups[n][m], _functions(functions, degrees, n - 1, m)
            E = adjoint[n % 2][: group.functions, :beyond]
            U, s, _ = np.linalg.svd(E, full_matrices=False)
            own[n].append(Term(group, group, -float(np.sqrt(n - m + 1.0)), (U * s) @ U.T))
        return cls(
            C,
            others,
            groups,
            tuple(own),
            tuple(above),
            tuple(forced),
            tuple(paired),
        )

    @property
    def top(self) -> int:
        """The highest level."""
        return len(self.groups) - 1

    def size(self, n: int) -> int:
        """Number of unknowns of level n."""
        last = self.groups[n][-1]
        return last.start + last.count * last.functions

    def within(self, n: int, *, shift: complex = 0.0, kind: type = np.float64) -> Array:
        """Return the equations of level n in itself, less ``shift`` times its unknowns.

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
        """Return what u of the levels below n adds to level n, directly and through level n + 1.

        ``inverses`` as of ``Factors``.
        """
        given = applied(self.forced[n], u[n - 1][:, None], self.size(n))
        if n > 1:
            given += applied(self.paired[n], u[n - 2][:, None], self.size(n))
        if n < self.top:
            # What u_(n−1) makes of level n + 1 without u_n comes back to level n.
            beyond = applied(self.paired[n + 1], u[n - 1][:, None], self.size(n + 1))
            given -= applied(self.above[n], inverses[n + 1] @ beyond, self.size(n))
        return np.asarray(given[:, 0])

    def packed(self, n: int, u: Array) -> Array:
        """Return the unknowns of level n in (count, functions), without those it does not have."""
        parts, row = [], 0
        for g in self.groups[n]:
            parts.append(u[row : row + g.count, : g.functions].ravel())
            row += g.count
        return np.concatenate(parts)

    def shaped(self, n: int, u: Array) -> Array:
        """Return unknowns of level n as (count, functions), 0 where a degree has no function."""
        count = sum(o.k.shape[0] for o in self.others[: n + 1])
        out = np.zeros((count, max(g.functions for g in self.groups[n])), u.dtype)
        row = 0
        for g in self.groups[n]:
            out[row : row + g.count, : g.functions] = u[g.span].reshape(g.count, g.functions)
            row += g.count
        return out


def _functions(functions: Basis, degrees: Degrees, n: int, m: int) -> int:
    """Number of functions of y of level n and degree m in the others."""
    return functions.counts[n % 2][degrees.beyond(n, m)]


def _groups(
    functions: Basis, degrees: Degrees, others: tuple[Others, ...], n: int
) -> tuple[Group, ...]:
    groups, start = [], 0
    for m, o in enumerate(others[: degrees.others_at(n) + 1]):
        groups.append(Group(start, o.k.shape[0], _functions(functions, degrees, n, m)))
        start = groups[-1].span.stop
    return tuple(groups)


def _between_sets(
    functions: Basis, C: Array, force: Array
) -> tuple[tuple[Array, Array], tuple[list[Array], list[Array]]]:
    """Return l₁ ∂* and the matrices of a_i⁺, to continuous functions and to broken ones.

    ``force`` h' (d, points).
    """
    w = functions.weights
    value, slope = functions.at_points
    continuous, broken = value @ functions.continuous, value @ functions.broken
    to_continuous = (slope @ functions.continuous).T @ (w[:, None] * broken)
    # The derivative of 1 is 0: with round-off in its place mass would not be conserved.
    one = functions.of_one()
    to_continuous -= np.outer(one, one @ to_continuous)
    descent = slope @ functions.continuous + functions.log_slope()[:, None] * continuous
    to_broken = -broken.T @ (w[:, None] * descent)
    adjoint = (C[0, 0] * to_continuous, C[0, 0] * to_broken)
    forces = (
        [continuous.T @ ((w * f)[:, None] * broken) for f in force],
        [broken.T @ ((w * f)[:, None] * continuous) for f in force],
    )
    for parts, through in zip(forces, adjoint, strict=True):
        parts[0] += through
    return adjoint, forces


def _own(others: tuple[Others, ...], drift: Array, groups: tuple[Group, ...], n: int) -> list[Term]:
    """Return the blocks within level n: F'_ij a_i⁺ a_j."""
    terms = []
    for m, (group, o) in enumerate(zip(groups, others, strict=False)):
        same = drift[0, 0] * (n - m) * np.eye(group.count)
        if m:
            lower = others[m - 1].raising
            for i, up in enumerate(lower):
                for j, down in enumerate(lower):
                    same += drift[i + 1, j + 1] * up @ down.T
        terms.append(Term(group, group, same))
        if m + 1 < len(groups):
            root = np.sqrt(float(n - m))
            up = sum(c * A for c, A in zip(drift[1:, 0], o.raising, strict=True))
            down = sum(c * A.T for c, A in zip(drift[0, 1:], o.raising, strict=True))
            terms.append(Term(groups[m + 1], group, np.asarray(root * up)))
            terms.append(Term(group, groups[m + 1], np.asarray(root * down)))
    return terms


def _forced(
    others: tuple[Others, ...],
    force: list[Array],
    groups: tuple[tuple[Group, ...], ...],
    n: int,
) -> Terms:
    """Return the blocks from unknowns of level n − 1 to equations of level n: h'_i a_i⁺ and ∂*."""
    terms = []
    for m, of in enumerate(groups[n - 1]):
        if m >= len(groups[n]):
            continue
        to = groups[n][m]
        first = force[0][: to.functions, : of.functions]
        terms.append(Term(to, of, float(np.sqrt(n - m)), first))
        if m + 1 < len(groups[n]):
            to = groups[n][m + 1]
            for A, H in zip(others[m].raising, force[1:], strict=True):
                if np.any(H):
                    terms.append(Term(to, of, A, H[: to.functions, : of.functions]))
    return terms


def _paired(
    others: tuple[Others, ...], pair: Array, groups: tuple[tuple[Group, ...], ...], n: int
) -> Terms:
    """Return the blocks from unknowns of level n − 2 to equations of level n: a_i⁺ a_j⁺."""
    terms = []
    for m, of in enumerate(groups[n - 2]):
        alone = n - 1.0 - m
        if m >= len(groups[n]):
            continue
        terms.append(Term(groups[n][m], of, float(pair[0, 0] * np.sqrt(alone * (alone + 1.0)))))
        if m + 1 < len(groups[n]):
            up = sum(c * A for c, A in zip(pair[0, 1:], others[m].raising, strict=True))
            terms.append(Term(groups[n][m + 1], of, np.asarray(2.0 * np.sqrt(alone) * up)))
        if m + 2 < len(groups[n]):
            twice = np.zeros((others[m + 2].k.shape[0], others[m].k.shape[0]))
            for i, first in enumerate(others[m].raising):
                for j, second in enumerate(others[m + 1].raising):
                    twice += pair[i + 1, j + 1] * second @ first
            terms.append(Term(groups[n][m + 2], of, twice))
    return terms
