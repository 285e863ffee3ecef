"""The stationary FPK equation as a chain of levels of Hermite functions, eliminated from the top.

The density is p = w(y) N(z; 0, S) Σ_k u_k(y) He_k(C⁻¹ z)/√k!, S = C Cᵀ, z = (v, x) as in ``frame``.
With a_i He_k = √k_i He_(k−e_i) and a_i⁺ its adjoint, Galerkin's method in L²(w N) turns Eq. (6)
into

    Σ_ij F'_ij a_i⁺ a_j u + Σ_ij (½ (F' + F'ᵀ) + G')_ij a_i⁺ a_j⁺ u
        + Σ_i h'_i(y) a_i⁺ u + Σ_i l_i (a_i + a_i⁺) ∂* u = 0,

F' = C⁻¹ F C, G' = C⁻¹ G C⁻ᵀ, h' = C⁻¹ h, z₁ = l·C⁻¹ z, ∂* the adjoint of ∂/∂y in L²(w). C is lower
triangular, so that z₁ has one term. A level is all k of one sum: it meets itself, the two below and
the one above. Where S is not that of the linear part alone the second term is not zero.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from averaging.phase_space.degrees import Indices, Level, levels
from averaging.phase_space.frame import Frame, Reference, linear_part
from averaging.phase_space.panels import Basis, basis
from fpk.arrays import Array

LEAST = 6
"""Least number of polynomials in y on a panel, at the highest levels."""
LEAF = 200
"""Order of a matrix up to which LAPACK inverts it; above, by quarters: products are faster."""


@dataclass(frozen=True)
class Degrees:
    """How fine an expansion is: highest level, degree in all but the contact velocity, panels.

    ``total`` is the largest |k|, ``others`` the largest sum of the degrees in the other velocities
    and in x; ``inner`` and ``outer`` the number of polynomials in y between stops and beyond one.
    """

    total: int
    others: int
    inner: int
    outer: int

    @property
    def counts(self) -> list[tuple[int, int]]:
        """Polynomials of y between stops and beyond one, of each level.

        Motion turns degrees in y into those in the velocity, so that what matters is their sum:
        the higher the level, the fewer polynomials. Level 1 has as many as level 0, whose equations
        it alone makes: with fewer they would be singular. An even number between stops: with an odd
        one there are more even functions than odd ones, and answers converge three times slower.
        """
        beyond = [max(self.outer - max(n - 1, 0), LEAST) for n in range(self.total + 1)]
        return [(min(self.inner, 2 * (count // 2)), count) for count in beyond]


@dataclass(frozen=True, eq=False)
class Expansion:
    """Coefficients of a solution: ``levels[n]`` is (count, functions) of level n, of what is kept.

    ``basis`` has the functions of y, ``factor`` C. ``residual`` is that of the equations of level
    0, into which all others are eliminated, relative to the terms that cancel in them.
    """

    basis: Basis
    factor: Array
    degrees: Degrees
    levels: tuple[Array, ...]
    sets: tuple[Level, ...]
    residual: float

    def functions(self, n: int, y: Array) -> Array:
        """u_k(y) of all k of level n, (count, points)."""
        values, _ = self.basis.functions(y)
        return np.asarray(self.levels[n] @ self.basis.sets[n].T @ values.T)


def sizes(degrees: Degrees, n: int, panels: tuple[int, int], *, mirrored: bool) -> Array:
    """Return the unknowns of each level of n masses; ``panels``: how many between, beyond stops."""
    sets = levels(degrees.total, degrees.others, 2 * n - 1)
    functions = np.array(degrees.counts) @ panels / (2.0 if mirrored else 1.0)
    return np.array([s.k.shape[0] for s in sets]) * functions


def expanded(
    frame: Frame,
    reference: Reference,
    degrees: Degrees,
    *,
    whole: bool,
    step: Callable[[float], None] = lambda share: None,
) -> Expansion:
    """Return the stationary expansion about ``reference``.

    ``whole``: with all levels; else the lowest three, from which the moments and the density of the
    contact displacement follow. ``step`` is called with the share of the work that is done. Double
    precision throughout: in single precision, at ten times lighter damping, errors were 4e-3.
    """
    functions = basis(frame, reference, degrees.counts)
    d = 2 * frame.n - 1
    sets = levels(degrees.total, degrees.others, d)
    chain = Chain.of(frame, reference, functions)
    inverses, A = factored(chain, sets, kept=degrees.total if whole else 3, step=step)
    one = functions.of_one(0)
    scale = float(np.abs(A).max())
    # The equation of the mass is 0 = 0: in its place that the mass is one.
    u = [np.asarray(np.linalg.solve(A + scale * np.outer(one, one), scale * one), dtype=float)]
    for n in range(1, degrees.total + 1 if whole else 3):
        given = chain.from_below(sets, n, u, inverses)
        u.append(np.asarray(-(inverses[n] @ given), dtype=float))
    shaped = tuple(x.reshape(s.k.shape[0], -1) for x, s in zip(u, sets, strict=False))
    residual = float(np.max(np.abs(A @ u[0])) / np.max(np.abs(A) @ np.abs(u[0])))
    return Expansion(functions, chain.factor, degrees, shaped, sets, residual)


def factored(
    chain: "Chain",
    sets: tuple[Level, ...],
    *,
    kept: int,
    shift: complex = 0.0,
    step: Callable[[float], None] = lambda share: None,
) -> tuple[dict[int, Array], Array]:
    """Eliminate all levels but the lowest from the equations less ``shift`` times the unknowns.

    Returned are the inverses of what each level meets in itself after those above it, of levels 1
    to ``kept``, and the equations of level 0. ``step`` is called with the share of the work done.
    """
    work = np.cumsum([float(s.k.shape[0]) ** 3 for s in reversed(sets)])
    inverses: dict[int, Array] = {}
    above: list[Array] = []
    total = len(sets) - 1
    for n in range(total, 0, -1):
        inverse, *above = chain.eliminated(sets, n, above, shift=shift)
        if n <= kept:
            inverses[n] = inverse
        step(work[total - n] / work[-1])
    return inverses, chain.within(sets[0], shift=shift) + chain.from_above(sets[0], above[0])


@dataclass(frozen=True, eq=False)
class Chain:
    """The matrices of the equations between levels.

    ``factor`` C, ``linear`` F', ``pair`` ½ (F' + F'ᵀ) + G', ``reach`` l₁ = C₁₁. Of level n:
    ``adjoint[n]`` is ∂* (functions of n, functions of n + 1), ``force[n][i]`` the part of a_i⁺
    (functions of n, functions of n − 1), ``sets[n]`` as in ``Basis``. ``radiation`` is (∂* ∂)^½ at
    the highest level, which stands for those above it.
    """

    factor: Array
    linear: Array
    pair: Array
    reach: float
    adjoint: tuple[Array, ...]
    force: tuple[tuple[Array, ...], ...]
    radiation: Array
    sets: tuple[Array, ...]

    @classmethod
    def of(cls, frame: Frame, reference: Reference, functions: Basis) -> "Chain":
        """Return the equations about a reference in the functions of a basis."""
        F, G, h = linear_part(frame, reference)
        C = np.asarray(np.linalg.cholesky(reference.covariance), dtype=float)
        inverse = np.linalg.inv(C)
        linear = inverse @ F @ C
        noise = inverse @ G @ inverse.T
        y, w = functions.points, functions.weights
        force = h[0][:, None] + h[1][:, None] * y
        force[0] -= frame.contact_force(y)
        force = inverse @ force
        (value, slope), top = functions.functions(y), len(functions.sets) - 1
        adjoint, forces = [], []
        for n, columns in enumerate(functions.sets):
            above, below = (value @ functions.sets[m] for m in (min(n + 1, top), max(n - 1, 0)))
            tested, tested_slope = value @ columns, slope @ columns
            adjoint.append(tested_slope.T @ (w[:, None] * above))
            H = [tested.T @ ((w * f)[:, None] * below) for f in force]
            H[0] += C[0, 0] * tested_slope.T @ (w[:, None] * below)
            forces.append(tuple(H))
        # The level above the highest would have as many functions as the one below it.
        E = (slope @ functions.sets[top]).T @ (w[:, None] * (value @ functions.sets[top - 1]))
        square, V = np.linalg.eigh(E @ E.T)
        radiation = (V * np.sqrt(np.maximum(square, 0.0))) @ V.T
        pair = 0.5 * (linear + linear.T) + noise
        return cls(
            C,
            linear,
            pair,
            float(C[0, 0]),
            tuple(adjoint),
            tuple(forces),
            radiation,
            functions.sets,
        )

    def within(self, level: Level, *, top: bool = False, shift: complex = 0.0) -> Array:
        """Return the equations of a level in itself, less ``shift`` times its unknowns.

        Those of the highest level are closed by radiation (``top``). A shift that is not real makes
        them and all that follows from them complex.
        """
        d, count = level.k.shape[1], level.k.shape[0]
        A = np.zeros((count, count))
        for i in range(d):
            for j in range(d):
                size = np.sqrt(level.k[:, j] * (level.k[:, i] + (i != j)))
                at = np.flatnonzero((level.k[:, j] > 0) & (level.moved[i, j] >= 0))
                A[level.moved[i, j][at], at] += self.linear[i, j] * size[at]
        functions = self.adjoint[level.total].shape[0]
        full = np.zeros((count, functions, count, functions))
        each = np.arange(functions)
        full[:, each, :, each] = A
        if top:
            rows = np.arange(count)
            loss = self.reach * np.sqrt(level.k[:, 0] + 1.0)
            full[rows, :, rows, :] -= loss[:, None, None] * self.radiation
        matrix = full.reshape(count * functions, -1)
        if shift:
            matrix = matrix.astype(np.result_type(matrix, shift))
            matrix[np.diag_indices_from(matrix)] += np.asarray(-shift)
        return matrix

    def from_above(self, level: Level, R: Array) -> Array:
        """Return what the level above, R times unknowns of lower levels, adds to ``level``."""
        E = self.adjoint[level.total]
        parts = R.reshape(-1, E.shape[1], R.shape[1])[level.raised[0]]
        parts = np.matmul(self.reach * E, parts)
        parts *= np.sqrt(level.k[:, 0] + 1.0)[:, None, None]
        return np.asarray(parts.reshape(-1, R.shape[1]))

    def eliminated(
        self,
        sets: tuple[Level, ...],
        n: int,
        above: list[Array],
        *,
        shift: complex = 0.0,
    ) -> list[Array]:
        """Return the inverse of what u_n meets, then R and Q of u_n = R u_(n−1) + Q u_(n−2).

        ``above`` are R and Q of the level above, none for the highest; there is no Q for n = 1.
        """
        A: Array = self.within(sets[n], top=not above, shift=shift)
        if above:
            A += self.from_above(sets[n], above[0])
        inverse = inverted(A)
        R = self._forced(inverse, sets[n - 1], n)
        if above:
            R -= inverse @ self.from_above(sets[n], above[1])
        return [inverse, R, self._paired(inverse, sets, n)] if n > 1 else [inverse, R]

    def forced(self, below: Level, n: int, u: Array) -> Array:
        """Return what u of level n − 1 adds to level n through the forces and ∂*."""
        parts = u.reshape(below.k.shape[0], -1)
        out = np.zeros((below.raised.max() + 1, self.force[n][0].shape[0]), u.dtype)
        for i, H in enumerate(self.force[n]):
            at = np.flatnonzero(below.raised[i] >= 0)
            out[below.raised[i][at]] += np.sqrt(below.k[at, i, None] + 1.0) * (parts[at] @ H.T)
        return out.ravel()

    def paired(self, sets: tuple[Level, ...], n: int, u: Array) -> Array:
        """Return what u of level n − 2 adds to level n through a⁺ a⁺."""
        below, to = sets[n - 2], self.sets[n].T @ self.sets[n - 2]
        parts = u.reshape(below.k.shape[0], -1) @ to.T
        out = np.zeros((sets[n].k.shape[0], to.shape[0]), u.dtype)
        for at, place, factor in self._pairs(sets, n):
            out[place] += factor[:, None] * parts[at]
        return out.ravel()

    def from_below(
        self, sets: tuple[Level, ...], n: int, u: list[Array], inverses: dict[int, Array]
    ) -> Array:
        """Return what u of the levels below n adds to level n, directly and through level n + 1.

        ``inverses`` as of ``factored``.
        """
        given = self.forced(sets[n - 1], n, u[n - 1])
        if n > 1:
            given += self.paired(sets, n, u[n - 2])
        if n + 1 < len(sets):
            # What u_(n−1) makes of level n + 1 without u_n comes back to level n.
            beyond = -(inverses[n + 1] @ self.paired(sets, n + 1, u[n - 1]))
            given += self.from_above(sets[n], beyond[:, None])[:, 0]
        return given

    def _pairs(self, sets: tuple[Level, ...], n: int) -> Iterator[tuple[Indices, Indices, Array]]:
        """Degrees of level n − 2, where a_i⁺ a_j⁺ puts them in level n, and with what factor."""
        below, between = sets[n - 2], sets[n - 1]
        d = self.pair.shape[0]
        for i, j in product(range(d), repeat=2):
            first = below.raised[i]
            second = np.where(first >= 0, between.raised[j][first], -1)
            at = np.flatnonzero(second >= 0)
            once, twice = below.k[at, i] + 1.0, below.k[at, j] + 1.0 + (i == j)
            yield at, second[at], self.pair[i, j] * np.sqrt(once * twice)

    def _forced(self, inverse: Array, below: Level, n: int) -> Array:
        """−``inverse`` times what level n − 1 adds to level n."""
        forces = self.force[n]
        functions, lower = forces[0].shape
        size = inverse.shape[0]
        R = np.zeros((size, below.k.shape[0], lower), inverse.dtype)
        for i, H in enumerate(forces):
            if not np.any(H):
                continue
            product = inverse.reshape(-1, functions) @ H
            product = product.reshape(size, -1, lower)
            at = np.flatnonzero(below.raised[i] >= 0)
            factor = np.sqrt(below.k[at, i] + 1.0)
            R[:, at] -= product[:, below.raised[i][at]] * factor[:, None]
        return R.reshape(size, -1)

    def _lifted(self, inverse: Array, n: int) -> Array:
        """Columns of ``inverse`` as functions of level n − 2, whose set holds that of level n."""
        to = self.sets[n].T @ self.sets[n - 2]
        return (inverse.reshape(-1, to.shape[0]) @ to).reshape(inverse.shape[0], -1, to.shape[1])

    def _paired(self, inverse: Array, sets: tuple[Level, ...], n: int) -> Array:
        """−``inverse`` times what level n − 2 adds to level n."""
        columns, count = self._lifted(inverse, n), sets[n - 2].k.shape[0]
        Q = np.zeros((inverse.shape[0], count, columns.shape[2]), inverse.dtype)
        for at, place, factor in self._pairs(sets, n):
            Q[:, at] -= columns[:, place] * factor[:, None]
        return Q.reshape(inverse.shape[0], -1)


def inverted(A: Array) -> Array:
    """Return the inverse of a matrix whose symmetric part is negative, by its quarters.

    Two thirds of the work are products, several times as fast as triangular solutions.
    """
    size = A.shape[0]
    if size <= LEAF:
        return np.asarray(np.linalg.inv(A))
    half = size // 2
    first = inverted(A[:half, :half])
    right, below = first @ A[:half, half:], A[half:, :half] @ first
    last = inverted(A[half:, half:] - A[half:, :half] @ right)
    out = np.empty_like(A)
    corner = last @ below
    out[half:, half:] = last
    out[half:, :half] = -corner
    np.matmul(right, -last, out=out[:half, half:])
    out[:half, :half] = first
    out[:half, :half] += right @ corner
    return out
