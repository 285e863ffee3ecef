"""Crossings, spectra, autocovariances and relaxation rates: to a tolerance, with their errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment

from averaging.phase_space.densities import GRID
from averaging.phase_space.dynamics.resolvent import (
    DISCS,
    Step,
    decays,
    displaced,
    generator,
    slowest_rates,
    transforms,
)
from averaging.phase_space.equation.elimination import Expansion, cost
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import SPAN, marginal, moments
from averaging.phase_space.refinement import ROUND_OFF, Ladder, Options, falling, kept, ladders
from fpk.answer.observable import Coordinate, Observable
from fpk.numeric.arrays import Array, Complexes
from fpk.numeric.quadrature import gauss_grid

Value = TypeVar("Value")


SPACE = 1e-3
"""Share of the tolerance at which the space that a correlation is taken from is large enough."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Values by the last solution of a ladder, with the error of each.

    Before they are judged (``adapted``) ``errors`` are the distances to those of the coarser
    solution. A tolerance is relative to ``scale``. ``added`` is an error beside the one that
    follows from the distance, ``residual`` that of equations beyond those of the densities.
    ``missing`` says which values may not be those asked for, ``limit`` why there is no finer
    answer; both are empty where nothing is amiss.
    """

    ladder: Ladder
    values: Array | Complexes
    errors: Array
    scale: Array
    added: Array | float = 0.0
    residual: float = 0.0
    missing: str = ""
    limit: str = ""

    @property
    def relative(self) -> float:
        """The largest error in units of the scale."""
        return float(np.max(self.errors / self.scale))


def adapted(
    frame: Frame,
    observables: Sequence[Observable],
    measure: Callable[[Expansion, Step], Value],
    compare: Callable[[Ladder, Value, Value], Answer],
    options: Options,
    *,
    tol: float,
    what: str,
    numbers: type = complex,
) -> Answer:
    """Return the first answer with a relative error of at most ``tol``, else the best one.

    ``measure`` is called once for each solution, ``compare`` with a ladder and the values of its
    finest and coarser one. ``numbers`` are those of the resolvent's elimination, real or complex,
    ``what`` the words that progress is reported by. The error follows from the largest relative
    distance as that of densities does, which meet the tolerance, too, unless there is no finer
    solution. An earlier answer of a smaller error is kept if the later one agrees within it.
    """

    def measured(e: Expansion) -> Value:
        return measure(e, options.step(what, e.basis.degrees))

    answer: Answer | None = None
    believed: float | None = None
    fine: Value | None = None
    for ladder in ladders(frame, observables, options):
        limit = ladder.limit or options.refusal(*cost(ladder.finest.basis, numbers=numbers))
        if answer is not None and limit:
            # A ladder with a limit is yielded again, as there is no finer one.
            return replace(answer, limit="" if answer.relative <= tol else limit)
        coarse = measured(ladder.coarser) if fine is None else fine
        fine = measured(ladder.finest)
        later = compare(ladder, fine, coarse)
        own = later.relative
        believed, error = falling(own, believed, kept(frame))
        errors = (error / own if own > 0.0 else 0.0) * later.errors + later.added
        errors = np.broadcast_to(errors + ROUND_OFF * later.scale, later.errors.shape)
        later = replace(later, errors=errors)
        if not (
            answer is not None
            and (bool(answer.missing), answer.relative) <= (bool(later.missing), later.relative)
            and answer.values.shape == later.values.shape
            and np.all(np.abs(answer.values - later.values) <= answer.errors)
        ):
            answer = later
        if max(answer.relative, *ladder.errors.values()) <= tol:
            break
    assert answer is not None
    return answer


def deviations(e: Expansion, row: int) -> Array:
    """Return the standard deviations of q and of the velocity of mass ``row``."""
    frame, variances = e.basis.frame, np.diag(moments(e)[1])
    place = frame.order.index(row)
    return np.asarray(np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row]))


def crossings(frame: Frame, row: int, at: Array, options: Options, *, tol: float) -> Answer:
    """Return the rates of upcrossing of the levels ``at``; their scale is σ_v/(2πσ_q).

    The distance is the largest one about a level. What flows past the level is added to the error.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)

    def compare(ladder: Ladder, fine: Expansion, coarse: Expansion) -> Answer:
        ((ends,), _), count = marginal(fine, q), GRID[2]
        grid = np.linspace(ends[0], ends[-1], count)
        (up, net), (before, _) = (
            crossing_rates(e, row, np.append(grid, at)) for e in (fine, coarse)
        )
        distance = np.abs(up - before)
        about = np.interp(at, grid, maximum_filter1d(distance[:count], count // SPAN + 1))
        size, velocity = deviations(fine, row)
        scale, errors = velocity / (2.0 * np.pi * size), np.maximum(about, distance[count:])
        return Answer(ladder, up[count:], errors, np.array(scale), added=np.abs(net[count:]))

    def solution(e: Expansion, step: Step) -> Expansion:
        return e

    return adapted(frame, [q, p], solution, compare, options, tol=tol, what="crossings")


def crossing_rates(e: Expansion, row: int, at: Array) -> tuple[Array, Array]:
    """Return ∫_0^∞ v f(a, p) dp for the levels a of ``at``, and ∫ v f(a, p) dp.

    The first is the rate of upcrossings (Rice); the second, all probability that flows past a
    level, vanishes in a stationary state, and is an error of the first.
    """
    axes, pdf = marginal(e, (Coordinate("q", row), Coordinate("p", row)))
    _, [(p, w)] = gauss_grid([np.union1d(axes[1], 0.0)])
    flux = w * p / e.basis.frame.system.mass[row]
    up, net = np.zeros(at.size), np.zeros(at.size)
    # Arrays are as large as the levels of a part times all points of p and y.
    for part in np.array_split(np.arange(at.size), 1 + at.size // 16):
        density = pdf(at[part, None], p)
        up[part], net[part] = density @ np.maximum(flux, 0.0), density @ flux
    return up, net


def spectrum(frame: Frame, row: int, at: Array, options: Options, *, tol: float) -> Answer:
    """Return the power spectral density S of q at ``at``; its scale is σ_q³/σ_v.

    S(ω) = Re G(iω)/π, G(s) = ∫ q' (s − L)⁻¹ q' p, q' = q less its mean. Where S happens to be the
    same in both solutions, on the flank of a peak that moves, Im G is not: the distance is that of
    all of G, less what its first terms at high frequency have of it, σ_q²/s − σ_v²/s³, in which S
    has no part: G − σ_q² (s + κ)/(s² + κ s + κ²), κ = σ_v/σ_q.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)
    w, place = np.unique(np.abs(at), return_inverse=True)

    Transform = tuple[Complexes, float, Complexes]

    def measure(e: Expansion, step: Step) -> Transform:
        A = generator(e, odd=e.basis.mirrored)
        G, residual = transforms(A, *displaced(e, row, A), w, step)
        size, velocity = deviations(e, row)
        rate = velocity / size
        return G, residual, size**2 * (1j * w + rate) / ((1j * w) ** 2 + 1j * w * rate + rate**2)

    def compare(ladder: Ladder, fine: Transform, coarse: Transform) -> Answer:
        change = fine[0] - coarse[0]
        distance = np.maximum(np.abs(change - (fine[2] - coarse[2])), np.abs(change.real)) / np.pi
        size, velocity = deviations(ladder.finest, row)
        scale = np.array(size**3 / velocity)
        values = fine[0].real[place] / np.pi
        return Answer(ladder, values, distance[place], scale, residual=fine[1])

    # A momentum, so that all levels of the stationary state are computed.
    return adapted(frame, [q, p], measure, compare, options, tol=tol, what="spectrum")


def correlation(frame: Frame, row: int, at: Array, options: Options, *, tol: float) -> Answer:
    """Return the autocovariance C of q at the lags ``at``; its scale is σ_q².

    C(t) = ∫ q' e^(Lt) q' p. Where C happens to be the same in both solutions, as of oscillations of
    unlike frequencies, C' is not: the distance is that of C + i C'/κ, κ = 2 σ_v/σ_q.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)

    def measure(e: Expansion, step: Step) -> tuple[Array, float]:
        A = generator(e, odd=e.basis.mirrored)
        c, b = displaced(e, row, A)
        size, velocity = deviations(e, row)
        values, error = decays(A, c, b, at, 2.0 * velocity / size, step, tol=SPACE * tol)
        return values, error + abs(float(c @ b) - size**2)

    def compare(ladder: Ladder, fine: tuple[Array, float], coarse: tuple[Array, float]) -> Answer:
        (values, error), distance = fine, np.hypot(*(fine[0] - coarse[0]))
        scale = np.array(deviations(ladder.finest, row)[0] ** 2)
        return Answer(ladder, values[0], distance, scale, added=error)

    return adapted(
        frame, [q, p], measure, compare, options, tol=tol, what="correlation", numbers=float
    )


def relaxation(frame: Frame, count: int, options: Options, *, tol: float) -> Answer:
    """Return the ``count`` slowest eigenvalues λ of −L, Im λ >= 0; their scale is |λ|.

    Each stands as often as it occurs. The distance of each is that to the rate of the coarser
    solution that it is paired with: all pairs are the nearest.
    """

    Found = tuple[Complexes, str]

    def measure(e: Expansion, step: Step) -> Found:
        parities = (True, False) if e.basis.mirrored else (False,)
        parts = [generator(e, odd=odd, closed=True) for odd in parities]
        work = len(parts) * cost(e.basis, numbers=complex)[1]
        # The largest natural frequency of the linear system with the covariances of the solution.
        q, v = np.split(moments(e)[1], 2)
        squares = np.linalg.eigvals(np.linalg.solve(q[:, : frame.n], v[:, frame.n :]))
        fastest, most = float(np.sqrt(squares.real.max())), min(DISCS, int(options.work / work))
        return slowest_rates(parts, count, fastest, most=most, step=step)

    def compare(ladder: Ladder, fine: Found, coarse: Found) -> Answer:
        slowest = fine[0][:count]
        apart, distance = np.abs(slowest[:, None] - coarse[0]), np.abs(slowest)
        rows, columns = linear_sum_assignment(apart)
        distance[rows] = apart[rows, columns]
        return Answer(ladder, slowest, distance, np.abs(slowest), missing=fine[1])

    momentum = (Coordinate("p", frame.contact),)
    return adapted(frame, [momentum], measure, compare, options, tol=tol, what="relaxation")
