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
    from the distance, ``residual`` that of equations beyond those of the densities; ``end``
    is the modulus up to which eigenvalues are known.
    """

    values: Array | Complexes
    distance: Array
    scale: Array
    added: Array | float = 0.0
    residual: float = 0.0
    end: float = np.inf


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
    """Return the first answer with a relative error of at most the tolerance, else the finest one.

    ``number`` is how many bytes a number of the resolvent's elimination has.

    The error follows from the largest relative distance as that of densities does, which are solved
    to the tolerance before.
    """
    answer, fall = None, None
    for ladder in ladders(
        frame,
        observables,
        wanted=options.tol,
        bounds=options.bounds,
        threads=options.threads,
        progress=options.progress,
        reference=options.reference,
    ):
        if max(ladder.errors.values()) > options.tol and not ladder.limit:
            continue
        if answer is not None and ladder.finest is answer.ladder.finest:
            # Yielded again, as there is no finer one.
            return replace(answer, limit=ladder.limit)
        e = ladder.finest
        size, work = cost(e.basis, e.degrees, number=number)
        # A product of complex numbers takes four of real ones.
        limit = options.bounds.refusal(size, (number / REAL) ** 2 * work)
        if answer is not None and limit:
            return replace(answer, limit=limit)
        last = compare(ladder, options.progress)
        own = float(np.max(last.distance / last.scale))
        fall = falling(own, fall, kept(frame))
        factor = fall.error / own if own > 0.0 else 0.0
        errors = factor * last.distance + last.added + ROUND_OFF * last.scale
        answer = Answer(last, ladder, np.broadcast_to(errors, last.distance.shape), "")
        if answer.relative <= options.tol:
            return answer
        answer = replace(answer, limit=ladder.limit)
    assert answer is not None
    return answer


def deviations(frame: Frame, e: Expansion, row: int) -> tuple[float, float]:
    """Return the standard deviations of q and of the velocity of mass ``row``."""
    place, variances = frame.order.index(row), np.diag(moments(frame, e).covariance)
    q, v = np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row])
    return float(q), float(v)
