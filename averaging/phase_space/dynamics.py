"""Crossings, spectra, autocovariances and relaxation rates of the full system, with errors."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment

from averaging.gaussian import GAUSSIAN_REACH
from averaging.phase_space import resolvent
from averaging.phase_space.densities import DISTANCE_POINTS
from averaging.phase_space.equation.elimination import Step, solution_cost
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import marginal, moments
from averaging.phase_space.refinement import (
    DENSITY_ROUND_OFF,
    Ladder,
    Options,
    breakdowns,
    error_by_distances,
)
from fpk.answer.names import Coordinate
from fpk.numeric.arrays import Array, Complexes
from fpk.numeric.quadrature import gauss_grid
from fpk.solvers.plane.time.transient import KRYLOV_SHARE


@dataclass(frozen=True, eq=False)
class Answer:
    """Values (points,) by one solution, and absolute ``errors`` (points,), ∞ before ``adapt``.

    Errors follow from the difference of two answers in ``compared``, (kinds, points) or all rates,
    plus ``added``; tolerances are relative to ``scale``. ``residual`` is of equations beside the
    stationary equation, ``missing`` says which values are uncertain, ``limit`` why there is no
    finer answer, or "".
    """

    values: Array | Complexes
    compared: Array | Complexes
    scale: Array | float
    added: Array | float = 0.0
    residual: float = 0.0
    missing: str = ""
    errors: Array | float = np.inf
    limit: str = ""

    @property
    def relative(self) -> float:
        """The largest error in units of the scale."""
        return float(np.max(self.errors / self.scale))


Measure = Callable[[Any, Step], Answer]
Apart = Callable[[Ladder, Answer, Answer], Array]
"""Maps a ladder, the finer and the coarser answer to the differences of their values (points,)."""


def largest(ladder: Ladder, fine: Answer, coarse: Answer) -> Array:
    """Return the largest difference (points,) of all kinds of values in ``compared``."""
    return np.asarray(np.abs(fine.compared - coarse.compared).max(axis=0))


@breakdowns()
def adapt(
    ladders: Iterable[Ladder],
    measure: Measure,
    options: Options,
    apart: Apart,
    *,
    tol: float,
    what: str,
    numbers: type = complex,
) -> tuple[Ladder, Answer]:
    """Return one of ``ladders`` and its answer: the first with a relative error up to ``tol``, else
    the best.

    ``measure`` computes the answer of one solution, ``apart`` the difference of two answers, whose
    error is estimated as for densities. The densities of the ladder meet the tolerance, too, unless
    a limit ends the refinement. An earlier answer with a smaller error is preferred if the
    later answer agrees within it. ``what`` is for reports of progress, ``numbers`` the type of the
    numbers of the elimination. Raises ``NotCertified`` if the solution breaks down.
    """
    best: tuple[Ladder, Answer] | None = None
    believed: float | None = None
    fine: Answer | None = None
    for ladder in ladders:
        cost = elimination_cost(ladder.finest, numbers)
        if best is not None and (limit := ladder.limit or options.refusal(*cost)):
            own, answer = best
            return own, replace(answer, limit="" if answer.relative <= tol else limit)
        coarse = fine or measure(
            ladder.coarser, options.step(f"{what}, solution {ladder.solutions - 1}")
        )
        fine = measure(ladder.finest, options.step(f"{what}, solution {ladder.solutions}"))
        difference = apart(ladder, fine, coarse)
        relative = float(np.max(difference / fine.scale))
        believed, error = error_by_distances(relative, believed)
        errors = (error / relative if relative > 0.0 else 0.0) * difference
        later = replace(fine, errors=errors + fine.added + DENSITY_ROUND_OFF * fine.scale)
        earlier = later if best is None else best[1]
        a, b = ((bool(x.missing), x.relative) for x in (earlier, later))
        agree = a <= b and earlier.values.shape == later.values.shape
        agree = agree and bool(np.all(np.abs(earlier.values - later.values) <= earlier.errors))
        if best is None or not agree:
            best = ladder, later
        if max(best[1].relative, *ladder.errors.values()) <= tol:
            break
    assert best is not None
    return best


@singledispatch
def elimination_cost(e: Any, numbers: type) -> tuple[float, float]:
    """Return the bytes and operations of an elimination for ``e`` in numbers of a type."""
    return solution_cost(e.basis, numbers=numbers)


def deviations(e: Any, frame: Frame, row: int) -> Array:
    """Return the standard deviations (2,) of q and of the velocity of mass ``row`` (0-based)."""
    variances = np.diag(moments(e)[1])
    place = frame.order.index(row)
    return np.asarray(np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row]))


def crossings(e: Any, step: Step, *, frame: Frame, row: int, at: Array, tol: float) -> Answer:
    """Return the upcrossings per unit time of the levels ``at`` by q of mass ``row`` (0-based).

    The net flux, which should be 0, adds to the error; ``tol`` has no effect.
    """
    (size, velocity), (up, net) = deviations(e, frame, row), crossing_rates(e, frame, row, at)
    return Answer(up, up[None], velocity / (2.0 * np.pi * size), added=np.abs(net))


def about_levels(
    ladder: Ladder, fine: Answer, coarse: Answer, *, frame: Frame, row: int, at: Array
) -> Array:
    """Return the largest difference of the rates of q_row near each of the levels ``at``.

    ``row`` is 0-based; near is within half a standard deviation.
    """
    ((ends,), _), count = marginal(ladder.finest, (Coordinate("q", row),)), DISTANCE_POINTS[2]
    grid = np.linspace(ends[0], ends[-1], count)
    up, before = (crossing_rates(e, frame, row, grid)[0] for e in (ladder.finest, ladder.coarser))
    wide = maximum_filter1d(np.abs(up - before), int(0.5 * count / GAUSSIAN_REACH) + 1)
    return np.maximum(np.interp(at, grid, wide), largest(ladder, fine, coarse))


def crossing_rates(e: Any, frame: Frame, row: int, at: Array) -> tuple[Array, Array]:
    """Return upcrossing rates ∫_0^∞ v f(a, p) dp (Rice) and net fluxes ∫ v f(a, p) dp.

    They are (levels,), a the levels ``at``; f is the joint density of q and p of mass ``row``.
    """
    axes, pdf = marginal(e, (Coordinate("q", row), Coordinate("p", row)))
    _, [(p, w)] = gauss_grid([np.union1d(axes[1], 0.0)])
    flux = w * p / frame.system.mass[row]
    # Sixteen levels at a time, since arrays have levels times all points of p and y.
    parts = [pdf(part[:, None], p) for part in np.array_split(at, 1 + at.size // 16)]
    density = np.concatenate(parts)
    return density @ np.maximum(flux, 0.0), density @ flux


def spectrum(e: Any, step: Step, *, frame: Frame, row: int, at: Array, tol: float) -> Answer:
    """Return the two-sided spectral density Re G(iω)/π, G(s) = ∫ q' (s − L)⁻¹ q' p, q' = q − E q.

    q is of mass ``row`` (0-based), ω are the frequencies ``at``; ``tol`` has no effect. On the
    flank of a peak that has moved S may agree in two solutions, but Im G does not. So G is
    compared, too, without its slow terms: G − σ_q² (s + κ)/(s² + κ s + κ²), κ = σ_v/σ_q.
    """
    w, place = np.unique(np.abs(at), return_inverse=True)
    A, (size, velocity) = next(resolvent.generators(e)), deviations(e, frame, row)
    G, residual = resolvent.transforms(A, *A.displacement(row), w, step)
    s, rate = 1j * w, velocity / size
    rest = G - size**2 * (s + rate) / (s**2 + s * rate + rate**2)
    compared = np.stack([rest, G.real])[:, place] / np.pi
    return Answer(G.real[place] / np.pi, compared, size**3 / velocity, residual=residual)


def correlation(e: Any, step: Step, *, frame: Frame, row: int, at: Array, tol: float) -> Answer:
    """Return the autocovariance C(t) = ∫ q' e^(Lt) q' p of q, q' = q − E q, at the lags ``at``.

    q is of mass ``row`` (0-based), ``tol`` the tolerance relative to C(0). C may agree in two
    solutions by chance, at a lag where oscillations of different frequencies meet; C' does not
    there. So C + i C'/κ is compared, κ = 2 σ_v/σ_q.
    """
    A, (size, velocity) = next(resolvent.generators(e)), deviations(e, frame, row)
    c, b = A.displacement(row)
    rate, wanted = 2.0 * velocity / size, KRYLOV_SHARE * tol
    values, error = resolvent.decays(A, c, b, at, rate, step, tol=wanted)
    compared = (values[0] + 1j * values[1])[None]
    return Answer(values[0], compared, size**2, added=error + abs(float(c @ b) - size**2))


def relaxation(e: Any, step: Step, *, count: int, work: float) -> Answer:
    """Return the ``count`` slowest eigenvalues λ of −L, Im λ >= 0, each as often as it occurs.

    ``work`` limits the operations, and so the number of eliminations; if they are too few, there
    may be fewer values, and ``missing`` says so. Each value is its own ``scale``, by magnitude.
    """
    parts = list(resolvent.generators(e))
    # Largest natural frequency of the linear system with the covariances of the solution.
    q, v = np.split(moments(e)[1], 2)
    squares = np.linalg.eigvals(np.linalg.solve(q[:, : len(q)], v[:, len(q) :]))
    cost = len(parts) * elimination_cost(e, complex)[1]
    most = min(resolvent.DISCS, int(work / cost))
    fastest = float(np.sqrt(squares.real.max()))
    rates, missing = resolvent.slowest_rates(parts, count, fastest, most=most, step=step)
    return Answer(rates[:count], rates, np.abs(rates[:count]), missing=missing)


def nearest(ladder: Ladder, fine: Answer, coarse: Answer) -> Array:
    """Return the distance of each rate to its partner in ``coarse``, in the nearest pairing.

    A rate without a partner counts with its own size.
    """
    apart, differences = np.abs(fine.values[:, None] - coarse.compared), np.abs(fine.values)
    rows, columns = linear_sum_assignment(apart)
    differences[rows] = apart[rows, columns]
    return differences
