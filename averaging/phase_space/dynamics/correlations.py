"""Spectra and autocovariances of displacements, and relaxation rates, of the FPK operator."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from averaging.phase_space.dynamics.answer import (
    COMPLEX,
    REAL,
    Answer,
    Compared,
    Options,
    adapted,
    deviations,
)
from averaging.phase_space.dynamics.resolvent import (
    DISCS,
    Generator,
    Step,
    decays,
    slowest_rates,
    times,
    transforms,
)
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import Expansion, cost
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import Form, form_of
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import Ladder, steps
from fpk.arrays import Array, Complexes
from fpk.method import Progress
from fpk.observable import Coordinate

Value = TypeVar("Value")

SPACE = 1e-3
"""Share of the tolerance at which the space that a correlation is taken from is large enough."""


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
        sizes = [deviations(frame, e, row) for e in (ladder.finest, ladder.coarser)]
        first, second = (
            q**2 * (1j * w + v / q) / ((1j * w) ** 2 + 1j * w * v / q + (v / q) ** 2)
            for q, v in sizes
        )
        distance = np.abs(fine - coarse - (first - second))
        distance = np.maximum(distance, np.abs((fine - coarse).real)) / np.pi
        scale = np.array(sizes[0][0] ** 3 / sizes[0][1])
        return Compared(fine.real[place] / np.pi, distance[place], scale, residual=residual)

    # A momentum, so that all levels of the stationary state are computed.
    return adapted(frame, [q, p], compare, options)


def correlation(frame: Frame, row: int, at: Array, options: Options) -> Answer:
    """Return the autocovariance C of q at the lags ``at``; its scale is σ_q².

    C(t) = ∫ q' e^(Lt) q' p. Where C happens to be the same in both solutions, as of oscillations of
    unlike frequencies, C' is not: the distance is that of C + i C'/κ, κ = 2 σ_v/σ_q.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)

    def measured(e: Expansion, A: Generator, c: Array, b: Array, step: Step) -> tuple[Array, float]:
        size, velocity = deviations(frame, e, row)
        rate, tol = 2.0 * velocity / size, SPACE * options.tol
        values, error = decays(A, c, b, at, rate, step, tol=tol)
        return values, error + abs(float(c @ b) - size**2)

    once = _of_displacement(frame, row, "correlation", measured)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (fine, error), (coarse, _) = (once(e, progress) for e in (ladder.finest, ladder.coarser))
        scale = np.array(deviations(frame, ladder.finest, row)[0] ** 2)
        return Compared(fine[0], np.hypot(*(fine - coarse)), scale, added=error)

    return adapted(frame, [q, p], compare, options, number=REAL)


def relaxation(frame: Frame, count: int, options: Options) -> Answer:
    """Return the ``count`` slowest eigenvalues λ of −L, Im λ >= 0; their scale is |λ|.

    Each stands as often as it occurs. The distance of each is that to the rate of the coarser
    solution that it is paired with: all pairs are the nearest.
    """
    momentum = (Coordinate("p", frame.contact),)

    def measured(e: Expansion, progress: Progress) -> tuple[Complexes, str]:
        step = steps(progress, "relaxation", e.degrees)
        parities = (True, False) if e.basis.mirrored else (False,)
        parts = [Generator.of(frame, e, odd=odd, closed=True) for odd in parities]
        # A product of complex numbers takes four of real ones.
        work = len(parts) * (COMPLEX / REAL) ** 2 * cost(e.basis, e.degrees, number=COMPLEX)[1]
        most = min(DISCS, int(options.bounds.work / work))
        # The largest natural frequency of the linear system with the covariances of the solution.
        q, v = np.split(moments(frame, e).covariance, 2)
        squares = np.linalg.eigvals(np.linalg.solve(q[:, : frame.n], v[:, frame.n :]))
        fastest = float(np.sqrt(squares.real.max()))
        return slowest_rates(parts, count, fastest, most=most, step=step)

    once = _once(measured)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        rates, missing = once(ladder.finest, progress)
        slowest = rates[:count]
        apart = np.abs(slowest[:, None] - once(ladder.coarser, progress)[0])
        distance = np.abs(slowest)
        rows, columns = linear_sum_assignment(apart)
        distance[rows] = apart[rows, columns]
        return Compared(slowest, distance, np.abs(slowest), missing=missing)

    return adapted(frame, [momentum], compare, options)


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
