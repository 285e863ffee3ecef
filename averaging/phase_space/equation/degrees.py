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

from averaging.phase_space.equation.frame import POWER, Frame
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


def first_degrees(frame: Frame) -> Degrees:
    """Return the degrees of the first solution."""
    total = 13 if frame.n == 2 else 11
    return degrees_to(frame, total, total)


def degrees_to(frame: Frame, total: int, others: int) -> Degrees:
    """Return degrees with the highest level ``total``, and up to ``others`` in the other masses."""
    return Degrees(total, min(others, total // frame.n), total + 1)


def next_degrees(frame: Frame, degrees: Degrees, others: int) -> Degrees:
    """Return degrees with about a quarter more levels: 13, 17, 21, 27, 33, 41, …

    ``others``: see ``degrees_to``. All totals are odd, since errors of even ones differ.
    """
    return degrees_to(frame, degrees.total + 2 * round(0.125 * degrees.total), others)


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

    def integral(self, along: Sequence[Array] | Array = ()) -> Array:
        """Return the integrals (degrees,) of the functions (``chain``) over all ζ.

        If orthonormal directions ``along`` (d,) are given, the function is 1 in the components of
        ζ along them, and integrals are over the others only.
        """
        # ∂ 1 = 0 is (σ a − (1 − σ) a⁺) s = 0 for the integrals s, solved by exp(½ ρ a⁺²) 1.
        squares = [A @ A for A in self.up]
        squares += [-1.0 * (A @ A) for A in (combination(self.up, e) for e in along)]
        raise_two = (0.5 * (1.0 - POWER) / POWER) * sum(squares[1:], squares[0])
        term = total = np.eye(self.level.size, 1)[:, 0]
        for half in range(1, int(self.level[-1]) // 2 + 1):
            term = raise_two @ term / half
            total = total + term
        return np.asarray(total)

    @cached_property
    def first_moments(self) -> tuple[Array, Array, Array]:
        """Integrals of the functions times 1, ζ_i and ζ_i ζ_j over all ζ.

        (degrees,), (d, degrees) and (d, d, degrees). For the integrals s of the functions a s is
        a⁺ s (1 − σ)/σ, so that multiplication by ζ = a + a⁺ is a⁺/σ.
        """
        s = self.integral()
        first = np.array([A @ s for A in self.up]) / POWER
        second = np.array([[A @ v for v in first] for A in self.up]) / POWER
        return s, first, second + np.multiply.outer(np.eye(len(first)), s) / POWER


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
