"""Degrees and reference that adapt until the distance to the coarser solution meets a tolerance."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import finer, fitting, lowest
from averaging.phase_space.equation.elimination import CONVERGED, Expansion, cost, expanded
from averaging.phase_space.equation.frame import Frame, Reference, reference_of, start, with_moments
from averaging.phase_space.marginals import marginal, moments
from fpk.answer.method import Progress, silent
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.machine import usable_cores
from fpk.numeric.quadrature import gauss_grid, integral

SAFETY = 2.5
"""Factor on errors by distances: without it the largest of 56 was 1.9 times the stated one."""
FIRST = 2.0
"""Factor beside ``SAFETY`` after one distance: without either the largest of 400 was 2.2 times."""
KEPT = 0.25
"""Least share of one distance that the next one is believed to be."""
LIGHT, KEPT_WHERE_LIGHT = 0.01, 0.6
"""Damping ratio of a natural mode below which this share is kept: of 148 errors with 0.0007 to
0.005 the largest was 1.7 times what ``KEPT`` states; of 88 with 0.011 it was 0.73 times."""
COMMON = 0.25
"""Least share, for any density, of the largest distance of all densities of one coordinate."""
SLOWEST = 1.25
"""Factor by which distances are believed to fall at the least."""
ROUND_OFF = 1e-11
"""L1 error of the arithmetic in double precision: on exact densities it was up to 2.3e-12."""
MOST_OUTER = 90
"""Polynomials on a panel that its Gauss points keep orthonormal: 88 to 6e-11, 100 to 2e-4."""
MEMORY = 4.0
"""GB (1e9 bytes) that a solution may need where no other bound is given."""
WORK = 1.2e13
"""Operations that it may need where ``MEMORY`` is the bound: about a minute on two cores."""
REFITS = 2
"""Solutions that the moments are taken from. The first changed variances of 119 systems by 0.3 % at
the median and 20 % at the most, the second by 7e-8 and 7 %."""
NARROWER, MOST, BETTER = 0.87, 4, 0.95
"""Factor between the variances of the contact velocity that are tried, how many are, and the factor
by which a narrower one is to bring the highest levels down."""


@dataclass(frozen=True)
class Options:
    """Settings; no third solution is begun beyond ``memory`` (GB) or ``work`` (operations)."""

    memory: float
    work: float
    threads: int | None = None
    reference: Reference | None = None
    progress: Progress = silent

    def refusal(self, size: float, work: float) -> str:
        """Say why a solution of these bytes and operations is not begun; empty where it may."""
        words = ""
        if size > 1e9 * self.memory:
            words = f"{size / 1e9:.2g} GB of memory, at most {self.memory:.2g}"
        elif work > self.work:
            words = f"{work:.1g} operations, at most {self.work:.1g}"
        return words and f"a finer solution needs {words}"

    def step(self, what: str, degree: int) -> Callable[[float], None]:
        """Return the function that reports a share of the work on ``what``."""
        return lambda share: self.progress(int(100 * share), 100, f"{what}, degree {degree}")


@dataclass(frozen=True, eq=False)
class Ladder:
    """A solution, the coarser one before it, and the L1 error of each observable.

    ``believed`` is the distance that an error follows from, ``factors`` the error over their own
    distance. ``limit`` says why no finer solution is made; ``solutions`` is how many were made.
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
    squares, modes = np.linalg.eigh(frame.stiffness)
    own = np.sum(modes * (frame.damping @ modes), axis=0)
    light = not frame.system.damping_terms and np.any(own < 2.0 * LIGHT * np.sqrt(squares))
    return KEPT_WHERE_LIGHT if light else KEPT


def falling(last: float, earlier: float | None, share: float) -> tuple[float, float]:
    """Return the distance of two solutions that is believed, and the error of the finer one.

    ``last`` is their distance, ``earlier`` the one believed before, ``share`` as of ``kept``.
    Distances d that fall by a factor r leave d/(r − 1), which counts where it is more than d.
    """
    if earlier is None:
        return last, FIRST * SAFETY * last
    distance = max(last, share * earlier)
    rate = max(earlier / distance, SLOWEST) if distance else np.inf
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
    """Yield solutions of rising degrees with the one before; the last again with its limit."""
    about, memory, degrees = options.reference or start(frame), 1e9 * options.memory, lowest(frame)
    with threadpool_limits(limits=options.threads or usable_cores(), user_api="blas"):
        about = fitted(frame, about)
        coarser: Expansion | None = None
        ladder: Ladder | None = None
        while True:
            step = options.step("phase space", degrees.total)
            finest = expanded(frame, about, degrees, memory=memory, step=step)
            if not finest.residual < CONVERGED:
                limit = f"the equations of degree {degrees.total} are not solved"
                if ladder is None:
                    raise np.linalg.LinAlgError(limit)
                if cost(finest.basis, numbers=float)[0] > memory:
                    limit += ": double precision needs more memory"
                break
            degrees = finer(frame, degrees, finest.rise)
            if coarser is not None:
                ladder = ladder_of(finest, coarser, observables, ladder)
                yield ladder
                limit = f"a finer solution needs more than {MOST_OUTER} functions of a displacement"
                if degrees.outer <= MOST_OUTER:
                    limit = options.refusal(*cost(basis(frame, about, degrees)))
                if limit:
                    break
            coarser = finest
        yield replace(ladder, limit=limit)


def better(earlier: Ladder, later: Ladder, observable: Observable) -> Ladder:
    """Return the earlier ladder if its error is the smaller, and the later density within it."""
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


def fitted(frame: Frame, about: Reference) -> Reference:
    """Return a reference with about the moments of the solution, and the best width for it.

    The variance of the contact velocity falls while that makes the highest levels of a solution
    smaller. Raises ``LinAlgError`` where the moments are of no distribution.
    """
    best = about
    for _ in range(REFITS):
        before, best = best, refitted(expanded(frame, best, fitting(frame)))
        # The Gibbs state, where damping and noise are in one proportion, has its own moments.
        change = np.abs(best.covariance - before.covariance).max()
        if change <= ROUND_OFF * before.covariance.max():
            return before
    least = expanded(frame, best, fitting(frame)).top
    # The correlations of the velocity with the other variables stay as they are.
    scale = np.append(np.sqrt(NARROWER), np.ones(len(best.covariance) - 1))
    for _ in range(MOST):
        covariance = best.covariance * np.outer(scale, scale)
        other = reference_of(frame, best.slope, best.offset, covariance)
        size = expanded(frame, other, fitting(frame)).top
        if not size < BETTER * least:
            break
        best, least = other, size
    return best


def refitted(e: Expansion) -> Reference:
    """Return the reference with the first and second moments of a solution."""
    mean, covariance = moments(e)
    return with_moments(e.basis.frame, mean * (not e.basis.mirrored), covariance)
