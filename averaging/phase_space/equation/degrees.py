"""Degrees of the Hermite polynomials, numbers of functions of y for each, and ladder operators.

With the contact mass at rest each other mass is an oscillator of complex amplitude
b = (ζ_v + i ζ_x)/√2. The coefficients of products of degree j in b and k in its conjugate are small
if the product rotates fast; so products are selected by max(j, k), not by j + k (docs/theory.md).
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
"""Smallest number of polynomials beyond a stop over the largest: for degrees in the contact
velocity alone, and for all degrees."""
POLYNOMIALS_PER_DEGREE = 1.2
"""Decrease of the number of polynomials beyond a stop for each degree in the other variables."""

Indices = NDArray[np.intp]
Matrix = sparse.csr_array


@dataclass(frozen=True)
class Degrees:
    """Degrees of an expansion.

    ``total`` is the largest level, the sum |k| of the degrees of a Hermite polynomial; ``others``
    the largest Σ max(j, k) over the other masses, j and k the degrees in an amplitude and its
    conjugate; ``outer`` the number of polynomials in y beyond the last stop at level 0.
    """

    total: int
    others: int
    outer: int

    @property
    def least(self) -> int:
        """Smallest number of polynomials beyond a stop."""
        return int(LEAST_MIXED * self.outer)

    def beyond(self, level: int, others: int) -> int:
        """Return the number of polynomials beyond a stop at |k| = ``level``.

        ``others`` is Σ (j + k), see ``Space``. Levels 2m and 2m + 1 have equal numbers, as
        the functions of the second are derivatives of the functions of the first.
        """
        alone = max(self.outer - level // 2 * 2, int(LEAST * self.outer))
        return max(alone - int(POLYNOMIALS_PER_DEGREE * others), self.least)

    def between(self, width: float, *, beyond: bool) -> int:
        """Return the number, odd, of polynomials on a panel between stops.

        ``width`` is the panel's in standard deviations of the weight without stops; ``beyond`` says
        that a stop is touched on it. The number rises with ``outer``, up to ``outer`` + 2, so that
        distances of successive solutions contain the error on this panel.
        """
        count = 6.0 + (0.12 * width + 0.25 * beyond) * self.outer
        return 2 * ceil(0.5 * min(count, self.outer)) + 1

    def fewer(self, most: int, beyond: int) -> int:
        """Return the odd number of polynomials between stops for ``beyond`` beyond a stop.

        It is about ½ (1 + ``beyond``/``outer``) times ``most``, the number at ``outer``.
        """
        return 2 * int(0.25 * most * (1.0 + beyond / self.outer)) + 1


def fitting_degrees(frame: Frame) -> Degrees:
    """Return the degrees of the solutions that the reference is fitted to."""
    if frame.system.damping_terms:
        return lowest(frame)
    return Degrees(13, 5, 14) if frame.n == 2 else Degrees(9, 3, 10)


def lowest(frame: Frame) -> Degrees:
    """Return the degrees of the first solution."""
    if frame.system.damping_terms:
        return Degrees(16, 6, 18) if frame.n == 2 else Degrees(11, 4, 12)
    return Degrees(17, 6, 18) if frame.n == 2 else Degrees(11, 4, 12)


def next_degrees(frame: Frame, degrees: Degrees, rise: int) -> Degrees:
    """Return the degrees of the next solution after ``degrees``.

    For two masses ``rise`` is added to ``others``, for three at most 1. With damping terms it has
    no effect: ``total`` rises by a quarter and gives the others, since errors oscillate with the
    degree.
    """
    d = degrees
    if frame.system.damping_terms:
        half = round(0.625 * d.total)
        return Degrees(2 * half, round(0.75 * half), half + 10)
    if frame.n == 2:
        return Degrees(d.total + 10 - 2 * rise, d.others + rise, d.outer + 4)
    # Errors of three masses come from the degree in the others.
    step = 1 if rise else 2
    return Degrees(d.total + 2 * step, d.others + min(rise, 1), d.outer + step)


@dataclass(frozen=True, eq=False)
class Space:
    """The degrees k of an expansion, ascending in ``level``, ``others`` and ``counted`` (degrees,).

    ``level`` is |k|, ``others`` Σ (j + k) and ``counted`` Σ max(j, k) over the other masses.
    ``raising_others`` are the a_i⁺ of the other variables on the products of their degrees, sorted
    by Σ (j + k); level n takes the first of these, up to the sum n.
    """

    level: Indices
    others: Indices
    counted: Indices
    raising_others: tuple[sparse.coo_array, ...]

    def span(self, n: int) -> slice:
        """Return the slice of the degrees of level ``n``."""
        return slice(*map(int, np.searchsorted(self.level, [n, n + 1])))

    @cached_property
    def up(self) -> tuple[Matrix, ...]:
        """a_j⁺ of each ζ_j, contact velocity first, (degrees, degrees); the transpose is a_j."""
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

        Multiplied by the coefficients they give ∫ ζ_i p dζ, and ∫ ζ_i ζ_j p dζ less δ_ij times
        level 0.
        """
        one = np.eye(self.level.size, 1)
        first = [A @ one for A in self.up]
        second = [[(A @ v)[self.span(2), 0] for v in first] for A in self.up]
        return np.array(first)[:, self.span(1), 0], np.array(second)


def combination(matrices: Sequence[Matrix], factors: Array) -> Matrix:
    """Return the sum of ``matrices``, each times one of ``factors``."""
    terms = (c * A for c, A in zip(factors, matrices, strict=True) if c)
    return sum(terms, Matrix(matrices[0].shape))


@lru_cache(maxsize=8)
def space_to(total: int, most: int, d: int) -> Space:
    """Return the degrees of ``d`` variables up to level ``total``.

    Products have degrees (j₁, k₁, j₂, k₂, …) in the amplitudes of the other masses and their
    conjugates, with Σ max(j, k) <= ``most``. The two variables of an oscillator are adjacent.
    """
    Product = tuple[int, ...]

    def counted(k: Product) -> int:
        return sum(map(max, zip(k[::2], k[1::2], strict=True)))

    def conjugate(k: Product) -> Product:
        return tuple(x for pair in zip(k[1::2], k[::2], strict=True) for x in pair)

    every = product(range(most + 1), repeat=d - 1)
    # Sorted by Σ (j + k), then by Σ max(j, k); the conjugate of a product follows it.
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
        # √(k + 1) from each product to the product with degree k + 1 in one amplitude.
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
