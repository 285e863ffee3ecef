"""Products of the Hermite polynomials in the variables of the other masses, by what they count.

With the contact mass held, the others are oscillators: one for each, of a complex amplitude
b = (ζ_v + i ζ_x)/√2, which turns. The Hermite polynomials of degree m in ζ_v and ζ_x are, in other
combinations, those of degree j in b and k in its conjugate, j + k = m: their real and imaginary
parts turn j − k times as fast as b, and those that turn fast are small. A product therefore counts
by the larger one of j and k, not by j + k: half the products then reach as high a degree in the
energy of the oscillator, where j = k.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fpk.arrays import Array, Complexes

Indices = NDArray[np.intp]
Matrix = sparse.csr_array


@dataclass(frozen=True, eq=False)
class Others:
    """Products of degrees in the variables other than the contact velocity, of one sum ``total``.

    ``counted`` (count,), ascending, is the sum over all oscillators of the larger one of the
    degrees in b and in its conjugate. ``raising[i]`` (count of the next sum, count) is a_i⁺ of
    variable i, less what leads out of the set; there is none in the highest sum.
    """

    total: int
    counted: Indices
    raising: tuple[Array, ...]

    @property
    def count(self) -> int:
        """Number of products."""
        return int(self.counted.size)


@lru_cache(maxsize=4)
def others_to(most: int, d: int) -> tuple[Others, ...]:
    """Return the products in ``d`` variables less the first that count ``most`` or less, by sums.

    The variables of an oscillator follow each other.
    """
    modes = d // 2
    highest = 2 * most if modes else 0
    every = [k for k in product(range(most + 1), repeat=2 * modes) if _counted(k) <= most]
    sets: list[list[Product]] = [[] for _ in range(highest + 1)]
    for k in sorted(every, key=_counted):
        if k >= (conjugate := _conjugate(k)):
            sets[sum(k)] += dict.fromkeys((k, conjugate))
    real = [_real(products) for products in sets]
    out = []
    for total, products in enumerate(sets):
        raising: list[Array] = []
        for mode in range(modes if total < highest else 0):
            plus, minus = (
                real[total + 1].conj().T @ _raised_in(2 * mode + k, products, sets[total + 1])
                for k in range(2)
            )
            pair = (plus + minus) / np.sqrt(2.0), (plus - minus) / (1j * np.sqrt(2.0))
            raising += [np.ascontiguousarray((A @ real[total]).real) for A in pair]
        counted = np.array([_counted(k) for k in products], dtype=np.intp)
        out.append(Others(total, counted, tuple(raising)))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class Space:
    """Degrees up to a level and to a count in the others, level by level.

    Of each: its ``level``, the sum ``others`` of the degrees in the others, and what it is
    ``counted`` there. ``up[j]`` (count, count) is a_j⁺, less what leads out of them.
    """

    level: Indices
    others: Indices
    counted: Indices
    up: tuple[Matrix, ...]

    @classmethod
    def to(cls, total: int, others: int, d: int) -> "Space":
        """Return the degrees up to level ``total``, in the others up to the count ``others``."""
        sets = others_to(others, d)
        groups = [(n, m) for n in range(total + 1) for m in range(min(n + 1, len(sets)))]
        counts = [sets[m].count for _, m in groups]
        start = dict(zip(groups, np.cumsum([0, *counts[:-1]]).tolist(), strict=True))
        raising = [[sparse.coo_array(A) for A in o.raising] for o in sets]
        up = []
        for j in range(d):
            parts = [(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))]
            for (n, m), first in start.items():
                above = start.get((n + 1, m + (j > 0)))
                if above is not None and j == 0:
                    k = np.arange(sets[m].count)
                    parts.append((above + k, first + k, np.full(k.size, np.sqrt(n - m + 1.0))))
                elif above is not None:
                    A = raising[m][j - 1]
                    parts.append((above + A.row, first + A.col, A.data))
            row, column, values = (np.concatenate(x) for x in zip(*parts, strict=True))
            up.append(Matrix((values, (row, column)), shape=2 * (sum(counts),)))
        level, sums = np.repeat(np.array(groups, dtype=np.intp), counts, axis=0).T
        return cls(level, sums, np.concatenate([sets[m].counted for _, m in groups]), tuple(up))


def combined(matrices: Sequence[Matrix], factors: Array) -> Matrix:
    """Return the sum of ``matrices`` times ``factors``."""
    terms = (c * A for c, A in zip(factors, matrices, strict=True) if c)
    return sum(terms, Matrix(matrices[0].shape))


Product = tuple[int, ...]
"""Degrees (j₁, k₁, j₂, k₂, …) in the amplitudes and their conjugates."""


def _counted(k: Product) -> int:
    return sum(map(max, zip(k[::2], k[1::2], strict=True)))


def _conjugate(k: Product) -> Product:
    return tuple(x for pair in zip(k[1::2], k[::2], strict=True) for x in pair)


def _real(products: list[Product]) -> Complexes:
    """Real and imaginary parts, times √2, of the products: the columns of a unitary matrix.

    A product and its conjugate follow each other.
    """
    out = np.eye(len(products), dtype=complex)
    for row, (k, following) in enumerate(pairwise(products)):
        if k > following == _conjugate(k):
            pair = slice(row, row + 2)
            out[pair, pair] = np.sqrt(0.5) * np.array([[1.0, -1j], [1.0, 1j]])
    return out


def _raised_in(amplitude: int, products: list[Product], above: list[Product]) -> Complexes:
    """√(k + 1) from each product to that of a degree k more in one amplitude, if it is there."""
    place = {k: row for row, k in enumerate(above)}
    out = np.zeros((len(above), len(products)), dtype=complex)
    for column, k in enumerate(products):
        row = place.get((*k[:amplitude], k[amplitude] + 1, *k[amplitude + 1 :]))
        if row is not None:
            out[row, column] = np.sqrt(k[amplitude] + 1.0)
    return out


def first_and_second(others: tuple[Others, ...], d: int) -> tuple[Array, Array]:
    """Return a_i⁺ 1 (d, count of level 1) and a_i⁺ a_j⁺ 1 (d, d, count of level 2).

    With them ∫ ζ_i p dζ and ∫ ζ_i ζ_j p dζ are products with what levels 1 and 2 have of p; to the
    second level 0 adds δ_ij.
    """
    units = np.eye(d)
    first = [raised(others, 0, np.ones(1), e) for e in units]
    return np.array(first), np.array([[raised(others, 1, v, e) for v in first] for e in units])


def lowered(others: tuple[Others, ...], level: int, v: Array, e: Array) -> Array:
    """Return Σ_i e_i a_i v, for ``level``, of coefficients v of the level above."""
    highest = len(others) - 1
    parts = np.split(v, np.cumsum([o.count for o in others[: level + 2]])[:-1])
    out = [e[0] * np.sqrt(level - m + 1.0) * part for m, part in enumerate(parts[: level + 1])]
    for m in range(min(level, highest - 1) + 1):
        for a, A in zip(e[1:], others[m].raising, strict=True):
            out[m] = out[m] + a * (A.T @ parts[m + 1])
    return np.concatenate(out)


def raised(others: tuple[Others, ...], level: int, v: Array, e: Array) -> Array:
    """Return Σ_i e_i a_i⁺ v of coefficients v (count of ``level``, ...), for the level above.

    A level has its products by their sum in the others, in the order of ``others``.
    """
    highest = len(others) - 1
    parts = np.split(v, np.cumsum([o.count for o in others[: level + 1]])[:-1])
    out = [e[0] * np.sqrt(level - m + 1.0) * part for m, part in enumerate(parts)]
    if level < highest:
        out.append(np.zeros((others[level + 1].count, *v.shape[1:])))
    for m in range(min(level, highest - 1) + 1):
        for a, A in zip(e[1:], others[m].raising, strict=True):
            out[m + 1] = out[m + 1] + a * (A @ parts[m])
    return np.concatenate(out)
