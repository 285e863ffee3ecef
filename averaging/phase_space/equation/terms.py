"""Blocks of the matrix of the equations: sums of Kronecker products between groups of unknowns."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from fpk.arrays import Array

Entries = tuple[NDArray[np.int32], NDArray[np.int32], Array]
"""Rows, columns and values of entries of a matrix."""


@dataclass(frozen=True)
class Group:
    """Unknowns of a level with one degree in the others: ``count`` of k times ``functions`` of y.

    ``start`` is the first of them among those of the stage of the elimination (``Chain``).
    """

    start: int
    count: int
    functions: int

    @property
    def size(self) -> int:
        """How many they are."""
        return self.count * self.functions

    @property
    def span(self) -> slice:
        """Where they stand among the unknowns of the stage."""
        return slice(self.start, self.start + self.size)


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

    def entries(self) -> Iterator[Entries]:
        """Yield rows, columns and values of entries of the term that are not 0."""
        to, of, degrees = self.to, self.of, self.degrees
        if isinstance(degrees, float):
            degrees = degrees * np.eye(to.count)
        if self.functions is None:
            first = second = np.arange(min(to.functions, of.functions))[:, None]
            block = np.ones((len(first), 1))
        else:
            first, second = np.ix_(*map(np.arange, self.functions.shape))
            block = self.functions
        i, j = np.nonzero(degrees)
        shape = (i.size, *block.shape)
        row, column = (np.empty(shape, dtype=np.int32) for _ in range(2))
        row[:] = (to.start + to.functions * i)[:, None, None] + first
        column[:] = (of.start + of.functions * j)[:, None, None] + second
        values = degrees[i, j][:, None, None] * block
        yield row.ravel(), column.ravel(), values.ravel()

    def add_block_to(self, D: Array) -> None:
        """Add the block itself to a matrix (equations, unknowns) of the two groups."""
        to, of, degrees = self.to, self.of, self.degrees
        if isinstance(degrees, float):
            degrees = degrees * np.eye(to.count)
        whole = D.reshape(to.count, to.functions, of.count, of.functions)
        if self.functions is None:
            each = np.arange(min(to.functions, of.functions))
            whole[:, each, :, each] += degrees
        else:
            whole += degrees[:, None, :, None] * self.functions[:, None]


@dataclass(frozen=True, eq=False)
class Sum:
    """A block of many terms between all unknowns of two stages, whose sum is made to use it.

    Dense linear algebra is faster than the many small products; the matrix is not kept, as those of
    all blocks together would fill the memory.
    """

    to: Group
    of: Group
    terms: Sequence[Term]

    def add_to(self, out: Array, X: Array) -> None:
        """Add the sum times X (unknowns, columns) to ``out`` (equations, columns)."""
        A = np.zeros((self.to.size, self.of.size), X.real.dtype)
        self.add_block_to(A)
        out += A @ X

    def entries(self) -> Iterator[Entries]:
        """Yield rows, columns and values of entries of the terms."""
        for term in self.terms:
            yield from term.entries()

    def add_block_to(self, D: Array) -> None:
        """Add the sum itself to a matrix (equations, unknowns)."""
        add_matrix(D, self.terms)


Terms = Sequence[Term | Sum]


def applied(terms: Terms, X: Array, size: int) -> Array:
    """Return the matrix (``size``, unknowns) of terms times X (unknowns, columns)."""
    out = np.zeros((size, X.shape[1]), X.dtype)
    for term in terms:
        term.add_to(out, X)
    return out


def applied_from_right(X: Array, terms: Terms, size: int) -> Array:
    """Return X (rows, equations) times the matrix (equations, ``size``) of terms.

    Terms of the same groups are to follow each other: they make one product of dense matrices.
    """
    out = np.zeros((X.shape[0], size), X.dtype)
    for (to, of), same in groupby(terms, lambda term: (term.to, term.of)):
        D = np.zeros((to.size, of.size), X.dtype)
        for term in same:
            term.add_block_to(D)
        out[:, of.span] += X[:, to.span] @ D
    return out


def add_matrix(A: Array, terms: Terms) -> None:
    """Add terms to a matrix (equations, unknowns)."""
    for term in terms:
        term.add_block_to(A[term.to.span, term.of.span])
