"""Elimination of the chain of stages from the highest down, and the stationary expansion.

``equations`` has the chain. Each stage costs the inverse of one dense block.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from averaging.phase_space.equation.basis import Basis, basis
from averaging.phase_space.equation.chain import Chain
from averaging.phase_space.equation.damping import stages_to
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.equations import chain_of
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.equation.others import Others, others_to
from averaging.phase_space.equation.panels import polynomials
from averaging.phase_space.equation.terms import applied, applied_from_right
from fpk.arrays import Array

ELIMINATED_IN: type = np.float32
"""Numbers of the first elimination, before any in double precision."""
SMALL = 1e8
"""Sum of the cubes of the levels' sizes up to which double precision takes no longer at once."""
CONVERGED = 1e-12
"""Residual, relative to the terms that cancel, of a solution in double precision: it has 1e-15."""
MOST_REFINEMENTS = 20
"""Corrections by the residual; each takes the error down by the error of the elimination."""
REFINED = 1e-15
"""Relative change that the next correction would make, at which there is none."""
LEAF = 200
"""Order of a matrix up to which LAPACK inverts it; above, by quarters: products are faster."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """Coefficients of a solution: ``levels[n]`` is (count, functions) of level n.

    ``basis`` has the functions of y, ``factor`` C; ``others`` the products of degrees in the
    variables other than the contact velocity. ``residual`` is that of the equations, relative to
    the terms that cancel in them.
    """

    basis: Basis
    factor: Array
    degrees: Degrees
    levels: tuple[Array, ...]
    others: tuple[Others, ...]
    residual: float

    def functions(self, n: int, y: Array) -> Array:
        """u_k(y) of all k of level n, (count, points)."""
        b = self.basis
        values, _ = b.at_points if y is b.points else b.functions(y)
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
        for o in others_to(degrees.others, 2 * frame.n - 1)[: degrees.others_at(level) + 1]:
            out[level] += o.count * functions[degrees.beyond(level, o.total)]
    stages = np.add.reduceat(out, [levels[0] for levels in stages_to(frame, degrees.total)])
    return np.asarray(stages / (2.0 if frame.symmetric else 1.0))


def expanded(
    frame: Frame,
    reference: Reference,
    degrees: Degrees,
    *,
    again: bool = True,
    step: Callable[[float], None] = lambda share: None,
) -> Expansion:
    """Return the stationary expansion about ``reference``.

    ``step`` is called with the share of the work that is done. The elimination is in single
    precision, half the time and memory of double, and its solution is refined by the residual in
    double precision. Where that does not converge it is done ``again`` in double precision.
    """
    functions = basis(frame, reference, degrees)
    chain = chain_of(frame, reference, functions, degrees)
    one = functions.of_one()[: chain.size(0)]
    small = sum(chain.size(n) ** 3 for n in range(chain.top + 1)) < SMALL
    kinds = (np.float64,) if small else (ELIMINATED_IN, np.float64) if again else (ELIMINATED_IN,)
    for kind in kinds:
        factors, scale = factored(chain, kind=kind, one=one, step=step)
        u, residual = _refined(factors, scale * one, one)
        if residual < CONVERGED:
            break
    shaped = tuple(level for n, x in enumerate(u) for level in chain.shaped(n, x))
    return Expansion(functions, chain.factor, degrees, shaped, chain.others, residual)


@dataclass(frozen=True, eq=False)
class Factors:
    """Equations of a chain, eliminated: solves them for any right side.

    ``inverses[n]`` is that of what level n meets in itself after the levels above it.
    """

    chain: Chain
    inverses: Sequence[Array]

    def solve(self, right: Sequence[Array]) -> list[Array]:
        """Return u of A u = right, both by levels."""
        chain, inverses, top = self.chain, self.inverses, self.chain.top
        # From the top down what each level makes without those below it, and back up.
        alone = [inverses[top] @ right[top].astype(inverses[top].dtype, copy=False)]
        for n in range(top - 1, -1, -1):
            beyond = applied(chain.above[n], alone[0][:, None], chain.size(n))[:, 0]
            alone.insert(0, inverses[n] @ (right[n] - beyond).astype(inverses[n].dtype, copy=False))
        u = [alone[0]]
        for n in range(1, top + 1):
            below = chain.from_below(n, u, inverses).astype(inverses[n].dtype, copy=False)
            u.append(alone[n] - inverses[n] @ below)
        return u


def _refined(factors: Factors, given: Array, one: Array) -> tuple[list[Array], float]:
    """Return the stationary solution and its residual, relative to the terms that cancel in it.

    ``given`` is the right side of level 0, the others have none. The equation of the mass, which
    ``factors`` have, is added to those of the chain.
    """
    chain = factors.chain
    right = [given, *(np.zeros(chain.size(n)) for n in range(1, chain.top + 1))]
    u, rest = [np.zeros(x.size) for x in right], right
    before, size = 2.0, 1.0
    for _ in range(MOST_REFINEMENTS):
        # Where single precision is too coarse the corrections grow out of its range.
        with np.errstate(over="ignore", invalid="ignore"):
            change = factors.solve(rest)
            u = [x + dx for x, dx in zip(u, change, strict=True)]
            product, size = chain.times(u)
            product[0] = product[0] + given * (one @ u[0])
            rest = [b - Au for b, Au in zip(right, product, strict=True)]
            changed = float(np.sqrt(sum(x @ x for x in change) / sum(x @ x for x in u)))
        if not changed < before or changed**2 < REFINED * before:
            break
        before = changed
    # The terms of the function 1 are those in the equation of the mass.
    size = max(size, float(np.max(np.abs(given))))
    return u, float(np.max(np.abs(np.concatenate(rest)))) / size


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
    one: Array,
    shift: complex = 0.0,
    kind: type = np.float64,
    step: Callable[[float], None] = lambda share: None,
) -> tuple[Factors, float]:
    """Eliminate the stages of the equations less ``shift`` times the unknowns, from the top down.

    Without a shift the equation of the mass, ``one`` times the unknowns of level 0, is added as
    ``with_mass`` does; returned is what stands before the mass in it, too. ``step`` is called with
    the share of the work done.
    """
    top = chain.top
    work = np.cumsum([float(chain.size(n)) ** 3 for n in range(top, -1, -1)])
    inverses: list[Array] = []
    R = Q = np.zeros((0, 0))
    for n in range(top, 0, -1):
        A, size = chain.within(n, shift=shift, kind=kind), chain.size(n)
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
        inverses.insert(0, inverse)
        step(work[top - n] / work[-1])
    A = chain.within(0, shift=shift) + applied(chain.above[0], R, chain.size(0))
    scale = 0.0
    if not shift:
        A, scale = with_mass(A, one)
    return Factors(chain, [np.asarray(np.linalg.inv(A), dtype=A.dtype), *inverses]), scale


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
