"""Degrees of the Hermite polynomials and of the functions of y with each, and their operators.

With the contact mass held, each other mass is an oscillator of the amplitude b = (ζ_v + i ζ_x)/√2.
Products are of degrees j in b and k in its conjugate; those that turn fast are small: a product
counts by the larger one of j and k, not by j + k (docs/theory.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise, product
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from averaging.phase_space.equation.frame import Frame
from fpk.numeric.arrays import Array

LEAST, LEAST_MIXED = 0.5, 0.3
"""Least share of polynomials beyond a stop: at levels of the contact velocity alone, and at any."""
FEWER = 1.2
"""Polynomials beyond a stop that each degree in the other variables takes away."""

Indices = NDArray[np.intp]
Matrix = sparse.csr_array


@dataclass(frozen=True)
class Degrees:
    """How fine an expansion is.

    ``total`` is the largest |k|, ``others`` the largest that a product of the other masses counts,
    ``outer`` the number of polynomials in y beyond the last stop.
    """

    total: int
    others: int
    outer: int

    @property
    def least(self) -> int:
        """Least number of polynomials beyond a stop."""
        return int(LEAST_MIXED * self.outer)

    def beyond(self, level: int, others: int) -> int:
        """Number of polynomials beyond a stop, of |k| = ``level`` and a degree in the others.

        Levels go in pairs, as the derivatives of the functions of one are those of the next.
        """
        alone = max(self.outer - level // 2 * 2, int(LEAST * self.outer))
        return max(alone - int(FEWER * others), self.least)

    def between(self, width: float, *, beyond: bool) -> int:
        """Number of polynomials of a panel between stops, odd; one without end has ``outer`` + 1.

        ``width`` is in standard deviations of the weight without stops; ``beyond``: a stop is
        touched there. It rises with ``outer``, so that distances of solutions show its error.
        """
        count = 6.0 + (0.12 * width + 0.25 * beyond) * self.outer
        return 2 * ceil(0.5 * min(count, self.outer)) + 1

    def fewer(self, most: int, beyond: int) -> int:
        """Odd number of ``most`` polynomials between stops; half of it is as ``beyond``."""
        return 2 * int(0.25 * most * (1.0 + beyond / self.outer)) + 1


def fitting(frame: Frame) -> Degrees:
    """Return the degrees of the solutions that a reference is fitted to."""
    if frame.system.damping_terms or frame.n == 1:
        return lowest(frame)
    return Degrees(13, 5, 14) if frame.n == 2 else Degrees(9, 3, 10)


def lowest(frame: Frame) -> Degrees:
    """Return the degrees of the first solution."""
    if frame.system.damping_terms:
        return {1: Degrees(16, 0, 18), 2: Degrees(16, 6, 18), 3: Degrees(11, 4, 12)}[frame.n]
    # Without terms damping and noise of one mass are in proportion: the start is the solution.
    return {1: Degrees(9, 0, 10), 2: Degrees(17, 6, 18), 3: Degrees(11, 4, 12)}[frame.n]


def finer(frame: Frame, degrees: Degrees, rise: int) -> Degrees:
    """Return the degrees of the next solution; ``rise`` is that of the degree in the others.

    ``total`` is odd without damping terms; with them errors oscillate, and it rises by a factor.
    """
    n, d = frame.n, degrees
    if frame.system.damping_terms:
        half = round((0.7 if n == 1 else 0.625) * d.total)
        others, outer = (0, 2 * half + 2) if n == 1 else (round(0.75 * half), half + 10)
        return Degrees(2 * half, others, outer)
    if n == 1:
        return Degrees(d.total + 8, 0, d.outer + 4)
    if n == 2:
        return Degrees(d.total + 10 - 2 * rise, d.others + rise, d.outer + 4)
    # The degree in the others is what errors of three masses come from.
    step = 1 if rise else 2
    return Degrees(d.total + 2 * step, d.others + min(rise, 1), d.outer + step)


@dataclass(frozen=True, eq=False)
class Space:
    """Degrees k, in ascending order of ``level``, ``others`` and ``counted`` (degrees,).

    These are |k|, Σ (j + k) and Σ max(j, k) over the other masses. ``raising_others`` is
    a_i⁺ of the others on their products alone, of which a level has the first.
    """

    level: Indices
    others: Indices
    counted: Indices
    raising_others: tuple[sparse.coo_array, ...]

    def span(self, n: int) -> slice:
        """Where the degrees of level n stand."""
        return slice(*map(int, np.searchsorted(self.level, [n, n + 1])))

    @cached_property
    def up(self) -> tuple[Matrix, ...]:
        """a_j⁺ of each variable within the degrees, the contact velocity first; transposed, a_j."""
        size, up = self.level.size, []
        spans = [self.span(n) for n in range(int(self.level[-1]) + 1)]
        for A in (None, *self.raising_others):
            parts = [(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))]
            for n, (of, to) in enumerate(pairwise(spans)):
                row = column = np.arange(of.stop - of.start)
                values = np.sqrt(n - self.others[of] + 1.0)
                if A is not None:
                    inside = A.col < row.size
                    row, column, values = A.row[inside], A.col[inside], A.data[inside]
                parts.append((to.start + row, of.start + column, values))
            row, column, values = (np.concatenate(x) for x in zip(*parts, strict=True))
            up.append(Matrix((values, (row, column)), shape=(size, size)))
        return tuple(up)

    @cached_property
    def first_and_second(self) -> tuple[Array, Array]:
        """a_i⁺ 1 (d, degrees of level 1) and a_i⁺ a_j⁺ 1 (d, d, degrees of level 2).

        Times the coefficients they are ∫ ζ_i p dζ and ∫ ζ_i ζ_j p dζ, to which level 0 adds δ_ij.
        """
        one = np.eye(self.level.size, 1)
        first = [A @ one for A in self.up]
        second = [[(A @ v)[self.span(2), 0] for v in first] for A in self.up]
        return np.array(first)[:, self.span(1), 0], np.array(second)


def combined(matrices: Sequence[Matrix], factors: Array) -> Matrix:
    """Return the sum of ``matrices`` times ``factors``."""
    terms = (c * A for c, A in zip(factors, matrices, strict=True) if c)
    return sum(terms, Matrix(matrices[0].shape))


@lru_cache(maxsize=8)
def space_to(total: int, most: int, d: int) -> Space:
    """Return the degrees of ``d`` variables up to level ``total``.

    Products of degrees (j₁, k₁, j₂, k₂, …) in the amplitudes of the others and their conjugates
    count up to ``most``. The variables of an oscillator follow each other.
    """
    Product = tuple[int, ...]

    def counted(k: Product) -> int:
        return sum(map(max, zip(k[::2], k[1::2], strict=True)))

    def conjugate(k: Product) -> Product:
        return tuple(x for pair in zip(k[1::2], k[::2], strict=True) for x in pair)

    every = product(range(most + 1), repeat=d - 1)
    # By the sum, then by what counts; the conjugate of a product follows it.
    products = sorted(
        (k for k in every if counted(k) <= most),
        key=lambda k: (sum(k), counted(k), max(k, conjugate(k)), k < conjugate(k)),
    )
    place, size = {k: row for row, k in enumerate(products)}, len(products)
    # Real and imaginary parts, times √2, of a product and its conjugate.
    to_real = sparse.eye_array(size, dtype=complex, format="lil")
    for row, (k, following) in enumerate(pairwise(products)):
        if k > following == conjugate(k):
            to_real[row : row + 2, row : row + 2] = np.sqrt(0.5) * np.array([[1.0, -1j], [1.0, 1j]])
    U, raised, raising = sparse.csr_array(to_real), [], []
    for a in range(d - 1):
        # √(k + 1) from each product to that of a degree k more in one amplitude.
        A = sparse.dok_array((size, size), dtype=complex)
        for column, k in enumerate(products):
            if (above := (*k[:a], k[a] + 1, *k[a + 1 :])) in place:
                A[place[above], column] = np.sqrt(k[a] + 1.0)
        raised.append(U.conj().T @ A.tocsr() @ U)
    for plus, minus in zip(raised[::2], raised[1::2], strict=True):
        for part in ((plus + minus).real, (plus - minus).imag):
            part.eliminate_zeros()
            raising.append((part / np.sqrt(2.0)).tocoo())
    sums, counts = np.array([[sum(k), counted(k)] for k in products], dtype=np.intp).T
    sizes = np.searchsorted(sums, np.arange(total + 1), side="right")
    at = np.concatenate([np.arange(n) for n in sizes])
    return Space(np.repeat(np.arange(total + 1), sizes), sums[at], counts[at], tuple(raising))
