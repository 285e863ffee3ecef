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

from fpk.arrays import Array

Indices = NDArray[np.intp]
Matrix = sparse.csr_array


@dataclass(frozen=True, eq=False)
class Space:
    """Degrees up to a level, and in the ``d`` − 1 variables of the others up to a count.

    In ascending order of, for each degree (degrees,), its ``level`` |k|, the sum ``others`` of its
    degrees in the others, and the sum ``counted`` over all oscillators of the larger one of the
    degrees in b and in its conjugate. Made by ``space_to``.
    """

    d: int
    most: int
    level: Indices
    others: Indices
    counted: Indices

    def span(self, n: int) -> slice:
        """Where the degrees of level n stand."""
        return slice(*np.searchsorted(self.level, [n, n + 1]))

    @cached_property
    def up(self) -> tuple[Matrix, ...]:
        """a_j⁺ of each variable (degrees, degrees), the contact velocity first.

        What leads out of the degrees is left out; the transposed matrix is a_j.
        """
        sets, size = _products(self.most, self.d), self.level.size
        starts = np.flatnonzero(np.diff(self.level * len(sets) + self.others, prepend=-1))
        firsts = {(self.level[at], self.others[at]): at for at in starts}
        up = []
        for j in range(self.d):
            parts = [(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))]
            for (n, m), first in firsts.items():
                above = firsts.get((n + 1, m + (j > 0)))
                if above is not None and j == 0:
                    k = np.arange(sets[m][0].size)
                    parts.append((above + k, first + k, np.full(k.size, np.sqrt(n - m + 1.0))))
                elif above is not None:
                    A = sets[m][1][j - 1]
                    parts.append((above + A.row, first + A.col, A.data))
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


@lru_cache(maxsize=8)
def space_to(total: int, most: int, d: int) -> Space:
    """Return the degrees up to level ``total``, in the others up to the count ``most``."""
    sets = _products(most, d)
    groups = [(n, m) for n in range(total + 1) for m in range(min(n + 1, len(sets)))]
    sizes = [sets[m][0].size for _, m in groups]
    level, others = np.repeat(np.array(groups, dtype=np.intp), sizes, axis=0).T
    return Space(d, most, level, others, np.concatenate([sets[m][0] for _, m in groups]))


def combined(matrices: Sequence[Matrix], factors: Array) -> Matrix:
    """Return the sum of ``matrices`` times ``factors``."""
    terms = (c * A for c, A in zip(factors, matrices, strict=True) if c)
    return sum(terms, Matrix(matrices[0].shape))


@lru_cache(maxsize=4)
def _products(most: int, d: int) -> list[tuple[Indices, list[sparse.coo_array]]]:
    """Products of degrees (j₁, k₁, j₂, k₂, …) in amplitudes and conjugates, by their sum.

    Of each sum: what its products count, ascending, up to ``most``, and a_i⁺ of each variable to
    those of the next sum. The variables of an oscillator follow each other.
    """
    modes = d // 2
    highest = 2 * most if modes else 0

    def counted(k: tuple[int, ...]) -> int:
        return sum(map(max, zip(k[::2], k[1::2], strict=True)))

    def conjugate(k: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(x for pair in zip(k[1::2], k[::2], strict=True) for x in pair)

    every = [k for k in product(range(most + 1), repeat=2 * modes) if counted(k) <= most]
    sets: list[list[tuple[int, ...]]] = [[] for _ in range(highest + 1)]
    for k in sorted(every, key=counted):
        if k >= conjugate(k):
            sets[sum(k)] += dict.fromkeys((k, conjugate(k)))
    # Real and imaginary parts, times √2, of a product and its conjugate, which follows it.
    real = [np.eye(len(products), dtype=complex) for products in sets]
    for R, products in zip(real, sets, strict=True):
        for row, (k, following) in enumerate(pairwise(products)):
            if k > following == conjugate(k):
                pair = slice(row, row + 2)
                R[pair, pair] = np.sqrt(0.5) * np.array([[1.0, -1j], [1.0, 1j]])
    out = []
    for total, products in enumerate(sets):
        raised = []
        for a in range(2 * modes if total < highest else 0):
            # √(k + 1) from each product to that of a degree k more in one amplitude.
            place = {k: row for row, k in enumerate(sets[total + 1])}
            A = np.zeros((len(place), len(products)), dtype=complex)
            for column, k in enumerate(products):
                if (above := (*k[:a], k[a] + 1, *k[a + 1 :])) in place:
                    A[place[above], column] = np.sqrt(k[a] + 1.0)
            raised.append(real[total + 1].conj().T @ A @ real[total])
        raising = []
        for plus, minus in zip(raised[::2], raised[1::2], strict=True):
            raising.append(sparse.coo_array((plus + minus).real / np.sqrt(2.0)))
            raising.append(sparse.coo_array((plus - minus).imag / np.sqrt(2.0)))
        out.append((np.array([counted(k) for k in products], dtype=np.intp), raising))
    return out
