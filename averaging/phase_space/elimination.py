"""Elimination of the chain of stages from the highest down, and the stationary expansion.

``equations`` has the chain. Each stage costs the inverse of one dense block.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from averaging.phase_space.basis import Basis, basis
from averaging.phase_space.damping import reach, stages_to
from averaging.phase_space.degrees import (
    Degrees,
    Indices,
    Others,
    degrees_of_level,
    others_to,
)
from averaging.phase_space.equations import Chain
from averaging.phase_space.frame import Frame, Reference
from averaging.phase_space.panels import polynomials
from averaging.phase_space.terms import applied, applied_from_right
from fpk.arrays import Array

LEAF = 200
"""Order of a matrix up to which LAPACK inverts it; above, by quarters: products are faster."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """Coefficients of a solution: ``levels[n]`` is (count, functions) of level n, of what is kept.

    ``basis`` has the functions of y, ``factor`` C; ``others`` the degrees in the variables other
    than the contact velocity. ``residual`` is that of the equations of level 0, into which all
    others are eliminated, relative to the terms that cancel in them.
    """

    basis: Basis
    factor: Array
    degrees: Degrees
    levels: tuple[Array, ...]
    others: tuple[Others, ...]
    residual: float

    def degree(self, n: int) -> Indices:
        """The degrees k of level n, (count, d)."""
        return degrees_of_level(self.others, n)

    def functions(self, n: int, y: Array) -> Array:
        """u_k(y) of all k of level n, (count, points)."""
        values, _ = self.basis.functions(y)
        return np.asarray(self.of_panels(n) @ values.T)

    def of_panels(self, n: int) -> Array:
        """Coefficients of level n in the functions of all panels."""
        return np.asarray(self.levels[n] @ self.basis.of_level(n)[:, : self.levels[n].shape[1]].T)


def sizes(frame: Frame, reference: Reference, degrees: Degrees) -> Array:
    """Return about how many unknowns each stage has."""
    panels = polynomials(frame, reference, degrees)
    functions = [
        sum(count if p == degrees.outer else degrees.fewer(p, count) for p in panels)
        for count in range(degrees.outer + 1)
    ]
    out = np.zeros(degrees.total + 1)
    for level in range(degrees.total + 1):
        for o in others_to(degrees.others, 2 * frame.n - 1)[: level + 1]:
            out[level] += o.k.shape[0] * functions[degrees.beyond(level, o.total)]
    stages = np.add.reduceat(out, [levels[0] for levels in stages_to(frame, degrees.total)])
    return np.asarray(stages / (2.0 if frame.symmetric else 1.0))


def expanded(
    frame: Frame,
    reference: Reference,
    degrees: Degrees,
    *,
    whole: bool,
    step: Callable[[float], None] = lambda share: None,
) -> Expansion:
    """Return the stationary expansion about ``reference``.

    ``whole``: with all levels; else the lowest three, and those that the means of damping terms
    need, from which the moments and the density of the contact displacement follow. ``step`` is
    called with the share of the work that is done. Double precision throughout: in single
    precision, at ten times lighter damping, errors were 4e-3.
    """
    functions = basis(frame, reference, degrees)
    chain = Chain.of(frame, reference, functions, degrees)
    kept = chain.stage_of(degrees.total if whole else 2 + reach(frame))
    inverses, A = factored(chain, kept=kept, step=step)
    one = functions.of_one()[: A.shape[0]]
    mass, scale = with_mass(A, one)
    u = [np.asarray(np.linalg.solve(mass, scale * one), dtype=float)]
    for n in range(1, kept + 1):
        u.append(-(inverses[n] @ chain.from_below(n, u, inverses)))
    residual = float(np.max(np.abs(A @ u[0])) / np.max(np.abs(A) @ np.abs(u[0])))
    shaped = tuple(level for n, x in enumerate(u) for level in chain.shaped(n, x))
    return Expansion(functions, chain.factor, degrees, shaped, chain.others, residual)


def with_mass(A: Array, one: Array) -> tuple[Array, float]:
    """Return the equations of level 0 with that of the mass, and what stands before the mass in it.

    The equation of the function 1 is 0 = 0 in ``A``; here it is that the mass, ``one`` times the
    unknowns, is given. Its size is that of the terms of 1, which is nearly the solution: were it
    the largest entry, their round-off would be a thousand times as large as they.
    """
    scale = float(np.max(np.abs(A) @ np.abs(one)))
    return A + scale * np.outer(one, one), scale


def factored(
    chain: Chain,
    *,
    kept: int,
    shift: complex = 0.0,
    step: Callable[[float], None] = lambda share: None,
) -> tuple[dict[int, Array], Array]:
    """Eliminate all stages but the lowest from the equations less ``shift`` times the unknowns.

    Returned are the inverses of what each stage meets in itself after those above it, of stages 1
    to ``kept`` + 1, and the equations of level 0. ``step`` is called with the share of the work
    done.
    """
    top = chain.top
    work = np.cumsum([float(chain.size(n)) ** 3 for n in range(top, -1, -1)])
    inverses: dict[int, Array] = {}
    R = Q = np.zeros((0, 0))
    for n in range(top, 0, -1):
        A, size = chain.within(n, shift=shift), chain.size(n)
        if n < top:
            A += applied(chain.above[n], R, size)
        inverse = inverted(A, chain.starts(n))
        # u_n = R u_(n−1) + Q u_(n−2).
        R_next = applied_from_right(inverse, chain.forced[n], chain.size(n - 1))
        if n < top:
            R_next += inverse @ applied(chain.above[n], Q, size)
        R = np.negative(R_next, out=R_next)
        if n > 1:
            Q = -applied_from_right(inverse, chain.paired[n], chain.size(n - 2))
        if n <= kept + 1:
            inverses[n] = inverse
        step(work[top - n] / work[-1])
    return inverses, chain.within(0, shift=shift) + applied(chain.above[0], R, chain.size(0))


def inverted(A: Array, cuts: Sequence[int]) -> Array:
    """Return the inverse of a matrix by its quarters, divided at ``cuts`` (ascending).

    Two thirds of the work are products, several times as fast as triangular solutions. What is in
    front of a cut must not be singular by itself. The equations of one degree in the other masses
    are not divided: velocities and displacements turn into each other, and these alone are not
    damped.
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
    out = np.empty_like(A)
    corner = last @ below
    out[half:, half:] = last
    out[half:, :half] = -corner
    np.matmul(right, -last, out=out[:half, half:])
    out[:half, :half] = first
    out[:half, :half] += right @ corner
    return out
