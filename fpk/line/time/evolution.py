"""First passage of one energy by finite elements, from any start."""

from collections.abc import Callable
from functools import partial

import numpy as np

from fpk.arrays import Array
from fpk.evolution import STARTS, Passage, StartCurve, certified_passage
from fpk.line.time.elements import Elements
from fpk.line.time.mesh import HIGHEST
from fpk.line.time.passage import SAFETY, FirstPassage, first_passage
from fpk.line.time.propagation import Source
from fpk.line.time.resolvent import evolved
from fpk.number import Number
from fpk.process import Process


def fem_passage(
    process: Process, limit: float, source: Source, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of the energy through ``limit`` from ``source`` below it.

    Of a density that begins beyond the limit in part, that part has failed at the time 0. Raises
    ``InvalidInput`` where the mean time is beyond double precision.
    """
    nodes = source.nodes(limit, HIGHEST)
    solved = first_passage(process, limit, times=times, tol=tol, nodes=nodes)
    e = solved.answer.elements
    # The means over the source by the points of the elements, and by those of the enriched ones.
    x, weights = source.samples(e)
    y, better = source.samples(solved.enriched.elements)
    unit, beyond = solved.longest, float(1.0 - weights.sum())
    off = 0.0 if source.process is None else solved.round_off

    def over(f: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array]:
        (values, errors), (finer, _) = f(x), f(y)
        mean = values @ weights
        distance = SAFETY * np.abs(mean - finer @ better) + off * np.abs(mean)
        return mean, errors @ weights + distance

    mean, mean_error = map(float, over(solved.mean))
    share = mean / unit

    def spread(x: Array) -> tuple[Array, Array]:
        """(E T − mean)² − mean² of a start in units of the square of the longest mean time."""
        T, T_error = (a / unit for a in solved.mean(x))
        return T * (T - 2.0 * share), 2.0 * np.abs(T - share) * T_error

    (V, V_error), (W, W_error) = over(solved.variance), over(spread)
    with np.errstate(over="ignore"):
        variance, variance_error = (
            (V + W + share**2) * unit * unit,
            (V_error + W_error) * unit * unit,
        )
    rate, rate_error = solved.rate()
    # Forward and backward equation are compared at the mean time where no other is asked for.
    compared = times if times.size else np.array([mean])
    failure, failure_error = over(partial(solved.failure, compared))
    failure = failure + beyond
    failure_error = failure_error + SAFETY * np.abs(weights.sum() - better.sum()) + off
    kept, residual = _forward(e, source, compared)
    settings: dict[str, str | float | int] = {
        "degree": e.degree, "elements": e.count, "tol": tol
    }  # fmt: skip
    if source.process is not None:
        settings["beyond the limit at the start"] = float(beyond)
    numbers = Number(mean, mean_error), Number(float(variance), float(variance_error))
    return certified_passage(
        (*numbers, Number(rate, rate_error)),
        times,
        failure[: times.size],
        failure_error[: times.size],
        tol=tol,
        mass_defect=float(np.abs(kept + failure - 1.0).max()),
        residual=residual,
        starts=_curve(solved),
        settings=settings,
    )


def _curve(solved: FirstPassage) -> StartCurve:
    starts, unit = np.linspace(0.0, solved.limit, STARTS), solved.longest
    with np.errstate(over="ignore"):
        variance = [a * unit * unit for a in solved.variance(starts)]
    return StartCurve(starts, *solved.mean(starts), *variance)


def _forward(e: Elements, source: Source, times: Array) -> tuple[Array, float]:
    """Return ∫p at ``times`` where the limit absorbs, by the forward equation, and its residual."""
    later = times > 0.0
    load = source.load(e)
    g = evolved(e, load, times[later], held=0.0)
    mass = np.full(times.size, load[:, :2].sum())
    mass[later] = np.einsum("tei,ei->t", g.values, e.load)
    return mass, g.residual
