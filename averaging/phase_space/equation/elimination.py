"""Elimination of the chain of stages from the highest down, and the stationary expansion.

Each stage costs the inverse of one dense block, and as much again with what stages meet two below
them, which is of the size of the damping: without it the elimination is a preconditioner.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from averaging.phase_space.equation.basis import Basis, basis
from averaging.phase_space.equation.chain import Chain, chain_of, placed
from averaging.phase_space.equation.degrees import Degrees, Space, space_to
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.krylov import RESIDUAL
from fpk.numeric.arrays import Array, Integers

ELIMINATED_IN: type = np.float32
"""Numbers of the first elimination, before any in double precision."""
CONVERGED = 1e-12
"""Residual, relative to the terms that cancel, of a solution in double precision: it has 1e-15."""
CORRECTED, VECTORS = 1e-4, 30
"""Residual, relative to the one before, that a correction by a Krylov space leaves in single
precision, and the vectors of the space at the most."""
WHILE_INVERTED, OF_EQUATIONS = 4.0, 5e3
"""Matrices of the largest level's size beside the inverses, and bytes of equations and vectors for
each unknown: seven solutions took 12 to 36 % less."""
LEAF = 200
"""Order of a matrix up to which LAPACK inverts it; above, by quarters: products are faster."""
TOP_LEVELS = 4
"""Highest levels whose size is that of what the levels above them would have."""
LARGE, NEGLIGIBLE = 0.5, 0.2
"""Size of the highest degrees in the others over that of the highest levels from which the degree
in the others rises by two, and by one. On Fig. 6 two degrees more changed densities by 0.03 of the
change by ten levels more at sizes below 0.2, by 0.25 below 0.5, by 4.6 beyond, at the most."""

Solve = Callable[[Array], Array]
"""Returns u of A u = right, vectors of all unknowns."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """Coefficients of a solution: ``levels[n]`` is (degrees, functions) of level n.

    ``basis``, ``factor`` and ``space`` are as of ``Chain``; ``residual`` is relative to the terms
    that cancel in the equations.
    """

    basis: Basis
    factor: Array
    space: Space
    levels: tuple[Array, ...]
    residual: float

    def functions(self, n: int, y: Array) -> Array:
        """u_k(y) of all k of level n, (degrees, points)."""
        b = self.basis
        values, _ = b.at_points if y is b.points else b.functions(y)
        return np.asarray(self.of_panels(n) @ values.T)

    def of_panels(self, n: int) -> Array:
        """Coefficients of level n in the functions of all panels."""
        return np.asarray(self.levels[n] @ self.basis.of_level(n)[:, : self.levels[n].shape[1]].T)

    @property
    def top(self) -> float:
        """Size of the highest levels, for a mass of 1."""
        return float(np.sqrt(sum(float(np.sum(u**2)) for u in self.levels[-TOP_LEVELS:])))

    @property
    def rise(self) -> int:
        """By how much the degree in the others is to rise: 2, 1 or 0 where little is there."""
        sizes = np.concatenate([np.sum(u**2, axis=1) for u in self.levels])
        edge = np.sqrt(np.sum(sizes[self.space.counted == self.basis.degrees.others]))
        return int(edge > LARGE * self.top) + int(edge > NEGLIGIBLE * self.top)


def cost(functions: Basis, *, numbers: type = np.float32) -> tuple[float, float]:
    """Return the bytes and the operations, on real numbers, that a solution in a basis takes.

    ``numbers`` are those of the elimination. Pairs of stages take as much again as the inverses.
    """
    degrees, d = functions.degrees, 2 * functions.frame.n - 1
    *_, ends = placed(functions, space_to(degrees.total, degrees.others, d))
    size = np.diff(ends, prepend=0).astype(float)
    blocks = float(np.sum(size**2) + WHILE_INVERTED * np.max(size) ** 2)
    number = np.dtype(numbers).itemsize
    paired = number > 4 or bool(functions.frame.system.damping_terms)
    operations = (6.0 if paired else 3.0) * float(np.sum(size**3)) * (4.0 if number > 8 else 1.0)
    return number * blocks + OF_EQUATIONS * float(np.sum(size)), operations


def expanded(
    frame: Frame,
    reference: Reference,
    degrees: Degrees,
    *,
    memory: float = np.inf,
    step: Callable[[float], None] = lambda share: None,
) -> Expansion:
    """Return the stationary expansion about ``reference``.

    The elimination is in single precision, without pairs unless there are damping terms; where its
    refinement does not converge, in double, with pairs, unless that takes more than ``memory``.
    """
    functions = basis(frame, reference, degrees)
    chain = chain_of(functions)
    for kind in (ELIMINATED_IN, np.float64):
        paired = kind is np.float64 or bool(frame.system.damping_terms)
        solve, scale = factored(chain, kind=kind, paired=paired, step=step)
        u, residual = _refined(chain, solve, scale, paired=paired)
        if residual < CONVERGED or cost(functions, numbers=float)[0] > memory:
            break
    return Expansion(functions, chain.factor, chain.space, tuple(chain.shaped(u)), residual)


def _refined(chain: Chain, solve: Solve, scale: float, *, paired: bool) -> tuple[Array, float]:
    """Return the solution with the equation of the mass, as of ``factored``, and its residual."""
    matrix, one = chain.matrix, chain.basis.of_one
    given = scale * one

    def times(u: Array) -> Array:
        product = matrix @ u
        product[: one.size] += given * (one @ u[: one.size])
        return product

    right = np.zeros(chain.ends[-1])
    right[: one.size] = given
    A, M = (LinearOperator(2 * right.shape, f, dtype=float) for f in (times, solve))
    u, rest, before, magnitude = np.zeros(right.size), right, np.inf, abs(matrix)
    while True:
        # Where single precision is too coarse the corrections grow out of its range.
        with np.errstate(over="ignore", invalid="ignore"):
            if paired:
                change = solve(rest)
            else:
                change, _ = gmres(A, rest, M=M, rtol=CORRECTED, restart=VECTORS, maxiter=1)
            u = u + change
            rest = right - times(u)
            changed = float(np.linalg.norm(change) / np.linalg.norm(u))
        # The terms of the function 1 are those in the equation of the mass.
        size = max(np.max(magnitude @ np.abs(u)), np.max(np.abs(given)))
        residual = float(np.max(np.abs(rest)) / size)
        # A correction takes the error down by that of the elimination.
        if not changed < 0.5 * before or residual <= RESIDUAL:
            return u, residual
        before = changed


def factored(
    chain: Chain,
    *,
    shift: complex = 0.0,
    kind: type = np.float64,
    paired: bool = True,
    step: Callable[[float], None] = lambda share: None,
) -> tuple[Solve, float]:
    """Eliminate the stages of the equations less ``shift`` times the unknowns, from the top down.

    Returned are the function that solves them, and the factor before the mass in the equation of
    the function 1: 0 with a shift. Without one the equation of the mass replaces it (0 = 0), as
    large as the terms of 1: the largest entry would make round-off a thousand times larger. Without
    ``paired`` what stages meet two below is left out. ``step`` is told the share of the work done.
    """
    top = chain.top
    work = np.cumsum(np.diff(chain.ends, prepend=0)[::-1].astype(float) ** 3)
    inverses: list[Array] = []
    two_below = np.zeros((0, 0))
    A = chain.within(top, shift=shift, kind=kind)
    matrix = chain.matrix.astype(A.dtype, copy=False)
    above, forced = (chain.blocks(matrix, away) for away in (1, -1))
    pairs = chain.blocks(matrix, -2) if paired else []
    for n in range(top, 0, -1):
        inverse = inverted(A, chain.cuts(n))
        A = chain.within(n - 1, shift=shift, kind=kind)
        # What the two stages below n make of stage n comes back to the one below it.
        back = above[n - 1] @ inverse
        A -= back @ forced[n - 1]
        if paired and n < top:
            A += back @ two_below
        if paired and n > 1:
            two_below = back @ pairs[n - 2]
        inverses.insert(0, inverse)
        step(work[top - n] / work[-1])
    scale = 0.0
    if not shift:
        one: Array = chain.basis.of_one.astype(kind, copy=False)
        scale = float(np.max(np.abs(A) @ np.abs(one)))
        A = A + scale * np.outer(one, one)
    inverses.insert(0, np.asarray(np.linalg.inv(A), dtype=A.dtype))

    def solve(right: Array) -> Array:
        parts = np.split(right.astype(A.dtype, copy=False), chain.ends[:-1])
        # From the top down what each stage makes without those below it, and back up.
        alone = [inverses[top] @ parts[top]]
        for n in range(top - 1, -1, -1):
            alone.insert(0, inverses[n] @ (parts[n] - above[n] @ alone[0]))
        u = [alone[0]]
        for n in range(1, top + 1):
            below = forced[n - 1] @ u[n - 1]
            if paired and n > 1:
                below += pairs[n - 2] @ u[n - 2]
            if paired and n < top:
                # What u_(n−1) makes of stage n + 1 without u_n comes back to stage n.
                below -= above[n] @ (inverses[n + 1] @ (pairs[n - 1] @ u[n - 1]))
            u.append(alone[n] - inverses[n] @ below)
        return np.concatenate(u)

    return solve, scale


def inverted(A: Array, cuts: Sequence[int] | Integers) -> Array:
    """Return the inverse of a matrix by its quarters, divided at ``cuts`` (ascending).

    They lie between degrees in the other masses, as displacements without velocities are singular.
    """
    size = A.shape[0]
    inside = [cut for cut in cuts if 0 < cut < size]
    if size <= LEAF or not inside:
        return np.asarray(np.linalg.inv(A))
    half = min(inside, key=lambda cut: abs(2 * cut - size))
    first = inverted(A[:half, :half], inside)
    right, below = first @ A[:half, half:], A[half:, :half] @ first
    rest = A[half:, half:] - A[half:, :half] @ right
    last = inverted(rest, [cut - half for cut in inside])
    out, corner = np.empty_like(A), last @ below
    out[half:, half:], out[half:, :half] = last, -corner
    np.matmul(right, -last, out=out[:half, half:])
    np.add(first, right @ corner, out=out[:half, :half])
    return out
