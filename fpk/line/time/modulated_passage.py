"""First passage of one energy under modulated noise, by the forward equation that absorbs."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from fpk.arrays import EPS, SMALLEST, Array
from fpk.errors import NotApplicable
from fpk.evolution import Passage, certified_passage
from fpk.line.time.elements import Elements
from fpk.line.time.modulated import LEVELS, begins, halved, settings_of
from fpk.line.time.passage import FirstPassage, fem_passage, first_passage
from fpk.line.time.propagation import Solution, Source
from fpk.line.time.stepping import stepped
from fpk.line.time.transition import ROUND_OFF, SAFETY, adapted, posed
from fpk.modulation import Modulation
from fpk.number import Number
from fpk.process import Process

NEVER = Number(np.inf, np.inf)
"""Moments of a time that is infinite for some."""
SHARE = 0.1
"""Share of the tolerance for the mesh, and for the steps: variances have more error than p."""
Under = Callable[[float], Process]


def modulated_passage(
    under: Under, modulation: Modulation, limit: float, source: Source, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of ``limit``; ``under(F)`` is the process under F times the noise.

    P(T > t) is the mass that the forward equation with p = 0 at the limit keeps; mean, variance
    and failure rate are those of the noise that the modulation ends with. Where it ends with 0 who
    lives then never fails: moments are infinite, and there is no failure rate. Errors as of
    ``modulated_transition``, in probabilities and in the moments. Raises ``NotApplicable`` where
    damping feeds energy in at the limit while there is no noise, and as ``first_passage`` does.
    """
    unit, last, quiet = modulation.largest, modulation.last, begins(modulation, source)
    if unit == 0.0:
        raise NotApplicable("there is no noise at any time: nothing passes a limit")
    if modulation.times.size == 1:
        return fem_passage(under(last), limit, source, times, tol=tol)
    process = under(unit)
    at_limit = process.coefficients(np.array([limit]))
    if float(modulation.factor.min()) == 0.0 and at_limit.dissipation[0] > 0.0:
        raise NotApplicable(
            "damping feeds energy in at the limit: while there is no noise, no mesh sees it"
        )
    modulation = modulation.after(quiet)
    end = float(modulation.times[-1])
    asked = np.maximum(times - quiet, 0.0)
    asked = asked if last else np.minimum(asked, end)
    stops = np.unique([0.0, *asked, end])
    later = first_passage(under(last), limit, times=np.zeros(0), tol=0.01 * tol) if last else None
    first = float(modulation.energy(stops[1])) / unit
    question, pair = posed(process, source, first, SHARE * tol, limit=limit)

    @lru_cache(maxsize=len(pair))
    def solve(e: Elements, level: int) -> tuple[Solution, Array, Array]:
        """p at the stops > 0; P(T > t) at all stops, E T and E T², and errors by ``later``.

        The moments are ∫P(T > t) dt and ∫2t P(T > t) dt up to the end, and those of the time that
        is left, E(t_e + τ)², over the density of then; the errors are of the two moments.
        """
        load = source.load(e)
        g, t, weight, mass = stepped(
            e, load, modulation, unit, stops[1:], level=level, absorbing=True
        )
        solution = Solution(process, e, g)
        kept = np.append(load[:, :2].sum(), np.einsum("tei,ei->t", g.values, e.load))
        density = weight * mass * (t <= end)
        moments, lost = np.array([density.sum(), 2.0 * density @ t]), np.zeros(2)
        if later is not None:
            p = solution.density(e.x.ravel())[0][np.searchsorted(stops[1:], end)]
            first, second = _left(later, e.x.ravel(), p * e.weight.ravel())
            moments += [first[0], 2.0 * end * first[0] + second[0]]
            lost += [first[1], 2.0 * end * first[1] + second[1]]
        return solution, np.append(kept, moments), lost

    e, finer = adapted(question, pair, lambda e, **_: solve(e, LEVELS[0])[0]).pair
    off = np.abs(solve(e, LEVELS[0])[1] - solve(finer, LEVELS[0])[1])

    def size(moved: Array, numbers: Array) -> float:
        return float(np.max(moved / np.maximum(numbers, 1.0)))

    level, numbers, moved, sizes = halved(lambda k: solve(e, k)[1], size, SHARE * tol)
    solution, _, lost = solve(e, level)
    error, failure, at = SAFETY * (off + moved), 1.0 - numbers[:-2], np.searchsorted(stops, asked)
    # At short times ln P ~ −(distance)²/(2 b t): so much more the coefficients count.
    relative = 2.0 * e.coefficient_error(source.energy)
    relative += ROUND_OFF * EPS * (e.count + float(np.ptp(e.log_scale)))
    steep = 2.0 - np.log(np.clip(np.abs(failure), SMALLEST, 1.0))
    failure_error = error[:-2] + relative * steep * np.abs(failure) + ROUND_OFF * EPS
    moments: tuple[Number, Number, Number | None] = (NEVER, NEVER, None)
    if later is not None:
        mean, square = numbers[-2:].tolist()
        mean_error, square_error = (error[-2:] + lost + 2.0 * relative * numbers[-2:]).tolist()
        moments = (
            Number(mean + quiet, mean_error),
            Number(square - mean**2, square_error + 2.0 * mean * mean_error),
            Number(*later.rate()),
        )
    return certified_passage(
        moments,
        times,
        failure[at],
        failure_error[at],
        tol=tol,
        residual=solution.g.residual,
        settings=settings_of(e, level, sizes, tol),
    )


def _left(later: FirstPassage, x: Array, p: Array) -> tuple[Array, Array]:
    """E τ and E τ² from starts x of the weights p, each with its error by that of ``later``."""
    longest, size = later.longest, np.abs(p)
    T, T_error = (a / longest for a in later.mean(x))
    V, V_error = later.variance(x)
    first = np.array([p @ T, size @ T_error])
    second = np.array([p @ (T**2 + V), size @ (2.0 * T * T_error + V_error)])
    with np.errstate(over="ignore"):
        return first * longest, second * longest * longest
