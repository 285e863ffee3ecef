"""Crossings, spectra and relaxation rates to a tolerance, each with its error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.linalg import eigh
from scipy.ndimage import maximum_filter1d
from threadpoolctl import threadpool_limits

from averaging.phase_space.crossings import crossing_rates
from averaging.phase_space.elimination import Degrees, Expansion
from averaging.phase_space.frame import Frame, Reference
from averaging.phase_space.marginals import form_of, marginal
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import (
    FASTEST,
    MEMORY,
    ROUND_OFF,
    SAFETY,
    SLOWEST,
    WORK,
    Ladder,
    cost,
    solved_to,
)
from averaging.phase_space.resolvent import Generator, eigenvalues, times, transforms
from fpk.arrays import Array
from fpk.cores import usable_cores
from fpk.dynamics import Complex
from fpk.method import Progress
from fpk.observable import Coordinate, Observable

Value = TypeVar("Value")

GRID, WINDOW = 181, 11
"""Levels between the ends of the support at which the distance of crossing rates is sampled, and
over how many of them its largest value is taken: it does not vanish where the error is not small.
"""
HIGHEST = 1.5
"""Frequency up to which eigenvalues are sought, in units of the highest one of the motion."""


@dataclass(frozen=True, eq=False)
class Compared:
    """Values by the last solution of a ladder, and their ``distance`` to those by the one before.

    ``scale`` is what a tolerance is relative to. ``added`` is an error beside the one that follows
    from the distance, ``residual`` that of equations beyond those of the densities; ``complete``
    is the real part up to which no eigenvalue is missed.
    """

    values: Array | Complex
    distance: Array
    scale: Array
    added: Array | float = 0.0
    residual: float = 0.0
    complete: float = np.inf


@dataclass(frozen=True, eq=False)
class Answer:
    """What was compared last, on which ladder, and the errors that follow from all distances.

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
Options = tuple[float, Progress, Reference | None]
"""Tolerance, progress, and where the expansion starts."""


def crossings(frame: Frame, row: int, at: Array, options: Options) -> Answer:
    """Return the rates of upcrossing of the levels ``at``; their scale is σ_v/(2πσ_q).

    The distance is the largest one about a level. What flows past the level is added to the error.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (ends,), _ = marginal(frame, ladder.finest, q)
        grid = np.linspace(ends[0], ends[-1], GRID)
        (fine, net), (coarse, _) = (
            crossing_rates(frame, e, row, np.append(grid, at))
            for e in (ladder.finest, ladder.coarser)
        )
        distance = np.abs(fine - coarse)
        about = np.interp(at, grid, maximum_filter1d(distance[:GRID], WINDOW))
        sizes = _sizes(frame, ladder.finest, row)
        return Compared(
            fine[GRID:],
            np.maximum(about, distance[GRID:]),
            np.array(sizes[1] / (2.0 * np.pi * sizes[0])),
            added=np.abs(net[GRID:]),
        )

    return _adapted(frame, [q, p], compare, options)


def spectrum(frame: Frame, row: int, at: Array, options: Options) -> Answer:
    """Return the power spectral density S of q at ``at``; its scale is σ_q³/σ_v.

    S(ω) = Re G(iω)/π, G(s) = ∫ q' (s − L)⁻¹ q' p, q' = q less its mean. Where S happens to be the
    same in both solutions, on the flank of a peak that moves, Im G is not: the distance is that of
    all of G, less what its first terms at high frequency have of it, σ_q²/s − σ_v²/s³, in which S
    has no part: G − σ_q² (s + κ)/(s² + κ s + κ²), κ = σ_v/σ_q.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)
    w, place = np.unique(np.abs(at), return_inverse=True)

    def measured(e: Expansion, progress: Progress) -> tuple[Complex, float]:
        A = Generator.of(frame, e, odd=e.basis.mirrored)
        form = form_of(frame, e, q[0])
        form = replace(form, offset=form.offset - _mean(frame, e, row))
        b = times(e, e.levels, form, A)
        # The state of the reference alone is 1 in level 0: times it, ∫ q' … is a product with c.
        reference = [np.zeros_like(u) for u in e.levels]
        reference[0][0] = e.basis.of_one(0)
        c = times(e, tuple(reference), form, A)
        return transforms(A, c, b, w, _steps(progress, "spectrum", e.degrees))

    once = _once(measured)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (fine, residual), (coarse, _) = (once(e, progress) for e in (ladder.finest, ladder.coarser))
        sizes = [_sizes(frame, e, row) for e in (ladder.finest, ladder.coarser)]
        first, second = (
            q**2 * (1j * w + v / q) / ((1j * w) ** 2 + 1j * w * v / q + (v / q) ** 2)
            for q, v in sizes
        )
        distance = np.abs(fine - coarse - (first - second))
        distance = np.maximum(distance, np.abs((fine - coarse).real)) / np.pi
        scale = np.array(sizes[0][0] ** 3 / sizes[0][1])
        return Compared(fine.real[place] / np.pi, distance[place], scale, residual=residual)

    # A momentum, so that all levels of the stationary state are computed.
    return _adapted(frame, [q, p], compare, options)


def relaxation(frame: Frame, count: int, options: Options) -> Answer:
    """Return the ``count`` eigenvalues λ of −L with the least Re λ > 0, Im λ >= 0; scale: |λ|.

    Sought up to ``HIGHEST`` times the highest frequency ω of E v vᵀ − ω² E q qᵀ. The distance of
    each is that to the nearest one of the coarser solution.
    """
    momentum = (Coordinate("p", frame.contact),)

    def measured(e: Expansion, progress: Progress) -> tuple[Complex, float]:
        m, n = moments(frame, e).covariance, frame.n
        highest = HIGHEST * float(np.sqrt(eigh(m[n:, n:], m[:n, :n], eigvals_only=True)[-1]))
        step = _steps(progress, "relaxation", e.degrees)
        parities = (False, True) if e.basis.mirrored else (False,)
        parts = [eigenvalues(Generator.of(frame, e, odd=odd), highest, step) for odd in parities]
        return np.concatenate([x for x, _ in parts]), min(complete for _, complete in parts)

    once = _once(measured)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (fine, complete), (coarse, _) = (once(e, progress) for e in (ladder.finest, ladder.coarser))
        slowest = fine[np.argsort(fine.real)][:count]
        distance = np.min(np.abs(slowest[:, None] - coarse), axis=1)
        return Compared(slowest, distance, np.abs(slowest), complete=complete)

    return _adapted(frame, [momentum], compare, options)


def _adapted(
    frame: Frame, observables: Sequence[Observable], compare: Compare, options: Options
) -> Answer:
    """Return the first answer with a relative error of at most the tolerance, else the finest one.

    As for densities: the error is ``SAFETY`` d/(r − 1), r the factor by which the largest relative
    distance d falls from one solution to the next.
    """
    tol, progress, reference = options
    at_least, before, answer = 2, np.inf, None
    while True:
        ladder = solved_to(
            frame,
            observables,
            tol=tol,
            progress=progress,
            reference=reference,
            at_least=at_least,
        )
        limit = ladder.limit if ladder.solutions < at_least else _refusal(frame, ladder)
        if answer is not None and limit:
            return replace(answer, limit=limit)
        with threadpool_limits(limits=usable_cores(), user_api="blas"):
            last = compare(ladder, progress)
        own = float(np.max(last.distance / last.scale))
        before = before if np.isfinite(before) else SLOWEST * own
        # A distance may be small by chance: it is believed to fall no faster than this.
        least = max(own, before / FASTEST)
        rate = max(before / least, SLOWEST) if least > 0.0 else SLOWEST
        factor = SAFETY / (rate - 1.0) * (least / own if own > 0.0 else 1.0)
        errors = factor * last.distance + last.added + ROUND_OFF * last.scale
        answer = Answer(last, ladder, np.broadcast_to(errors, last.distance.shape), "")
        if answer.relative <= tol:
            return answer
        if ladder.limit:
            return replace(answer, limit=ladder.limit)
        at_least, before = ladder.solutions + 1, least


def _refusal(frame: Frame, ladder: Ladder) -> str:
    """Why an elimination in complex numbers with the degrees of the last solution is not begun."""
    size, work = (2.0 * x for x in cost(frame, ladder.finest.degrees, whole=True))
    if size > MEMORY:
        return f"a finer one needs {size / 1e9:.2g} GB of memory, at most {MEMORY / 1e9:.2g}"
    if 2.0 * work > WORK:
        return f"a finer one needs {2.0 * work:.1g} multiplications, at most {WORK:.1g}"
    return ""


def _once(
    measured: Callable[[Expansion, Progress], Value],
) -> Callable[[Expansion, Progress], Value]:
    """Return the function with the values of earlier calls, by their degrees."""
    values: dict[Degrees, Value] = {}

    def once(e: Expansion, progress: Progress) -> Value:
        if e.degrees not in values:
            values[e.degrees] = measured(e, progress)
        return values[e.degrees]

    return once


def _mean(frame: Frame, e: Expansion, row: int) -> float:
    place = frame.order.index(row)
    return float(moments(frame, e).mean[place] / np.sqrt(frame.system.mass[row]))


def _sizes(frame: Frame, e: Expansion, row: int) -> tuple[float, float]:
    """Standard deviations of q and of the velocity."""
    place, variances = frame.order.index(row), np.diag(moments(frame, e).covariance)
    q, v = np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row])
    return float(q), float(v)


def _steps(progress: Progress, what: str, degrees: Degrees) -> Callable[[float], None]:
    return lambda share: progress(int(100 * share), 100, f"{what}, degree {degrees.total}")
