"""Degrees of the Hermite polynomials, and the operators between them.

With the contact mass held, the others are oscillators: one for each, of a complex amplitude
b = (ζ_v + i ζ_x)/√2, which turns. The Hermite polynomials of degree m in ζ_v and ζ_x are, in other
combinations, those of degree j in b and k in its conjugate, j + k = m: their real and imaginary
parts turn j − k times as fast as b, and those that turn fast are small. A product therefore counts
by the larger one of j and k, not by j + k: half the products then reach as high a degree in the
energy of the oscillator, where j = k.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fpk.numeric.arrays import Array

Indices = NDArray[np.intp]
Matrix = sparse.csr_array


@dataclass(frozen=True, eq=False)
class Space:
    """Degrees up to a level, and in the variables of the others up to a count; of ``space_to``.

    In ascending order of, for each degree (degrees,), its ``level`` |k|, the sum ``others`` of its
    degrees in the others, and the sum ``counted`` over all oscillators of the larger one of the
    degrees in b and in its conjugate. ``raising_others`` is a_i⁺ of each variable of the
    others on their products alone, of which a level has the first ones.
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
        """a_j⁺ of each variable (degrees, degrees), the contact velocity first.

        What leads out of the degrees is left out; the transposed matrix is a_j.
        """
        size, up = self.level.size, []
        spans = [self.span(n) for n in range(int(self.level[-1]) + 1)]
        for A in (None, *self.raising_others):
            parts = [(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))]
            for n, (of, to) in enumerate(pairwise(spans)):
                count = of.stop - of.start
                if A is None:
                    k = np.arange(count)
                    parts.append((to.start + k, of.start + k, np.sqrt(n - self.others[of] + 1.0)))
                    continue
                inside = A.col < count
                row, column = to.start + A.row[inside], of.start + A.col[inside]
                parts.append((row, column, A.data[inside]))
            row, column, values = (np.concatenate(x) for x in zip(*parts, strict=True))
            up.append(Matrix((values, (row, column)), shape=(size, size)))
        return tuple(up)

    def raising(self, e: Array) -> Matrix:
        """Return Σ_j e_j a_j⁺."""
        return combined(self.up, e)

    @cached_property
    def first_and_second(self) -> tuple[Array, Array]:
        """a_i⁺ 1 (d, degrees of level 1) and a_i⁺ a_j⁺ 1 (d, d, degrees of level 2).

        With them ∫ ζ_i p dζ and ∫ ζ_i ζ_j p dζ are products with the coefficients of levels 1 and
        2; to the second level 0 adds δ_ij.
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

    def order(k: Product) -> tuple[int, int, Product, bool]:
        """By the sum, then by what counts; the conjugate of a product follows it."""
        return sum(k), counted(k), max(k, conjugate(k)), k < conjugate(k)

    every = product(range(most + 1), repeat=d - 1)
    products = sorted((k for k in every if counted(k) <= most), key=order)
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
    level, at = (
        np.repeat(np.arange(total + 1), sizes),
        np.concatenate([np.arange(n) for n in sizes]),
    )
    return Space(level, sums[at], counts[at], tuple(raising))
