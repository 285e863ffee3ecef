"""Elimination of the chain of stages from the highest down, and the stationary expansion.

Each stage costs the inverse of one dense block, and as much again for the coupling of a stage to
the second stage below it. This coupling is of the order of the damping; an elimination that omits
it serves as a preconditioner.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from averaging.phase_space.equation.basis import Basis, basis
from averaging.phase_space.equation.chain import Chain, chain_of, places
from averaging.phase_space.equation.degrees import Degrees, Space, space_to
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.krylov import RESIDUAL
from fpk.numeric.arrays import ROUND_OFF, Array, Integers

ELIMINATED_IN: type = np.float32
"""Type of the numbers of the first elimination; double precision follows if it is too coarse."""
CORRECTED, VECTORS = 1e-4, 30
"""Factor by which a correction by GMRES lowers the residual, preconditioned in single precision,
and the largest dimension of its space."""
WHILE_INVERTED, OF_EQUATIONS = 4.0, 5e3
"""Memory beside the inverses: matrices of the size of the largest stage, and bytes for each
unknown. Seven solutions took 12 to 36 % less than this estimate."""
LEAF = 200
"""Largest order of a matrix that LAPACK inverts. Larger matrices are inverted by quarters, mainly
by matrix products, which takes a quarter of the time in single and half in double precision."""
TOP_LEVELS = 4
"""Number of highest levels whose norm estimates the norm of the omitted levels."""
LARGE, NEGLIGIBLE = 0.5, 0.2
"""Norm of the highest degrees in the other masses over the norm of the highest levels, above which
this degree rises by two, and by one. On Fig. 6 two degrees more changed densities by at most 0.03
of the change by ten levels more for ratios below 0.2, 0.25 below 0.5, and 4.6 above."""

Solve = Callable[[Array], Array]
"""Maps the right side to the solution of A u = right, vectors of all unknowns."""
Step = Callable[[float], None]
"""Called with the completed share of an elimination."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """Coefficients of a solution: ``levels[n]`` (degrees, functions) of level n.

    ``basis``, ``factor`` and ``space`` are the fields of its ``Chain``; ``residual`` is the largest
    residual of an equation relative to the terms that cancel in it.
    """

    basis: Basis
    factor: Array
    space: Space
    levels: tuple[Array, ...]
    residual: float

    def functions(self, n: int, y: Array) -> Array:
        """Return u_k(``y``), (degrees, points), the factors of Hermite functions of level ``n``."""
        b = self.basis
        values, _ = b.at_points if y is b.points else b.functions(y)
        return np.asarray(self.of_panels(n) @ values.T)

    def of_panels(self, n: int) -> Array:
        """Return the coefficients (degrees, polynomials of all panels) of level ``n``."""
        return np.asarray(self.levels[n] @ self.basis.of_level(n)[:, : self.levels[n].shape[1]].T)

    @property
    def top(self) -> float:
        """Norm of the highest ``TOP_LEVELS`` levels, relative to a density of mass 1."""
        return float(np.sqrt(sum(float(np.sum(u**2)) for u in self.levels[-TOP_LEVELS:])))

    @property
    def rise(self) -> int:
        """Increment of the degree in the others for the next solution: 2, 1 or 0."""
        sizes = np.concatenate([np.sum(u**2, axis=1) for u in self.levels])
        edge = np.sqrt(np.sum(sizes[self.space.counted == self.basis.degrees.others]))
        return int(edge > LARGE * self.top) + int(edge > NEGLIGIBLE * self.top)


def solution_cost(functions: Basis, *, numbers: type = np.float32) -> tuple[float, float]:
    """Return the bytes and the operations on real numbers that a solution in a basis takes.

    ``numbers`` is the type of the numbers of the elimination. Coupling to the second stage below,
    included in double precision or with damping terms, takes as much again as the inverses.
    """
    degrees, d = functions.degrees, 2 * functions.frame.n - 1
    *_, ends = places(functions, space_to(degrees.total, degrees.others, d))
    size = np.diff(ends, prepend=0).astype(float)
    blocks = float(np.sum(size**2) + WHILE_INVERTED * np.max(size) ** 2)
    number = np.dtype(numbers).itemsize
    paired = number > 4 or bool(functions.frame.system.damping_terms)
    operations = (6.0 if paired else 3.0) * float(np.sum(size**3)) * (4.0 if number > 8 else 1.0)
    return number * blocks + OF_EQUATIONS * float(np.sum(size)), operations


def expand(
    frame: Frame,
    reference: Reference,
    degrees: Degrees,
    *,
    memory: float = np.inf,
    step: Step = lambda share: None,
) -> Expansion:
    """Return the stationary expansion about ``reference`` at ``degrees``.

    The elimination is in single precision, without the coupling to the second stage below unless
    there are damping terms. If its refinement does not converge it is repeated in double precision,
    with that coupling, unless this needs more than ``memory`` bytes. Nothing is raised if neither
    converges: see ``Expansion.residual``. ``step`` is called with the completed share of an
    elimination.
    """
    functions = basis(frame, reference, degrees)
    chain = chain_of(functions)
    for kind in (ELIMINATED_IN, np.float64):
        paired = kind is np.float64 or bool(frame.system.damping_terms)
        solve, scale = eliminate(chain, kind=kind, paired=paired, step=step)
        u, residual = _refine(chain, solve, scale, paired=paired)
        if residual < ROUND_OFF or solution_cost(functions, numbers=float)[0] > memory:
            break
    return Expansion(functions, chain.factor, chain.space, tuple(chain.unpack(u)), residual)


def _refine(chain: Chain, solve: Solve, scale: float, *, paired: bool) -> tuple[Array, float]:
    """Return the solution of mass 1 by iterative refinement with ``solve``, and its residual.

    ``scale`` is the factor of the equation of the mass; ``paired``: see ``eliminate``.
    """
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
        # If single precision is too coarse, the corrections grow beyond its range.
        with np.errstate(over="ignore", invalid="ignore"):
            if paired:
                change = solve(rest)
            else:
                change, _ = gmres(A, rest, M=M, rtol=CORRECTED, restart=VECTORS, maxiter=1)
            u = u + change
            rest = right - times(u)
            changed = float(np.linalg.norm(change) / np.linalg.norm(u))
        # The equation of the mass has terms of the size of ``given``.
        size = max(np.max(magnitude @ np.abs(u)), np.max(np.abs(given)))
        residual = float(np.max(np.abs(rest)) / size)
        # Stop when corrections no longer fall by half, or at round-off.
        if not changed < 0.5 * before or residual <= RESIDUAL:
            return u, residual
        before = changed


def eliminate(
    chain: Chain,
    *,
    shift: complex = 0.0,
    kind: type = np.float64,
    paired: bool = True,
    step: Step = lambda share: None,
) -> tuple[Solve, float]:
    """Eliminate the stages of (A − ``shift``) u = right from the highest down.

    Returns the function that solves the equations, and a factor. Without a shift the equation of
    the function 1 is 0 = 0 and is replaced by factor · mass = right; the factor is the size of the
    terms of 1 in the equations. With a shift it is 0. ``kind`` is the type of the numbers. Unless
    ``paired``, the coupling of stages to the second stage below is omitted. ``step`` is called with
    the completed share of the work.
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
        inverse = inverse_by_quarters(A, chain.cuts(n))
        A = chain.within(n - 1, shift=shift, kind=kind)
        # Effect of stage n on stage n − 1, through the stages below that force stage n.
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
        # Downwards the response of each stage without the stages below it, then back up.
        alone = [inverses[top] @ parts[top]]
        for n in range(top - 1, -1, -1):
            alone.insert(0, inverses[n] @ (parts[n] - above[n] @ alone[0]))
        u = [alone[0]]
        for n in range(1, top + 1):
            below = forced[n - 1] @ u[n - 1]
            if paired and n > 1:
                below += pairs[n - 2] @ u[n - 2]
            if paired and n < top:
                # Effect of u_(n−1) on stage n by way of stage n + 1.
                below -= above[n] @ (inverses[n + 1] @ (pairs[n - 1] @ u[n - 1]))
            u.append(alone[n] - inverses[n] @ below)
        return np.concatenate(u)

    return solve, scale


def inverse_by_quarters(A: Array, cuts: Sequence[int] | Integers) -> Array:
    """Return the inverse of the matrix ``A``, divided recursively into quarters at ``cuts``.

    The ascending cuts separate degrees in the other masses: blocks of displacements without
    velocities would be singular.
    """
    size = A.shape[0]
    inside = [cut for cut in cuts if 0 < cut < size]
    if size <= LEAF or not inside:
        return np.asarray(np.linalg.inv(A))
    half = min(inside, key=lambda cut: abs(2 * cut - size))
    first = inverse_by_quarters(A[:half, :half], inside)
    right, below = first @ A[:half, half:], A[half:, :half] @ first
    rest = A[half:, half:] - A[half:, :half] @ right
    last = inverse_by_quarters(rest, [cut - half for cut in inside])
    out, corner = np.empty_like(A), last @ below
    out[half:, half:], out[half:, :half] = last, -corner
    np.matmul(right, -last, out=out[:half, half:])
    np.add(first, right @ corner, out=out[:half, :half])
    return out
