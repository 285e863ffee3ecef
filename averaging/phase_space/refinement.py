"""Degrees and reference that adapt until the distance to the coarser solution meets a tolerance."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from threadpoolctl import threadpool_limits

from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import Degrees, finer, lowest
from averaging.phase_space.equation.elimination import CONVERGED, Expansion, cost, expanded
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.marginals import marginal, moments
from averaging.phase_space.reference import fitted, start
from fpk.answer.method import Progress, silent
from fpk.answer.observable import Coordinate, Observable
from fpk.numeric.machine import usable_cores
from fpk.numeric.quadrature import gauss_grid, integral

SAFETY = 2.5
"""Factor on the error that follows from distances between solutions. Without it, of 56 errors of
systems like Fig. 6 and random ones against finer solutions the largest was 1.9 times the stated
one, with a tenth of the damping; the next was 1.1."""
FIRST = 2.0
"""Factor beside it on the error that follows from one distance alone, small by chance at times:
without either, of 124 errors of 56 systems the largest was 1.4 times the stated one, of 276 with
other degrees 2.2 times."""
KEPT = 0.25
"""Least share of one distance that the next one is believed to be."""
LIGHT, KEPT_WHERE_LIGHT = 0.01, 0.6
"""Damping ratio of a natural mode below which more is believed, and that share. What is then slow
makes large errors of small residuals, which two solutions may share: of 148 errors of twelve
systems with ratios of 0.0007 to 0.005 one was 1.7 times what ``KEPT`` alone states; of 88 of seven
with a ratio of 0.011 the largest was 0.73 times it."""
COMMON = 0.25
"""Least share of the largest distance of all densities of one coordinate that any density's is
believed to be: with light damping that of one may be small by chance."""
SLOWEST = 1.25
"""Factor by which distances are believed to fall at the least."""
ROUND_OFF = 1e-11
"""L1 error of the arithmetic in double precision: on exact densities it was up to 2.3e-12."""
MOST_OUTER = 90
"""Polynomials on a panel up to which its Gauss points keep them orthonormal: with 88 to 6e-11, with
100 to 2e-4, as they are none of a polynomial beyond a stop."""
MEMORY = 4.0
"""GB (1e9 bytes) that a solution may need where no other bound is given."""
WORK = 1.2e13
"""Operations that it may need where ``MEMORY`` is the bound: about a minute on two cores."""


@dataclass(frozen=True)
class Options:
    """How solutions are made: the most memory and work of one, and the settings of ``PhaseSpace``.

    ``memory`` is in GB (1e9 bytes), ``work`` in operations on real numbers; a solution that needs
    more is not begun. The first two, without which there is no answer, are made whatever they need.
    """

    memory: float
    work: float
    threads: int | None = None
    reference: Reference | None = None
    progress: Progress = silent

    @classmethod
    def of(cls, memory: float, work: float | None = None) -> Self:
        """Return the options for a memory and a work, None: the work that goes with the memory.

        Dense blocks of order N take N² numbers and N³ operations.
        """
        return cls(memory, WORK * (memory / MEMORY) ** 1.5 if work is None else work)

    def refusal(self, size: float, work: float) -> str:
        """Say why a solution of these bytes and operations is not begun; empty where it may."""
        if size > 1e9 * self.memory:
            return (
                f"a finer solution needs {size / 1e9:.2g} GB of memory, at most {self.memory:.2g}"
            )
        if work > self.work:
            return f"a finer solution needs {work:.1g} operations, at most {self.work:.1g}"
        return ""

    def step(self, what: str, degrees: Degrees) -> Callable[[float], None]:
        """Return the function that reports a share of the work on ``what``."""
        words = f"{what}, degree {degrees.total}"
        return lambda share: self.progress(int(100 * share), 100, words)


@dataclass(frozen=True, eq=False)
class Ladder:
    """A solution, the coarser one before it, and the L1 error of each observable.

    By observable: ``errors``, ``factors``, the error over the distance of the two solutions, and
    ``believed``, the distance that the error follows from. ``limit`` says in words why no finer
    solution is made, empty where one may be. ``solutions`` is how many were made.
    """

    finest: Expansion
    coarser: Expansion
    errors: dict[Observable, float]
    factors: dict[Observable, float]
    believed: dict[Observable, float]
    limit: str
    solutions: int


def kept(frame: Frame) -> float:
    """Return the least share of one distance that the next one is believed to be."""
    if frame.system.damping_terms:
        return KEPT
    squares, modes = np.linalg.eigh(frame.stiffness)
    own = np.sum(modes * (frame.damping @ modes), axis=0)
    return KEPT_WHERE_LIGHT if np.any(own < 2.0 * LIGHT * np.sqrt(squares)) else KEPT


def falling(last: float, earlier: float | None, share: float) -> tuple[float, float]:
    """Return the distance of two solutions that is believed, and the error of the finer one.

    ``last`` is their distance, ``earlier`` what was believed before, ``share`` as of ``kept``.
    Distances d that fall by a factor r leave an error of d/(r − 1), which counts where it is more
    than d: errors oscillate, so that one fast fall promises no other.
    """
    if earlier is None:
        return last, FIRST * SAFETY * last
    distance = max(last, share * earlier)
    if distance == 0.0:
        return 0.0, 0.0
    rate = max(earlier / distance, SLOWEST)
    return distance, SAFETY * distance * max(1.0, 1.0 / (rate - 1.0))


def ladder_of(
    finest: Expansion,
    coarser: Expansion,
    observables: Sequence[Observable],
    before: Ladder | None = None,
) -> Ladder:
    """Return two solutions with their errors, by their distance and by those ``before``."""
    least, share = least_distance(finest, coarser), kept(finest.basis.frame)
    ladder = Ladder(finest, coarser, {}, {}, {}, "", before.solutions + 1 if before else 2)
    for o in observables:
        own = distance(finest, coarser, o)
        earlier = before.believed[o] if before else None
        ladder.believed[o], error = falling(max(own, least), earlier, share)
        ladder.errors[o] = error + ROUND_OFF
        ladder.factors[o] = error / own if own > 0.0 else 0.0
    return ladder


def ladders(frame: Frame, observables: Sequence[Observable], options: Options) -> Iterator[Ladder]:
    """Yield solutions of rising degrees, each with the one before it.

    They do not depend on the error that is wanted. The last one is yielded again with what ends
    them.
    """
    about, memory, degrees = options.reference or start(frame), 1e9 * options.memory, lowest(frame)
    with threadpool_limits(limits=options.threads or usable_cores(), user_api="blas"):
        about = fitted(frame, about)
        coarser: Expansion | None = None
        ladder: Ladder | None = None
        while True:
            step = options.step("phase space", degrees)
            finest = expanded(frame, about, degrees, memory=memory, step=step)
            if not finest.residual < CONVERGED:
                unsolved = f"the equations of degree {degrees.total} are not solved"
                if ladder is None:
                    raise np.linalg.LinAlgError(unsolved)
                if cost(finest.basis, numbers=float)[0] > memory:
                    unsolved += ": double precision needs more memory"
                yield replace(ladder, limit=unsolved)
                return
            degrees = finer(frame, degrees, finest.rise)
            if coarser is not None:
                ladder = ladder_of(finest, coarser, observables, ladder)
                yield ladder
                if degrees.outer > MOST_OUTER:
                    limit = (
                        f"a finer solution needs more than {MOST_OUTER} functions of a displacement"
                    )
                else:
                    limit = options.refusal(*cost(basis(frame, about, degrees)))
                if limit:
                    yield replace(ladder, limit=limit)
                    return
            coarser = finest


def better(earlier: Ladder, later: Ladder, observable: Observable) -> Ladder:
    """Return the earlier ladder if its density has the smaller error and the later one agrees.

    The density of the later solution, which is finer, is then within the error of the earlier one.
    """
    a, b = (ladder.errors[observable] for ladder in (earlier, later))
    agreed = a <= b and distance(earlier.finest, later.finest, observable) <= a
    return earlier if agreed else later


def least_distance(a: Expansion, b: Expansion) -> float:
    """Return the least L1 distance that is believed of any density of two solutions."""
    if not min(np.diag(moments(e)[1]).min() for e in (a, b)) > 0.0:
        raise np.linalg.LinAlgError("a variance found is not positive")
    single = [(Coordinate(kind, row),) for kind in ("q", "p") for row in range(a.basis.frame.n)]
    return COMMON * max(distance(a, b, o) for o in single)


def distance(a: Expansion, b: Expansion, observable: Observable) -> float:
    """Return ∫|p_a − p_b| on the support of both."""
    first, p = marginal(a, observable)
    second, q = marginal(b, observable)
    mesh, grids = gauss_grid(list(map(np.union1d, first, second)))
    return integral(np.abs(p(*mesh) - q(*mesh)), grids)
