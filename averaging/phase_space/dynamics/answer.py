"""Answers that follow from expansions: to a tolerance, with their errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from averaging.phase_space.equation.elimination import Expansion, cost
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import (
    ROUND_OFF,
    Bounds,
    Ladder,
    falling,
    kept,
    ladders,
)
from fpk.arrays import Array, Complexes
from fpk.method import Progress
from fpk.observable import Observable

REAL, COMPLEX = 8, 16
"""Bytes of a number in double precision: the resolvent is eliminated in one or the other."""


@dataclass(frozen=True, eq=False)
class Compared:
    """Values by the last solution of a ladder, and their ``distance`` to those by the one before.

    ``scale`` is what a tolerance is relative to. ``added`` is an error beside the one that follows
    from the distance, ``residual`` that of equations beyond those of the densities; ``missing``
    says which values may not be those asked for, empty where all are.
    """

    values: Array | Complexes
    distance: Array
    scale: Array
    added: Array | float = 0.0
    residual: float = 0.0
    missing: str = ""


@dataclass(frozen=True, eq=False)
class Answer:
    """Values with their errors, from two expansions and the distances of coarser ones.

    ``last`` holds the values, ``ladder`` the two expansions, ``errors`` the error of each value.
    ``limit`` says why there is no finer answer, empty where the tolerance is met.
    """

    last: Compared
    ladder: Ladder
    errors: Array
    limit: str

    @property
    def relative(self) -> float:
        """The largest error in units of the scale."""
        return float(np.max(self.errors / self.last.scale))


Compare = Callable[[Ladder, Progress], Compared]


class Options(NamedTuple):
    """The relative error wanted, and the settings of ``PhaseSpace`` for how to get it."""

    tol: float
    progress: Progress
    bounds: Bounds
    threads: int | None
    reference: Reference | None


def adapted(
    frame: Frame,
    observables: Sequence[Observable],
    compare: Compare,
    options: Options,
    *,
    number: int = COMPLEX,
) -> Answer:
    """Return the first answer with a relative error of at most the tolerance, else the best one.

    ``number`` is how many bytes a number of the resolvent's elimination has.

    The error follows from the largest relative distance as that of densities does, which meet the
    tolerance, too, unless there is no finer solution.
    """
    answer, fall = None, None
    for ladder in ladders(
        frame,
        observables,
        bounds=options.bounds,
        threads=options.threads,
        progress=options.progress,
        reference=options.reference,
    ):
        e = ladder.finest
        size, work = cost(e.basis, e.degrees, number=number)
        # A product of complex numbers takes four of real ones.
        limit = ladder.limit or options.bounds.refusal(size, (number / REAL) ** 2 * work)
        if answer is not None and limit:
            # A ladder with a limit is yielded again, as there is no finer one.
            return replace(answer, limit="" if answer.relative <= options.tol else limit)
        last = compare(ladder, options.progress)
        own = float(np.max(last.distance / last.scale))
        fall = falling(own, fall, kept(frame))
        factor = fall.error / own if own > 0.0 else 0.0
        errors = factor * last.distance + last.added + ROUND_OFF * last.scale
        later = Answer(last, ladder, np.broadcast_to(errors, last.distance.shape), "")
        answer = later if answer is None else better(answer, later)
        if max(answer.relative, *ladder.errors.values()) <= options.tol:
            return answer
    assert answer is not None
    return answer


def better(earlier: Answer, later: Answer) -> Answer:
    """Return the earlier answer if its error is the smaller one and the later one agrees with it.

    The values of the later answer, of a finer solution, are then within the errors of the earlier.
    """
    a, b = ((bool(x.last.missing), x.relative) for x in (earlier, later))
    u, v = earlier.last.values, later.last.values
    agreed = u.shape == v.shape and bool(np.all(np.abs(u - v) <= earlier.errors))
    return earlier if a <= b and agreed else later


def deviations(frame: Frame, e: Expansion, row: int) -> tuple[float, float]:
    """Return the standard deviations of q and of the velocity of mass ``row``."""
    place, variances = frame.order.index(row), np.diag(moments(frame, e).covariance)
    q, v = np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row])
    return float(q), float(v)
