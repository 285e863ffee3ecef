"""Elimination of the chain of stages from the highest down, and the stationary expansion.

Each stage costs the inverse of one dense block. The coupling of levels that are two apart is of the
order of the damping; an elimination of stages of single levels, which omits it, serves as a
preconditioner, at a quarter of the work of stages that contain it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from averaging.phase_space.equation.basis import Basis, basis
from averaging.phase_space.equation.chain import Chain, chain_of, damping_degree, places
from averaging.phase_space.equation.degrees import Degrees, Space, space_to
from averaging.phase_space.equation.frame import Frame, Reference
from fpk.numeric.arrays import ROUND_OFF, Array, Integers
from fpk.numeric.krylov import RESIDUAL

ELIMINATED_IN: type = np.float32
"""Type of the numbers of the first elimination; double precision follows if it is too coarse."""
CORRECTED, VECTORS = 1e-4, 40
"""Factor by which a correction by GMRES lowers the residual, preconditioned in single precision,
and the largest dimension of its space."""
WHILE_INVERTED, OF_EQUATIONS = 4.0, 300.0
"""Memory beside the inverses: matrices of the size of the largest stage, and bytes for each unknown
and level, times (r + 1)² with damping terms of degree r (``chain``). With N from 13 to 21 assembly
took 215 to 220 bytes for r = 0, 572 to 626 for r = 1, 2060 to 2580 for r = 2."""
LEAF = 200
"""Largest order of a matrix that LAPACK inverts. Larger matrices are inverted by quarters, mainly
by matrix products, which takes a quarter of the time in single and half in double precision."""
TOP_LEVELS, NEGLIGIBLE = 4, 0.6
"""Number of highest levels whose norm estimates the norm of the omitted levels, and the norm of
degrees in the other masses, over it, that are not needed. With 0.1 two degrees more are kept, which
changed true errors of four systems by less than a tenth, for twice the operations."""

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

    @cached_property
    def in_panels(self) -> Array:
        """Coefficients (degrees, polynomials of all panels) of all levels."""
        of = self.basis.of_level
        return np.concatenate([u @ of(n)[:, : u.shape[1]].T for n, u in enumerate(self.levels)])

    @property
    def others(self) -> int:
        """One more than the highest degree in the other masses that is not negligible."""
        sizes = np.concatenate([np.sum(u**2, axis=1) for u in self.levels])
        top = sum(float(np.sum(u**2)) for u in self.levels[-TOP_LEVELS:])
        above = np.cumsum(np.bincount(self.space.counted, sizes)[::-1])[::-1]
        return 1 + int(np.sum(above > NEGLIGIBLE**2 * top))

    def given(self, functionals: Array) -> Array:
        """Return the integrals over ζ, given y, at the points of the basis: (..., points).

        ``functionals`` (..., degrees) are integrals of the functions of ζ; the results contain the
        weights of an integral over y.
        """
        b = self.basis
        return np.asarray(functionals @ self.in_panels @ b.at_points[0].T * b.measure)


def solution_cost(functions: Basis, *, numbers: type = np.float32) -> tuple[float, float]:
    """Return the bytes and the operations on real numbers that a solution in a basis takes.

    ``numbers`` is the type of the numbers of the elimination; in double precision stages are
    joined (``places``).
    """
    degrees, d = functions.degrees, 2 * functions.frame.n - 1
    number = np.dtype(numbers).itemsize
    *_, ends = places(functions, space_to(degrees.total, degrees.others, d), joined=number > 4)
    size = np.diff(ends, prepend=0).astype(float)
    blocks = float(np.sum(size**2) + WHILE_INVERTED * np.max(size) ** 2)
    operations = 3.0 * float(np.sum(size**3)) * (4.0 if number > 8 else 1.0)
    terms = (damping_degree(functions.frame) + 1) ** 2
    return number * blocks + OF_EQUATIONS * degrees.total * terms * float(np.sum(size)), operations


def expand(
    frame: Frame,
    reference: Reference,
    degrees: Degrees,
    *,
    memory: float = np.inf,
    step: Step = lambda share: None,
) -> Expansion:
    """Return the stationary expansion about ``reference`` at ``degrees``.

    The elimination that preconditions is in single precision. If GMRES does not converge, it is
    repeated in double precision with joined stages (``places``), unless this needs more than
    ``memory`` bytes. Nothing is raised if neither converges: see ``Expansion.residual``. ``step``
    is called with the completed share of an elimination.
    """
    functions = basis(frame, reference, degrees)
    for kind in (ELIMINATED_IN, np.float64):
        chain = chain_of(functions, joined=kind is np.float64)
        # If single precision is too coarse, numbers grow beyond its range.
        with np.errstate(over="ignore", invalid="ignore"):
            u, residual = _solve(chain, *eliminate(chain, kind=kind, step=step))
        if residual < ROUND_OFF or solution_cost(functions, numbers=float)[0] > memory:
            break
    return Expansion(functions, chain.factor, chain.space, tuple(chain.unpack(u)), residual)


def _solve(chain: Chain, solve: Solve, scale: float) -> tuple[Array, float]:
    """Return the solution of mass 1 by GMRES, preconditioned by ``solve``, and its residual.

    The equation of the function 1 is not quite 0 = 0 in truncated equations: a multiple of it, that
    vanishes as degrees rise, is left over, and the mass is prescribed. ``scale`` is the factor of
    the equation of the mass.
    """
    matrix, one = chain.matrix, chain.basis.of_one
    right = np.zeros(chain.ends[-1])
    right[: one.size] = scale * one

    def times(u: Array) -> Array:
        return np.asarray(matrix @ u + right * (chain.mass @ u))

    u, rest, before, magnitude = np.zeros(right.size), right, np.inf, abs(matrix)
    A, M = (LinearOperator(2 * right.shape, f, dtype=float) for f in (times, solve))
    while True:
        u = u + gmres(A, rest, M=M, rtol=CORRECTED, restart=VECTORS, maxiter=1)[0]
        rest = right - times(u)
        # The equation of the mass has terms of the size of ``right``.
        size = max(np.max(magnitude @ np.abs(u)), np.max(np.abs(right)))
        residual = float(np.max(np.abs(rest)) / size)
        # Stop when residuals no longer fall by half, or at round-off.
        if not residual < 0.5 * before or residual <= RESIDUAL:
            return u / (chain.mass @ u), residual
        before = residual


def eliminate(
    chain: Chain,
    *,
    shift: complex = 0.0,
    kind: type = np.float64,
    step: Step = lambda share: None,
) -> tuple[Solve, float]:
    """Eliminate the stages of (A − ``shift``) u = right from the highest down.

    Returns the function that solves the equations, and a factor. Couplings of stages that are not
    neighbours are omitted. Without a shift factor · (level 0 of the mass) is added to the equation
    of the function 1, which would be nearly 0 = 0; the factor is the size of the terms of 1 in the
    equations. With a shift it is 0. ``kind`` is the type of the numbers. ``step`` is called with
    the completed share of the work.
    """
    top = chain.top
    work = np.cumsum(np.diff(chain.ends, prepend=0)[::-1].astype(float) ** 3)
    inverses: list[Array] = []
    A = chain.within(top, shift=shift, kind=kind)
    matrix = chain.matrix.astype(A.dtype, copy=False)
    above, forced = (chain.blocks(matrix, away) for away in (1, -1))
    for n in range(top, 0, -1):
        inverses.insert(0, inverse_by_quarters(A, chain.cuts(n)))
        A = chain.within(n - 1, shift=shift, kind=kind)
        # Effect of stage n on stage n − 1, which forces it.
        A -= (above[n - 1] @ inverses[0]) @ forced[n - 1]
        step(work[top - n] / work[-1])
    scale = 0.0
    if not shift:
        one: Array = chain.basis.of_one.astype(kind, copy=False)
        scale = float(np.max(np.abs(A) @ np.abs(one)))
        A[: one.size, : one.size] += scale * np.outer(one, one)
    inverses.insert(0, np.asarray(np.linalg.inv(A), dtype=A.dtype))

    def solve(right: Array) -> Array:
        parts = np.split(right.astype(A.dtype, copy=False), chain.ends[:-1])
        # Downwards the response of each stage without the stages below it, then back up.
        u = [inverses[top] @ parts[top]]
        for n in range(top - 1, -1, -1):
            u.insert(0, inverses[n] @ (parts[n] - above[n] @ u[0]))
        for n in range(1, top + 1):
            u[n] = u[n] - inverses[n] @ (forced[n - 1] @ u[n - 1])
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
