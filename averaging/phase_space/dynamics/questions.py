"""Crossings, spectra, autocovariances and relaxation rates: to a tolerance, with their errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment

from averaging.phase_space.densities import GRID
from averaging.phase_space.dynamics import resolvent
from averaging.phase_space.equation.elimination import Expansion, cost
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import SPAN, marginal, moments
from averaging.phase_space.refinement import ROUND_OFF, Ladder, Options, falling, kept, ladders
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import Array, Complexes
from fpk.numeric.quadrature import gauss_grid

SPACE = 1e-3
"""Share of the tolerance at which the space that a correlation is taken from is large enough."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Values (points,) of one solution; with their errors once ``adapted`` has judged them.

    Errors follow from the distance of two solutions in ``compared``, (kinds, points) or all rates,
    beside ``added``; a tolerance is relative to ``scale``. ``residual`` is of further equations.
    ``missing`` says which values are uncertain, ``limit`` why there is no finer answer, or "".
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


Measure = Callable[[Expansion, resolvent.Step], Answer]
Apart = Callable[[Ladder, Answer, Answer], Array]
"""Distances of the values of a finer and a coarser answer, (points,)."""


def largest(ladder: Ladder, fine: Answer, coarse: Answer) -> Array:
    """Return the largest change of all kinds that are compared."""
    return np.asarray(np.abs(fine.compared - coarse.compared).max(axis=0))


def adapted(
    frame: Frame,
    observables: Sequence[Observable],
    measure: Measure,
    options: Options,
    apart: Apart,
    *,
    tol: float,
    what: str,
    numbers: type = complex,
) -> tuple[Ladder, Answer]:
    """Return the first answer with a relative error of at most ``tol``, else the best one.

    ``measure`` is called once for each solution; ``numbers`` are those of the elimination. Errors
    follow from the largest relative distance as those of densities, which meet the tolerance, too,
    unless ended. An earlier answer of a smaller error is kept if the later agrees within it.
    """
    found: tuple[Ladder, Answer] | None = None
    believed: float | None = None
    fine: Answer | None = None
    for ladder in ladders(frame, observables, options):
        limit = ladder.limit or options.refusal(*cost(ladder.finest.basis, numbers=numbers))
        if found is not None and limit:
            # A ladder with a limit is yielded again, as there is no finer one.
            own, answer = found
            return own, replace(answer, limit="" if answer.relative <= tol else limit)
        coarse = fine or measure(ladder.coarser, options.step(what, len(ladder.coarser.levels) - 1))
        fine = measure(ladder.finest, options.step(what, len(ladder.finest.levels) - 1))
        distance = apart(ladder, fine, coarse)
        relative = float(np.max(distance / fine.scale))
        believed, error = falling(relative, believed, kept(frame))
        errors = (error / relative if relative > 0.0 else 0.0) * distance
        later = replace(fine, errors=errors + fine.added + ROUND_OFF * fine.scale)
        if found is None or not _agree(found[1], later):
            found = ladder, later
        if max(found[1].relative, *ladder.errors.values()) <= tol:
            break
    assert found is not None
    return found


def _agree(earlier: Answer, later: Answer) -> bool:
    """Whether the earlier errors are the smaller ones and hold for the later values, too."""
    a, b = ((bool(x.missing), x.relative) for x in (earlier, later))
    same = a <= b and earlier.values.shape == later.values.shape
    return same and bool(np.all(np.abs(earlier.values - later.values) <= earlier.errors))


def deviations(e: Expansion, row: int) -> Array:
    """Return the standard deviations of q and of the velocity of mass ``row``."""
    frame, variances = e.basis.frame, np.diag(moments(e)[1])
    place = frame.order.index(row)
    return np.asarray(np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row]))


def crossings(e: Expansion, step: resolvent.Step, *, row: int, at: Array, tol: float) -> Answer:
    """Return the rates of upcrossing of the levels ``at``; net flow past each adds to the error."""
    (size, velocity), (up, net) = deviations(e, row), crossing_rates(e, row, at)
    return Answer(up, up[None], velocity / (2.0 * np.pi * size), added=np.abs(net))


def about_levels(ladder: Ladder, fine: Answer, coarse: Answer, *, row: int, at: Array) -> Array:
    """Return the largest distance of rates of upcrossing within half a deviation of a level."""
    ((ends,), _), count = marginal(ladder.finest, (Coordinate("q", row),)), GRID[2]
    grid = np.linspace(ends[0], ends[-1], count)
    up, before = (crossing_rates(e, row, grid)[0] for e in (ladder.finest, ladder.coarser))
    wide = maximum_filter1d(np.abs(up - before), count // SPAN + 1)
    return np.maximum(np.interp(at, grid, wide), largest(ladder, fine, coarse))


def crossing_rates(e: Expansion, row: int, at: Array) -> tuple[Array, Array]:
    """Return the rates of upcrossing (Rice) ∫_0^∞ v f(a, p) dp of the levels a of ``at``.

    The second is ∫ v f(a, p) dp, which vanishes in a stationary state, and is an error of these.
    """
    axes, pdf = marginal(e, (Coordinate("q", row), Coordinate("p", row)))
    _, [(p, w)] = gauss_grid([np.union1d(axes[1], 0.0)])
    flux = w * p / e.basis.frame.system.mass[row]
    # Arrays are as large as the levels of a part times all points of p and y.
    parts = [pdf(part[:, None], p) for part in np.array_split(at, 1 + at.size // 16)]
    density = np.concatenate(parts)
    return density @ np.maximum(flux, 0.0), density @ flux


def spectrum(e: Expansion, step: resolvent.Step, *, row: int, at: Array, tol: float) -> Answer:
    """Return the power spectral density S of q at ``at``.

    S(ω) = Re G(iω)/π, G(s) = ∫ q' (s − L)⁻¹ q' p, q' = q less its mean. Where S happens to be the
    same in both solutions, on the flank of a peak that moves, Im G is not: all of G is compared,
    too, less what its first terms at high frequency have of it, σ_q²/s − σ_v²/s³, in which S
    has no part: G − σ_q² (s + κ)/(s² + κ s + κ²), κ = σ_v/σ_q.
    """
    w, place = np.unique(np.abs(at), return_inverse=True)
    A, (size, velocity) = resolvent.generator(e, odd=e.basis.mirrored), deviations(e, row)
    G, residual = resolvent.transforms(A, *resolvent.displaced(e, row, A), w, step)
    s, rate = 1j * w, velocity / size
    rest = G - size**2 * (s + rate) / (s**2 + s * rate + rate**2)
    compared = np.stack([rest, G.real])[:, place] / np.pi
    return Answer(G.real[place] / np.pi, compared, size**3 / velocity, residual=residual)


def correlation(e: Expansion, step: resolvent.Step, *, row: int, at: Array, tol: float) -> Answer:
    """Return the autocovariance C of q at the lags ``at``, C(t) = ∫ q' e^(Lt) q' p.

    Where C happens to be the same in both solutions, as of oscillations of unlike frequencies, C'
    is not: C + i C'/κ is compared, κ = 2 σ_v/σ_q.
    """
    A, (size, velocity) = resolvent.generator(e, odd=e.basis.mirrored), deviations(e, row)
    c, b = resolvent.displaced(e, row, A)
    values, error = resolvent.decays(A, c, b, at, 2.0 * velocity / size, step, tol=SPACE * tol)
    compared = (values[0] + 1j * values[1])[None]
    return Answer(values[0], compared, size**2, added=error + abs(float(c @ b) - size**2))


def relaxation(e: Expansion, step: resolvent.Step, *, count: int, work: float) -> Answer:
    """Return the ``count`` slowest eigenvalues λ of −L, Im λ >= 0, each as often as it occurs."""
    parities = (True, False) if e.basis.mirrored else (False,)
    parts = [resolvent.generator(e, odd=odd, closed=True) for odd in parities]
    # The largest natural frequency of the linear system with the covariances of the solution.
    n, (q, v) = e.basis.frame.n, np.split(moments(e)[1], 2)
    squares = np.linalg.eigvals(np.linalg.solve(q[:, :n], v[:, n:]))
    most = min(resolvent.DISCS, int(work / (len(parts) * cost(e.basis, numbers=complex)[1])))
    fastest = float(np.sqrt(squares.real.max()))
    rates, missing = resolvent.slowest_rates(parts, count, fastest, most=most, step=step)
    return Answer(rates[:count], rates, np.abs(rates[:count]), missing=missing)


def nearest(ladder: Ladder, fine: Answer, coarse: Answer) -> Array:
    """Return the distances of rates to those they are paired with; all pairs are the nearest."""
    apart, distance = np.abs(fine.values[:, None] - coarse.compared), np.abs(fine.values)
    rows, columns = linear_sum_assignment(apart)
    distance[rows] = apart[rows, columns]
    return distance
