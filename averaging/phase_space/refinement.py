"""Degrees and reference that adapt until the distance to the coarser solution meets a tolerance."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from threadpoolctl import threadpool_limits

from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import CONVERGED, Expansion, cost, expanded
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.growth import finer, lowest, rise_of
from averaging.phase_space.marginals import marginal
from averaging.phase_space.moments import moments
from averaging.phase_space.reference import fitted, start
from fpk.machine import usable_cores
from fpk.method import Progress
from fpk.observable import Coordinate, Observable
from fpk.quadrature import gauss_grid, integral

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


@dataclass(frozen=True, eq=False)
class Ladder:
    """A solution, the coarser one before it, and the L1 error of each observable.

    ``errors`` is by observable, and ``factors`` the error over the distance of the two solutions;
    ``limit`` says in words why no finer solution is made, empty where one may be.
    ``solutions`` is how many were made.
    """

    frame: Frame
    finest: Expansion
    coarser: Expansion
    errors: dict[Observable, float]
    factors: dict[Observable, float]
    limit: str
    solutions: int

    def with_error_of(self, observable: Observable) -> "Ladder":
        """Return the ladder with the error of one more density, from these two solutions alone."""
        solutions = self.frame, self.finest, self.coarser
        own = _distance(*solutions, observable)
        error = falling(max(own, least_distance(*solutions)), None, kept(self.frame)).error
        return replace(
            self,
            errors={**self.errors, observable: error + ROUND_OFF},
            factors={**self.factors, observable: error / own if own > 0.0 else 0.0},
        )


@dataclass(frozen=True)
class Bounds:
    """The most memory and work that one solution may need; one that needs more is not begun.

    ``memory`` is in GB (1e9 bytes), ``work`` in operations on real numbers. The first two
    solutions, without which there is no answer, are made whatever they need.
    """

    memory: float
    work: float

    @classmethod
    def of(cls, memory: float, work: float | None = None) -> Self:
        """Return the bounds of a memory and a work, None: the work that goes with the memory.

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


@dataclass(frozen=True)
class Falling:
    """The ``distance`` between solutions that is believed, and the ``error`` of the finer one."""

    distance: float
    error: float


def kept(frame: Frame) -> float:
    """Return the least share of one distance that the next one is believed to be."""
    if frame.system.damping_terms:
        return KEPT
    squares, modes = np.linalg.eigh(frame.stiffness)
    own = np.sum(modes * (frame.damping @ modes), axis=0)
    return KEPT_WHERE_LIGHT if np.any(own < 2.0 * LIGHT * np.sqrt(squares)) else KEPT


def falling(last: float, earlier: Falling | None, share: float) -> Falling:
    """Return what the distance ``last`` of two solutions says, after ``earlier`` ones.

    Distances d that fall by a factor r leave an error of d/(r − 1), which counts where it is more
    than d: errors oscillate, so that one fast fall promises no other. ``share`` as of ``kept``.
    """
    if earlier is None:
        return Falling(last, FIRST * SAFETY * last)
    distance = max(last, share * earlier.distance)
    if distance == 0.0:
        return Falling(0.0, 0.0)
    rate = max(earlier.distance / distance, SLOWEST)
    return Falling(distance, SAFETY * distance * max(1.0, 1.0 / (rate - 1.0)))


def ladders(
    frame: Frame,
    observables: Sequence[Observable],
    *,
    bounds: Bounds,
    threads: int | None,
    progress: Progress,
    reference: Reference | None,
) -> Iterator[Ladder]:
    """Yield solutions of rising degrees, each with the one before it.

    They do not depend on the error that is wanted. The last one is yielded again with what ends
    them. ``threads`` and ``reference`` as of ``PhaseSpace``.
    """
    about, memory = reference or start(frame), 1e9 * bounds.memory

    def why_not(degrees: Degrees) -> str:
        if degrees.outer > MOST_OUTER:
            return f"a finer solution needs more than {MOST_OUTER} functions of a displacement"
        return bounds.refusal(*cost(basis(frame, about, degrees), degrees))

    with threadpool_limits(limits=threads or usable_cores(), user_api="blas"):
        about = fitted(frame, about)
        coarser: Expansion | None = None
        ladder: Ladder | None = None
        fall: dict[Observable, Falling] = {}
        degrees, solutions, share = lowest(frame), 0, kept(frame)
        while True:
            step = steps(progress, "phase space", degrees)
            finest = expanded(frame, about, degrees, memory=memory, step=step)
            if not finest.residual < CONVERGED:
                unsolved = f"the equations of degree {degrees.total} are not solved"
                if ladder is None:
                    raise np.linalg.LinAlgError(unsolved)
                if cost(finest.basis, degrees, number=8)[0] > memory:
                    unsolved += ": double precision needs more memory"
                yield replace(ladder, limit=unsolved)
                return
            solutions += 1
            degrees = finer(frame, degrees, rise_of(finest))
            if coarser is not None:
                least = least_distance(frame, finest, coarser)
                own = {o: _distance(frame, finest, coarser, o) for o in observables}
                fall = {o: falling(max(d, least), fall.get(o), share) for o, d in own.items()}
                errors = {o: f.error + ROUND_OFF for o, f in fall.items()}
                factors = {o: f.error / own[o] if own[o] > 0.0 else 0.0 for o, f in fall.items()}
                ladder = Ladder(frame, finest, coarser, errors, factors, "", solutions)
                yield ladder
                if limit := why_not(degrees):
                    yield replace(ladder, limit=limit)
                    return
            coarser = finest


def solved_to(
    frame: Frame,
    observables: Sequence[Observable],
    *,
    tol: float,
    bounds: Bounds,
    threads: int | None = None,
    progress: Progress,
    reference: Reference | None = None,
) -> tuple[Ladder, dict[Observable, Ladder]]:
    """Return the last solution, and for each observable the one of the least L1 error.

    Solutions end where these errors are at most ``tol``, or with the last one of ``ladders``.
    """
    best: dict[Observable, Ladder] = {}
    for ladder in ladders(
        frame,
        observables,
        bounds=bounds,
        threads=threads,
        progress=progress,
        reference=reference,
    ):
        best = {o: better(best.get(o, ladder), ladder, o) for o in observables}
        if max(best[o].errors[o] for o in observables) <= tol:
            break
    limit, solutions = ladder.limit, ladder.solutions
    return ladder, {o: replace(own, limit=limit, solutions=solutions) for o, own in best.items()}


def better(earlier: Ladder, later: Ladder, observable: Observable) -> Ladder:
    """Return the earlier ladder if its density has the smaller error and the later one agrees.

    The density of the later solution, which is finer, is then within the error of the earlier one.
    """
    a, b = (ladder.errors[observable] for ladder in (earlier, later))
    agreed = a <= b and _distance(later.frame, earlier.finest, later.finest, observable) <= a
    return earlier if agreed else later


def steps(progress: Progress, what: str, degrees: Degrees) -> Callable[[float], None]:
    """Return the function that reports a share of the work on ``what``."""
    return lambda share: progress(int(100 * share), 100, f"{what}, degree {degrees.total}")


def least_distance(frame: Frame, a: Expansion, b: Expansion) -> float:
    """Return the least L1 distance that is believed of any density of two solutions."""
    if not min(np.diag(moments(frame, e).covariance).min() for e in (a, b)) > 0.0:
        raise np.linalg.LinAlgError("a variance found is not positive")
    single = [(Coordinate(kind, row),) for kind in ("q", "p") for row in range(frame.n)]
    return COMMON * max(_distance(frame, a, b, o) for o in single)


def _distance(frame: Frame, a: Expansion, b: Expansion, observable: Observable) -> float:
    """∫|p_a − p_b| on the support of both."""
    first, p = marginal(frame, a, observable)
    second, q = marginal(frame, b, observable)
    mesh, grids = gauss_grid(list(map(np.union1d, first, second)))
    return integral(np.abs(p(*mesh) - q(*mesh)), grids)
