"""Refinement: degrees rise, and the reference adapts, until the estimated L1 error is small."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import first_degrees, next_degrees
from averaging.phase_space.equation.elimination import Expansion, Step, expand, solution_cost
from averaging.phase_space.equation.frame import (
    Frame,
    Reference,
    gibbs_reference,
    with_moments,
)
from averaging.phase_space.marginals import marginal, moments
from fpk.answer.method import Progress, silent
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.numeric.arrays import ROUND_OFF
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.machine import usable_cores
from fpk.numeric.quadrature import gauss_grid, integral

DISTANCE_SAFETY = 2.5
"""Factor on errors estimated from distances of solutions: without it the largest of 140 true errors
of densities of random systems of two masses, with damping ratios from 0.0005, was 1.2 times the
estimate, the median 0.3 times; of curves in time the largest of 56 was 1.9 times."""
FIRST_SAFETY = 2.0
"""Further factor if there is one distance only: without both the largest of 224 true errors was 2.7
times the estimate."""
LEAST_RATIO, LEAST_SHARE = 0.25, 0.1
"""Smallest credible ratios of a distance of two solutions, to the distance of the two solutions
before it, and to the largest distance of the densities of single coordinates: smaller is by chance.
With them no error of these systems was above 0.53 of the stated error."""
SLOWEST_FALL = 1.25
"""Smallest factor by which distances of successive solutions are taken to fall."""
LIKELY_FALL, HOPELESS = 2.0, 0.01
"""Largest factor by which errors are taken to fall with each solution, to tell beforehand what is
out of reach: the median of 44 factors on random systems was 2.8, but large errors fall more slowly.
An error up to the second value is worth an answer, whatever the tolerance."""
DENSITY_ROUND_OFF = 1e-11
"""L1 error by round-off, in double precision: at most 2.3e-12 against exact densities."""
MOST_POLYNOMIALS = 90
"""Largest number of polynomials on a panel: its Gauss points make 88 orthonormal to 6e-11, but 100
to 2e-4 only."""
SOLUTION_MEMORY = 4.0
"""Default limit of the memory of one solution, in GB (1e9 bytes)."""
SOLUTION_WORK = 1.2e13
"""Limit of the operations of one solution with ``SOLUTION_MEMORY``: five minutes on one core."""
REFITS, REFITTED = 8, 0.02
"""Largest number of times that the moments of a solution replace those of the reference, and the
relative change of a covariance at which this ends."""


@dataclass(frozen=True)
class Options:
    """Limits and settings of the refinement.

    The first two solutions are always computed; a further solution is not if it needs more than
    ``memory`` (GB) or ``work`` (operations). ``threads`` are for linear algebra, None: all cores.
    """

    memory: float
    work: float
    threads: int | None = None
    progress: Progress = silent

    def refusal(self, size: float, work: float) -> str:
        """Return why a solution of ``size`` bytes and ``work`` operations is refused, or ""."""
        words = ""
        if size > 1e9 * self.memory:
            words = f"{size / 1e9:.2g} GB of memory, at most {self.memory:.2g}"
        elif work > self.work:
            words = f"{work:.1g} operations, at most {self.work:.1g}"
        return words and f"a finer solution needs {words}"

    def step(self, what: str) -> Step:
        """Return the function that reports the completed share of ``what``."""
        return lambda share: self.progress(int(100 * share), 100, what)


@dataclass(frozen=True, eq=False)
class Ladder:
    """Two successive solutions, expansions or on meshes, and the estimated L1 errors of the finer.

    For each observable ``errors`` is the L1 error of its density, ``factors`` the error over the L1
    distance of the two solutions, ``believed`` the distance that the error is computed from.
    ``limit`` says why no finer solution is computed, "" if one may be; ``solutions`` is the number
    of solutions computed.
    """

    finest: Any
    coarser: Any
    errors: dict[Observable, float]
    factors: dict[Observable, float]
    believed: dict[Observable, float]
    limit: str
    solutions: int


@contextmanager
def breakdowns() -> Iterator[None]:
    """Context, or decorator, that raises ``NotCertified`` in the place of ``LinAlgError``."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise NotCertified(f"the solution breaks down: {error}") from None


def error_by_distances(last: float, earlier: float | None) -> tuple[float, float]:
    """Return the credible distance of the last two solutions, and the error of the finer solution.

    ``last`` is their distance, ``earlier`` the credible distance before, or None. The credible d is
    the larger of ``last`` and ``LEAST_RATIO`` times ``earlier``; the error is the larger of d and
    d/(r − 1), r = ``earlier``/d >= ``SLOWEST_FALL``, times ``DISTANCE_SAFETY``.
    Without ``earlier`` it is d times ``DISTANCE_SAFETY`` and ``FIRST_SAFETY``.
    """
    if earlier is None:
        return last, FIRST_SAFETY * DISTANCE_SAFETY * last
    distance = max(last, LEAST_RATIO * earlier)
    rate = max(earlier / distance, SLOWEST_FALL) if distance else np.inf
    return distance, DISTANCE_SAFETY * distance * max(1.0, 1.0 / (rate - 1.0))


def ladder_of(
    finest: Any,
    coarser: Any,
    observables: Sequence[Observable],
    before: Ladder | None = None,
) -> Ladder:
    """Return the ladder of two solutions, with the errors of ``observables``.

    Errors follow from the L1 distance of the solutions and from the distances in ``before``, the
    ladder with ``coarser`` as its finer solution; None if there is none.
    """
    least, solutions = least_distance(finest, coarser), before.solutions + 1 if before else 2
    ladder = Ladder(finest, coarser, {}, {}, {}, "", solutions)
    for o in observables:
        own = solution_distance(finest, coarser, o)
        earlier = before.believed[o] if before else None
        ladder.believed[o], error = error_by_distances(max(own, least), earlier)
        ladder.errors[o] = error + DENSITY_ROUND_OFF
        ladder.factors[o] = error / own if own > 0.0 else 0.0
    return ladder


def solution_ladder(
    frame: Frame, observables: Sequence[Observable], options: Options, tol: float = np.inf
) -> Iterator[Ladder]:
    """Yield ladders of solutions of rising degrees; the last is yielded again with its ``limit``.

    Raises ``LinAlgError`` if the equations of the first two solutions are not solved, and as
    ``require_reach`` with ``tol``.
    """
    memory, degrees = 1e9 * options.memory, first_degrees(frame)
    limit = ""
    coarser: Expansion | None = None
    ladder: Ladder | None = None
    with threadpool_limits(limits=options.threads or usable_cores(), user_api="blas"):
        about = fit_reference(frame, gibbs_reference(frame))
        while True:
            step = options.step(f"phase space, degree {degrees.total}")
            finest = expand(frame, about, degrees, memory=memory, step=step)
            if not finest.residual < ROUND_OFF:
                limit = f"the equations of degree {degrees.total} are not solved"
                if solution_cost(finest.basis, numbers=float)[0] > memory:
                    limit += ": double precision needs more memory"
                break
            degrees = next_degrees(frame, degrees, finest.others)
            if coarser is not None:
                before, ladder = ladder, ladder_of(finest, coarser, observables, ladder)
                require_reach(ladder, before, options, tol)
                yield ladder
                limit = f"a finer solution needs more than {MOST_POLYNOMIALS} functions of y"
                if degrees.outer <= MOST_POLYNOMIALS:
                    limit = options.refusal(*solution_cost(basis(frame, about, degrees)))
                if limit:
                    break
            coarser = finest
    if ladder is None:
        raise np.linalg.LinAlgError(limit)
    yield replace(ladder, limit=limit)


def require_reach(ladder: Ladder, before: Ladder | None, options: Options, tol: float) -> None:
    """Raise ``NotApplicable`` if an error of ``ladder`` would not fall to ``tol`` or ``HOPELESS``.

    That is the larger of these, before memory or work end, by ``LIKELY_FALL`` with each solution or
    by the factor since ``before``, the ladder before it, if that is less. The third solution
    decides, or the second if its error, above 1, says nothing.
    """
    frame, reference = ladder.finest.basis.frame, ladder.finest.basis.reference
    for o, first in ladder.errors.items() if ladder.solutions < 4 else ():
        error, least = first, max(tol, HOPELESS) if before or first >= 1.0 else np.inf
        fall = min(LIKELY_FALL, before.errors[o] / first if before else np.inf)
        degrees, others = ladder.finest.basis.degrees, ladder.finest.others
        known = f"{observable_name(o)}: its error, {first:.1g} at degree {degrees.total}"
        while error > least:
            degrees, others = next_degrees(frame, degrees, others), others + 1
            error /= fall
            cost = solution_cost(basis(frame, reference, degrees))
            if fall <= 1.0 or degrees.outer > MOST_POLYNOMIALS or options.refusal(*cost):
                end = "before memory or work end; use montecarlo"
                raise NotApplicable(f"{known}, would not fall to {least:g} {end}")


def better(earlier: Ladder, later: Ladder, observable: Observable) -> Ladder:
    """Return ``earlier`` if its error is smaller and contains the later density, else ``later``."""
    a, b = (ladder.errors[observable] for ladder in (earlier, later))
    agree = a <= b and solution_distance(earlier.finest, later.finest, observable) <= a
    return earlier if agree else later


def least_distance(a: Any, b: Any) -> float:
    """Return ``LEAST_SHARE`` times the largest L1 distance of a density of a single q or p.

    Raises ``LinAlgError`` if a variance is not positive.
    """
    variances = np.array([np.diag(moments(e)[1]) for e in (a, b)])
    if not variances.min() > 0.0:
        raise np.linalg.LinAlgError("a variance found is not positive")
    rows = range(variances.shape[1] // 2)
    single = [(Coordinate(kind, row),) for kind in ("q", "p") for row in rows]
    return LEAST_SHARE * max(solution_distance(a, b, o) for o in single)


def solution_distance(a: Any, b: Any, observable: Observable) -> float:
    """Return ∫|p_a − p_b| of the densities of ``observable`` on the panels of both."""
    first, p = marginal(a, observable)
    second, q = marginal(b, observable)
    mesh, grids = gauss_grid(list(map(np.union1d, first, second)))
    return integral(np.abs(p(*mesh) - q(*mesh)), grids)


def fit_reference(frame: Frame, about: Reference) -> Reference:
    """Return a reference fitted to the solution, starting with ``about``.

    It takes the moments of solutions of low degree about it. Raises ``LinAlgError`` if these are of
    no distribution.
    """
    for _ in range(REFITS):
        e = expand(frame, about, first_degrees(frame))
        mean, covariance = moments(e)
        before, scale = about, np.sqrt(np.diag(about.covariance))
        about = with_moments(frame, mean * (not e.basis.mirrored), covariance)
        change = np.max(np.abs(about.covariance - before.covariance) / np.outer(scale, scale))
        # The Gibbs state is the solution if damping and noise are proportional.
        if change <= DENSITY_ROUND_OFF:
            return before
        if change < REFITTED:
            break
    return about
