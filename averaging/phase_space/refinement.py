"""Degrees and reference that adapt until the distance to the coarser solution meets a tolerance."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from threadpoolctl import threadpool_limits

from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import Expansion, expanded, sizes
from averaging.phase_space.equation.frame import Frame, Reference, gibbs_reference, heated
from averaging.phase_space.marginals import marginal
from averaging.phase_space.moments import moments, refitted
from fpk.cores import usable_cores
from fpk.method import Progress
from fpk.observable import Coordinate, Observable
from fpk.quadrature import gauss_grid, integral

REFITS = 2
"""Solutions of the lowest degrees from which the reference takes its moments: the second changes
the first by less than a thousandth of what the degrees leave."""
STARTS = (1.0, 1.5, 2.25)
"""Factors on the temperature of the start, in turn, where moments of no distribution are found:
polynomials about a Gaussian diverge where a density falls as slowly as the Gaussian of twice its
variance, as beside a bath much hotter than the mean of all. One system in sixty with baths 3 to 25
times as hot as each other needed the second."""
SETTLED = 1e-9
"""Change of the covariance by the first refit, relative to its largest entry, up to which the start
is the solution: the Gibbs state, where damping and noise are in one proportion."""
SLOWEST, FASTEST = 1.5, 2.0
"""Factors by which the error is believed to fall from one solution to the next, at the least and
at the most, whatever the last two distances say."""
FASTEST_STEADY = 3.0
"""The most where the distance has fallen by no less the step before."""
SAFETY = 4.5
"""Factor on the error that follows from the last two distances between solutions. With 3, of 752
errors of 83 systems against finer solutions 0.99 of the stated one was the most; of p(p1) of Fig. 6
with B = 10, at degree 46 against degree 64, it was 1.33, as distances do not fall there from degree
46 on."""
FIRST = 2.0
"""Factor beside it on the error that follows from one distance alone, which may be small by chance:
without it one of these errors was 1.7 times the stated one."""
ROUND_OFF = 1e-11
"""L1 error of the arithmetic in double precision: on exact densities it was up to 2.3e-12."""
MOST_OUTER = 90
"""Polynomials on a panel up to which its Gauss points keep them orthonormal: with 88 to 6e-11, with
100 to 2e-4, as they are none of a polynomial beyond a stop."""
MEMORY = 4.0e9
"""Bytes that a solution may need; one that needs more is not begun."""
WORK = 1.0e13
"""Multiplications that a solution may need, some two minutes on two cores; likewise."""


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
        error = falling(max(own, _common_distance(*solutions)), None).error
        return replace(
            self,
            errors={**self.errors, observable: error + ROUND_OFF},
            factors={**self.factors, observable: error / own if own > 0.0 else 0.0},
        )


def degrees_of(level: int, frame: Frame) -> Degrees:
    """Return the degrees of a level of refinement, from 0, so that all have like errors.

    Damping terms make all coordinates as unlike a Gaussian as a stop makes its mass: degrees in the
    others and in y rise with that in the velocity of the contact mass. Errors then oscillate with
    the degree, and more slowly the higher it is: steps that grow with it see that.
    """
    n, terms = frame.n, bool(frame.system.damping_terms)
    if n == 1 and terms:
        half = round(8 * 1.4**level)
        return Degrees(2 * half, 0, 2 * half + 2)
    if n == 2 and terms:
        half = round(8 * 1.25**level)
        return Degrees(2 * half, half, half + 10)
    if n == 1:
        return Degrees(16 + 8 * level, 0, 18 + 4 * level)
    if n == 2:
        return Degrees(16 + 6 * level, 6 + 2 * level, 18 + 2 * level)
    return Degrees(10 + 4 * level, 4 + level, 12 + 2 * level)


def cost(
    frame: Frame, reference: Reference, degrees: Degrees, *, number: int = 4
) -> tuple[float, float]:
    """Return the bytes and the multiplications that a solution takes.

    ``number`` is how many bytes a number of the elimination has.
    """
    size = sizes(frame, reference, degrees)
    bytes_ = number * float(8.0 * np.max(size) ** 2 + np.sum(size**2))
    return bytes_, float(4.0 * np.sum(size**3))


@dataclass(frozen=True)
class Falling:
    """How the distance between solutions falls with their degrees, and the error that is left.

    ``distance`` is the last one that is believed, ``fell`` the factor by which the last one had
    fallen, ``error`` the error of the finer solution in the units of the distance.
    """

    distance: float
    fell: float
    error: float


def falling(last: float, earlier: Falling | None) -> Falling:
    """Return what the distance ``last`` of two solutions says, after ``earlier`` ones.

    With the factor r by which distances d fall the error is ``SAFETY`` d/(r − 1). A distance may be
    small by chance, so that r is bounded.
    """
    before = earlier.distance if earlier else SLOWEST * last
    fell = before / last if last > 0.0 else FASTEST
    steady = min(earlier.fell, fell) if earlier else FASTEST
    distance = max(last, before / min(max(FASTEST, steady), FASTEST_STEADY))
    rate = max(before / distance, SLOWEST) if distance > 0.0 else SLOWEST
    factor = SAFETY if earlier else FIRST * SAFETY
    return Falling(distance, fell, factor * distance / (rate - 1.0))


def ladders(
    frame: Frame,
    observables: Sequence[Observable],
    *,
    wanted: float,
    work: float,
    threads: int | None,
    progress: Progress,
    reference: Reference | None,
) -> Iterator[Ladder]:
    """Yield solutions of rising degrees, each with the one before it.

    The last one says what ends them: memory, more than ``work``, or that not even the L1 error
    ``wanted`` can be met by then. ``threads`` and ``reference`` as of ``PhaseSpace``.
    """
    about = reference or gibbs_reference(frame)

    def why_not(level: int) -> str:
        degrees = degrees_of(level, frame)
        if degrees.outer > MOST_OUTER:
            return f"a finer solution needs more than {MOST_OUTER} functions of a displacement"
        return refusal(*cost(frame, about, degrees), most=work)

    with threadpool_limits(limits=threads or usable_cores(), user_api="blas"):
        about, first = _fitted_reference(frame, about)
        coarser: Expansion | None = None
        fall: dict[Observable, Falling] = {}
        for level in count():
            degrees = degrees_of(level, frame)
            step = steps(progress, "phase space", degrees)
            again = cost(frame, about, degrees, number=8)[0] <= MEMORY
            finest = first or expanded(frame, about, degrees, again=again, step=step)
            first = None
            if coarser is not None:
                least = _common_distance(frame, finest, coarser)
                own = {o: _distance(frame, finest, coarser, o) for o in observables}
                fall = {o: falling(max(d, least), fall.get(o)) for o, d in own.items()}
                limit = why_not(level + 1) or _out_of_reach(fall, wanted, level, why_not)
                errors = {o: f.error + ROUND_OFF for o, f in fall.items()}
                factors = {o: f.error / own[o] if own[o] > 0.0 else 0.0 for o, f in fall.items()}
                yield Ladder(frame, finest, coarser, errors, factors, limit, level + 1)
                if limit:
                    return
            coarser = finest


def _fitted_reference(frame: Frame, start: Reference) -> tuple[Reference, Expansion | None]:
    """Return the reference with the moments of the lowest solutions, from ``start`` or hotter.

    Beside it the lowest solution where the start has its moments. Raises ``LinAlgError`` where no
    start gives the moments of a distribution.
    """
    for factor in STARTS:
        try:
            return _refitted_from(frame, heated(frame, start, factor) if factor > 1.0 else start)
        except np.linalg.LinAlgError:
            if factor == STARTS[-1]:
                raise
    raise AssertionError("there is a start")


def _refitted_from(frame: Frame, about: Reference) -> tuple[Reference, Expansion | None]:
    for refit in range(REFITS):
        rough = expanded(frame, about, degrees_of(0, frame))
        better = refitted(frame, rough)
        change = np.abs(better.covariance - about.covariance).max()
        if refit == 0 and change <= SETTLED * about.covariance.max():
            return about, rough
        about = better
    return about, None


def solved_to(
    frame: Frame,
    observables: Sequence[Observable],
    *,
    tol: float,
    accepted: float | None = None,
    work: float = WORK,
    threads: int | None = None,
    progress: Progress,
    reference: Reference | None = None,
) -> Ladder:
    """Return the first solution whose L1 errors of all ``observables`` are at most ``tol``.

    Else the last one that ``ladders`` gives, where the error ``accepted`` is wanted.
    """
    for ladder in ladders(
        frame,
        observables,
        wanted=accepted or tol,
        work=work,
        threads=threads,
        progress=progress,
        reference=reference,
    ):
        if max(ladder.errors.values()) <= tol:
            return replace(ladder, limit="")
    return ladder


def _out_of_reach(
    fall: dict[Observable, Falling], wanted: float, level: int, why_not: Callable[[int], str]
) -> str:
    """Say that even the most that is believed of what is allowed does not meet ``wanted``."""
    best = SAFETY * max(f.distance for f in fall.values()) / (FASTEST_STEADY - 1.0)
    while best > wanted:
        level += 1
        if why := why_not(level):
            return f"the tolerance {wanted:.2g} is out of reach: {why}"
        best /= FASTEST_STEADY
    return ""


def refusal(size: float, work: float, *, most: float) -> str:
    """Say why a solution of these bytes and multiplications is not begun; empty where it may."""
    if size > MEMORY:
        return f"a finer solution needs {size / 1e9:.2g} GB of memory, at most {MEMORY / 1e9:.2g}"
    if work > most:
        return f"a finer solution needs {work:.1g} multiplications, at most {most:.1g}"
    return ""


def steps(progress: Progress, what: str, degrees: Degrees) -> Callable[[float], None]:
    """Return the function that reports a share of the work on ``what``."""
    return lambda share: progress(int(100 * share), 100, f"{what}, degree {degrees.total}")


def _common_distance(frame: Frame, a: Expansion, b: Expansion) -> float:
    """Return the least L1 distance that is believed of any density of two solutions.

    With light damping the distance of one density may be small by chance where those of others are
    not. The least is half of the largest change of a covariance, in standard deviations, which is
    about what it changes a Gaussian by in L1, or a quarter of the distance of the densities of the
    contact displacement, if that is more.
    """
    first, second = moments(frame, a).covariance, moments(frame, b).covariance
    if not min(np.diag(first).min(), np.diag(second).min()) > 0.0:
        raise np.linalg.LinAlgError("a variance found is not positive")
    scale = np.sqrt(np.diag(first))
    change = 0.5 * float(np.max(np.abs(first - second) / np.outer(scale, scale)))
    contact = (Coordinate("q", frame.contact),)
    return max(change, 0.25 * _distance(frame, a, b, contact))


def _distance(frame: Frame, a: Expansion, b: Expansion, observable: Observable) -> float:
    """∫|p_a − p_b| on the support of both."""
    first, p = marginal(frame, a, observable)
    second, q = marginal(frame, b, observable)
    mesh, grids = gauss_grid(list(map(np.union1d, first, second)))
    return integral(np.abs(p(*mesh) - q(*mesh)), grids)
