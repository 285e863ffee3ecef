"""Blocks of the matrix of the equations: sums of Kronecker products between groups of unknowns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fpk.arrays import Array


@dataclass(frozen=True)
class Group:
    """Unknowns of a level with one degree in the others: ``count`` of k times ``functions`` of y.

    ``start`` is the first of them among those of the stage of the elimination (``Chain``).
    """

    start: int
    count: int
    functions: int

    @property
    def span(self) -> slice:
        """Where they stand among the unknowns of the stage."""
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
        """Add the term itself to a matrix (equations, unknowns)."""
        to, of, degrees = self.to, self.of, self.degrees
        if isinstance(degrees, float):
            degrees = degrees * np.eye(to.count)
        whole = A[to.span, of.span].reshape(to.count, to.functions, of.count, of.functions)
        if self.functions is None:
            each = np.arange(min(to.functions, of.functions))
            whole[:, each, :, each] += degrees
        else:
            whole += degrees[:, None, :, None] * self.functions[:, None]


@dataclass(frozen=True, eq=False)
class Sum:
    """A block of many terms, from ``of`` unknowns to ``to`` equations, whose sum is made to use it.

    A product with many columns takes the whole matrix, as dense linear algebra is faster than the
    many small products; it is not kept, as all blocks together would fill the memory.
    """

    to: int
    of: int
    terms: Sequence[Term]

    def transposed(self) -> "Sum":
        """The sum of the transposed matrix."""
        return Sum(self.of, self.to, [t.transposed() for t in self.terms])

    def add_to(self, out: Array, X: Array) -> None:
        """Add the sum times X (unknowns, columns) to ``out`` (equations, columns)."""
        if X.shape[1] > 1:
            A = np.zeros((self.to, self.of), X.real.dtype)
            self.add_matrix_to(A)
            out += A @ X
        else:
            for term in self.terms:
                term.add_to(out, X)

    def add_matrix_to(self, A: Array) -> None:
        """Add the sum itself to a matrix (equations, unknowns)."""
        for term in self.terms:
            term.add_matrix_to(A)


Terms = Sequence[Term | Sum]


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
