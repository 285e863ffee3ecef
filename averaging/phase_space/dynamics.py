"""Crossings, spectra, autocovariances and relaxation rates to a tolerance, with their errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.ndimage import maximum_filter1d

from averaging.phase_space.crossings import crossing_rates
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.marginals import Form, form_of, marginal
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import (
    ROUND_OFF,
    Ladder,
    cost,
    falling,
    ladders,
    refusal,
    steps,
)
from averaging.phase_space.resolvent import (
    Generator,
    Step,
    decays,
    rates_in,
    times,
    transforms,
)
from fpk.arrays import Array, Complexes
from fpk.method import Progress
from fpk.observable import Coordinate, Observable

Value = TypeVar("Value")

GRID, WINDOW = 181, 11
"""Levels between the ends of the support at which the distance of crossing rates is sampled, and
over how many of them its largest value is taken: it does not vanish where the error is not small.
"""
REAL, COMPLEX = 8, 16
"""Bytes of a number in double precision: the resolvent is eliminated in one or the other."""
SPACE = 1e-3
"""Share of the tolerance at which the space that a correlation is taken from is large enough."""
SAME = 1e-6
"""Relative distance of two rates of different correlations that are one."""


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
    work: float
    threads: int | None
    reference: Reference | None


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

    def measured(
        e: Expansion, A: Generator, c: Array, b: Array, step: Step
    ) -> tuple[Complexes, float]:
        return transforms(A, c, b, w, step)

    once = _of_displacement(frame, row, "spectrum", measured)

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


def correlation(frame: Frame, row: int, at: Array, options: Options) -> Answer:
    """Return the autocovariance C of q at the lags ``at``; its scale is σ_q².

    C(t) = ∫ q' e^(Lt) q' p. Where C happens to be the same in both solutions, as of oscillations of
    unlike frequencies, C' is not: the distance is that of C + i C'/κ, κ = 2 σ_v/σ_q.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)

    def measured(e: Expansion, A: Generator, c: Array, b: Array, step: Step) -> tuple[Array, float]:
        size, velocity = _sizes(frame, e, row)
        rate, tol = 2.0 * velocity / size, SPACE * options.tol
        values, error = decays(A, c, b, at, rate, step, tol=tol)
        return values, error + abs(float(c @ b) - size**2)

    once = _of_displacement(frame, row, "correlation", measured)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (fine, error), (coarse, _) = (once(e, progress) for e in (ladder.finest, ladder.coarser))
        scale = np.array(_sizes(frame, ladder.finest, row)[0] ** 2)
        return Compared(fine[0], np.hypot(*(fine - coarse)), scale, added=error)

    return _adapted(frame, [q, p], compare, options, number=REAL)


def relaxation(frame: Frame, count: int, options: Options) -> Answer:
    """Return the ``count`` slowest rates λ of correlations, Im λ >= 0; their scale is |λ|.

    Of those that the correlations of displacements with themselves show, and those of their
    squares: e^(−λt) with a share of ``SEEN`` and more. They are eigenvalues of −L. The distance of
    each is that to the nearest one of the coarser solution.
    """
    momentum = (Coordinate("p", frame.contact),)

    def measured(e: Expansion, progress: Progress) -> tuple[Complexes, float]:
        step = steps(progress, "relaxation", e.degrees)
        odd = Generator.of(frame, e, odd=e.basis.mirrored)
        even = Generator.of(frame, e, odd=False) if e.basis.mirrored else odd
        stationary = even.packed(e.levels)
        solve, answers = odd.resolvent(0.0, step), []
        for row in range(frame.n):
            c, b = _displaced(frame, e, row, odd)
            answers.append(rates_in(solve, c, b))
        solve = even.resolvent(0.0, step) if e.basis.mirrored else solve
        for row in range(frame.n):
            form = _form(frame, e, row)
            c, b = (
                times(odd.functions, odd.shaped(x), form, even)
                for x in _displaced(frame, e, row, odd)
            )
            mean = float(even.one @ even.split(b)[0])
            answers.append(rates_in(solve, c, b - mean * stationary))
        return np.concatenate([x for x, _ in answers]), min(end for _, end in answers)

    once = _once(measured)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (fine, end), (coarse, _) = (once(e, progress) for e in (ladder.finest, ladder.coarser))
        slowest = _unlike(fine[np.argsort(fine.real)])[:count]
        distance = np.min(np.abs(slowest[:, None] - coarse), axis=1, initial=np.abs(slowest).max())
        return Compared(slowest, distance, np.abs(slowest), end=end)

    return _adapted(frame, [momentum], compare, options)


def _unlike(rates: Complexes) -> Complexes:
    """``rates`` without those that an earlier one equals: several correlations show one rate."""
    return np.array(
        [x for k, x in enumerate(rates) if not np.any(np.abs(rates[:k] - x) <= SAME * abs(x))]
    )


def _adapted(
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
        work=options.work,
        threads=options.threads,
        progress=options.progress,
        reference=options.reference,
    ):
        if max(ladder.errors.values()) > options.tol and not ladder.limit:
            continue
        e = ladder.finest
        size, work = cost(frame, e.basis.reference, e.degrees, number=number)
        # A product of complex numbers takes four multiplications.
        limit = refusal(size, (number / REAL) ** 2 * work, most=options.work)
        if answer is not None and limit:
            return replace(answer, limit=limit)
        last = compare(ladder, options.progress)
        own = float(np.max(last.distance / last.scale))
        fall = falling(own, fall)
        factor = fall.error / own if own > 0.0 else 0.0
        errors = factor * last.distance + last.added + ROUND_OFF * last.scale
        answer = Answer(last, ladder, np.broadcast_to(errors, last.distance.shape), "")
        if answer.relative <= options.tol:
            return answer
        answer = replace(answer, limit=ladder.limit)
    assert answer is not None
    return answer


def _of_displacement(
    frame: Frame,
    row: int,
    what: str,
    measured: Callable[[Expansion, Generator, Array, Array, Step], Value],
) -> Callable[[Expansion, Progress], Value]:
    """``measured`` of A and both vectors of ``_displaced``, once for each expansion."""

    def value(e: Expansion, progress: Progress) -> Value:
        A = Generator.of(frame, e, odd=e.basis.mirrored)
        return measured(e, A, *_displaced(frame, e, row, A), steps(progress, what, e.degrees))

    return _once(value)


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


def _form(frame: Frame, e: Expansion, row: int) -> Form:
    """A displacement less its mean, in its own unit."""
    form, place = form_of(frame, e, Coordinate("q", row)), frame.order.index(row)
    mean = moments(frame, e).mean[place] / np.sqrt(frame.system.mass[row])
    return replace(form, offset=form.offset - float(mean))


def _displaced(frame: Frame, e: Expansion, row: int, A: Generator) -> tuple[Array, Array]:
    """q' of a mass times the state of the reference alone, 1 in level 0, and times p, for ``A``.

    A product with the first is ∫ q' ….
    """
    form = _form(frame, e, row)
    reference = [np.zeros_like(u) for u in e.levels]
    reference[0][0] = e.basis.of_one()
    return times(e.basis, reference, form, A), times(e.basis, e.levels, form, A)


def _sizes(frame: Frame, e: Expansion, row: int) -> tuple[float, float]:
    """Standard deviations of q and of the velocity."""
    place, variances = frame.order.index(row), np.diag(moments(frame, e).covariance)
    q, v = np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row])
    return float(q), float(v)
