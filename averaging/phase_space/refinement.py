"""Degrees and reference that adapt until the distance to the coarser solution meets a tolerance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from averaging.phase_space.degrees import Degrees
from averaging.phase_space.elimination import Expansion, expanded, sizes
from averaging.phase_space.frame import Frame, Reference, gibbs_reference
from averaging.phase_space.marginals import marginal, needs_all_levels
from averaging.phase_space.moments import moments, refitted
from fpk.cores import usable_cores
from fpk.density import gauss_grid, integral
from fpk.method import Progress
from fpk.observable import Coordinate, Observable

REFITS = 2
"""Solutions of the lowest degrees from which the reference takes its moments: the second changes
the first by less than a thousandth of what the degrees leave."""
SLOWEST, FASTEST = 1.5, 2.0
"""Factors by which the error is believed to fall from one solution to the next, at the least and
at the most, whatever the last two distances say."""
FASTEST_STEADY = 3.0
"""The most where the distance has fallen by no less the step before."""
SAFETY = 3.0
"""Factor on the error that follows from the last two distances between solutions. Of 496 errors of
51 random systems against finer solutions, 0.99 of the stated one was the most and three in a
hundred were above a half; with 3 for a single step, too, ten were above it, up to 2.4 times."""
ROUND_OFF = 1e-11
"""L1 error of the arithmetic in double precision: on exact densities it was up to 2.3e-12."""
MEMORY = 4.0e9
"""Bytes that a solution may need; one that needs more is not begun."""
WORK = 1.0e13
"""Multiplications that a solution may need, some two minutes on two cores; likewise."""


@dataclass(frozen=True, eq=False)
class Ladder:
    """A solution, the coarser one before it, and the L1 error of each observable.

    ``errors`` is by observable, and ``factors`` the error over the distance of the two solutions;
    ``limit`` says in words why no finer solution was made, empty where the tolerance is met.
    ``solutions`` is how many were made.
    """

    frame: Frame
    finest: Expansion
    coarser: Expansion
    errors: dict[Observable, float]
    factors: dict[Observable, float]
    limit: str
    solutions: int


def degrees_of(level: int, n: int) -> Degrees:
    """Return the degrees of a level of refinement, from 0, so that all have like errors."""
    if n == 1:
        return Degrees(16 + 8 * level, 0, 18 + 4 * level)
    if n == 2:
        return Degrees(16 + 6 * level, 6 + 2 * level, 18 + 2 * level)
    return Degrees(10 + 4 * level, 4 + level, 12 + 2 * level)


def cost(
    frame: Frame, reference: Reference, degrees: Degrees, *, whole: bool
) -> tuple[float, float]:
    """Return the bytes and the multiplications that a solution takes."""
    size = sizes(frame, reference, degrees)
    stored = np.sum(size**2) if whole else 0.0
    return 8.0 * float(8.0 * np.max(size) ** 2 + stored), float(4.0 * np.sum(size**3))


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
    at_least: int = 2,
) -> Ladder:
    """Return the first solution whose L1 errors of all ``observables`` are at most ``tol``.

    From level to level the error of an observable falls by a factor r, judged from the last two
    distances d between solutions; it is d/(r − 1) at the last one. Where solutions that need more
    than ``work`` would be called for, the last before them is returned, early if not even the error
    ``accepted`` can be met by then. ``reference`` is where to start, None for the Gibbs state.
    ``at_least`` is how many solutions are made where none is refused.
    """
    whole = any(needs_all_levels(frame, o) for o in observables)
    about = reference or gibbs_reference(frame)

    def why_not(level: int) -> str:
        degrees = degrees_of(level, frame.n)
        return _refusal(*cost(frame, about, degrees, whole=whole), most=work)

    with threadpool_limits(limits=threads or usable_cores(), user_api="blas"):
        for _ in range(REFITS):
            first = expanded(frame, about, degrees_of(0, frame.n), whole=False)
            about = refitted(frame, first)
        solutions: list[Expansion] = []
        distance: dict[Observable, float] = {}
        fell: dict[Observable, float] = {}
        factors = dict.fromkeys(observables, np.inf)
        errors = dict.fromkeys(observables, np.inf)
        limit = ""
        while len(solutions) < at_least or not max(errors.values()) <= tol:
            limit = why_not(len(solutions))
            if len(solutions) > 1:
                # Even if all that is allowed gained the most that is believed.
                wanted, left = accepted or tol, len(solutions)
                best = SAFETY * max(distance.values()) / (FASTEST_STEADY - 1.0)
                while best > wanted and not (why := why_not(left)):
                    best, left = best / FASTEST_STEADY, left + 1
                if best > wanted:
                    limit = f"the tolerance {wanted:.2g} is out of reach: {why}"
                if limit:
                    break
            degrees = degrees_of(len(solutions), frame.n)
            step = _steps(progress, degrees)
            solutions.append(expanded(frame, about, degrees, whole=whole, step=step))
            if len(solutions) == 1:
                continue
            least = _common_distance(frame, solutions[-1], solutions[-2])
            for o in errors:
                own = _distance(frame, solutions[-1], solutions[-2], o)
                last = max(own, least)
                # A distance may be small by chance: it is believed to fall no faster than this.
                before, steady = distance.get(o, SLOWEST * last), fell.get(o, FASTEST)
                fell[o] = before / last if last > 0.0 else FASTEST
                fastest = min(max(FASTEST, min(steady, fell[o])), FASTEST_STEADY)
                distance[o] = max(last, before / fastest)
                rate = max(before / distance[o], SLOWEST) if distance[o] > 0.0 else SLOWEST
                error = SAFETY * distance[o] / (rate - 1.0)
                errors[o] = error + ROUND_OFF
                factors[o] = error / own if own > 0.0 else 0.0
    coarser, finest = solutions[-2:]
    return Ladder(frame, finest, coarser, errors, factors, limit, len(solutions))


def _refusal(size: float, work: float, *, most: float) -> str:
    if size > MEMORY:
        return f"a finer solution needs {size / 1e9:.2g} GB of memory, at most {MEMORY / 1e9:.2g}"
    if work > most:
        return f"a finer solution needs {work:.1g} multiplications, at most {most:.1g}"
    return ""


def _steps(progress: Progress, degrees: Degrees) -> Callable[[float], None]:
    def step(share: float) -> None:
        progress(int(100 * share), 100, f"phase space, degree {degrees.total}")

    return step


def _common_distance(frame: Frame, a: Expansion, b: Expansion) -> float:
    """Return the least L1 distance that is believed of any density of two solutions.

    With light damping the distance of one density may be small by chance where those of others are
    not. The least is half of the largest change of a covariance, in standard deviations, which is
    about what it changes a Gaussian by in L1, or a quarter of the distance of the densities of the
    contact displacement, if that is more.
    """
    first, second = moments(frame, a).covariance, moments(frame, b).covariance
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
