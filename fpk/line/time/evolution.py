"""First passage of one energy by finite elements, from any start."""

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
    x, weights = source.samples(e)
    (T, T_error), (U, U_error) = solved.mean(x), solved.second(x)
    unit, beyond = solved.longest, 0.0
    if source.process is None:
        ((variance,), (variance_error,)) = solved.variance(x)
        mean, mean_error = float(T[0]), float(T_error[0])
    else:
        # The means over the source once more, by the points and weights of the enriched elements.
        y, better = source.samples(solved.enriched.elements)
        off, beyond = solved.round_off, float(1.0 - weights.sum())
        mean, half = float(weights @ T), float(weights @ U)
        mean_error = SAFETY * abs(mean - float(better @ solved.mean(y)[0])) + off * mean
        half_error = SAFETY * abs(half - float(better @ solved.second(y)[0])) + off * half
        mean_error += float(weights @ T_error)
        half_error += float(weights @ U_error)
        with np.errstate(over="ignore"):
            variance = 2.0 * half * unit * unit - mean * mean
            variance_error = 2.0 * half_error * unit * unit + 2.0 * mean * mean_error
    rate, rate_error = solved.rate()
    # Forward and backward equation are compared at the mean time where no other is asked for.
    compared = times if times.size else np.array([mean])
    F, F_error = solved.failure(compared, x)
    failure, failure_error = F @ weights + beyond, F_error @ weights
    if source.process is not None:
        finer = solved.failure(compared, y)[0] @ better + 1.0 - better.sum()
        failure_error += SAFETY * np.abs(failure - finer) + off
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
    starts = np.linspace(0.0, solved.limit, STARTS)
    return StartCurve(starts, *solved.mean(starts), *solved.variance(starts))


def _forward(e: Elements, source: Source, times: Array) -> tuple[Array, float]:
    """Return ∫p at ``times`` where the limit absorbs, by the forward equation, and its residual."""
    later = times > 0.0
    load = source.load(e)
    g = evolved(e, load, times[later], held=0.0)
    mass = np.full(times.size, load[:, :2].sum())
    mass[later] = np.einsum("tei,ei->t", g.values, e.load)
    return mass, g.residual
