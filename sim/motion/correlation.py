"""Autocovariances of displacements of the full system (6) by simulation."""

from functools import partial
from math import ceil

import numpy as np
import scipy  # its parts are loaded at their first use

from fpk.arrays import Array
from fpk.dynamics import Curve, Question
from fpk.errors import InvalidInput
from sim.arrays import LANES
from sim.montecarlo import MonteCarlo
from sim.motion.rounds import MOST_SUMS, error_of, in_rounds, sampled_curve
from sim.motion.steps import longest_step, motion_step, needs_steps
from sim.relaxation import relaxation_time

RELAXATIONS = 20.0
"""Relaxation times in which products begin, on each trajectory, unless a time is given."""

BEYOND = 6
"""Samples beyond the longest lag: the spline is worst at its end."""


def correlation(method: MonteCarlo, asked: Question) -> Curve:
    """Return the autocovariance of q of mass ``row`` at the lags ``at``.

    Products q(s) q(s + t) about the mean of all, at samples s in ``RELAXATIONS`` relaxation times
    or the ``time`` of each trajectory, less where memory ends it; between samples of t a cubic
    spline. Stated is, in quadrature, the error by blocks of trajectories, what changes at the step
    dt instead of dt/2, by the same random numbers, and the largest error of the spline, see
    ``_spline_error``. Raises ``InvalidInput`` for lags that are too long for memory.
    """
    system, row, at, progress = asked.system, asked.row, asked.at, asked.progress
    wanted = method.tol if asked.tol is None else asked.tol
    dt, too_long = motion_step(method, system)
    step = max(1, int(longest_step(system) / dt)) if needs_steps(system) else 1
    spacing = step * dt
    steps = [(0.5 * dt, 2 * step, False), (dt, step, True)]
    steps = steps if needs_steps(system) else steps[1:]
    longest = float(np.max(at))
    most = MOST_SUMS // (LANES * len(steps))
    if longest > 0.5 * most * spacing:
        remedy = f"a lag takes {longest / spacing:.1e} samples at once; ask for shorter ones"
        raise InvalidInput("at", longest, remedy)
    lags = 2 * ceil(0.5 * longest / spacing) + BEYOND
    wished = ceil((method.time or RELAXATIONS * relaxation_time(system)) / spacing)
    origins = min(wished, most - lags)
    rounds: list[list[tuple[Array, Array, Array]]] = [[] for _ in steps]

    def estimate(series: list[Array], _: Array) -> float:
        for sums, q in zip(rounds, series, strict=True):
            sums.append(_products(q, origins))
        curve = _curve(rounds[0], spacing, at)
        return float(np.max(error_of(curve))) / _variance(rounds[0])

    samples, read = origins + lags, partial(_record, row=row)
    paths, failures = in_rounds(
        method, system, wanted, steps, samples, (samples + 1, LANES), read, estimate,
        what="correlation", progress=progress,
    )  # fmt: skip
    curves = [_curve(sums, spacing, at) for sums in rounds]
    values = curves[0].mean(axis=0)
    bias = curves[-1].mean(axis=0) - values
    spline = _spline_error(rounds[0], spacing)
    errors = np.sqrt(error_of(curves[0]) ** 2 + bias**2 + spline**2)
    settings: dict[str, str | float | int] = {
        "dt": steps[0][0],
        "coarse dt": dt,
        "sampled every": spacing,
        "time": origins * spacing,
        "paths": paths,
        "seed": method.seed,
        "largest step bias": float(np.max(np.abs(bias))),
        "error of the spline": spline,
    }
    scale = _variance(rounds[0])
    positive, failures = scale - np.abs(values), too_long + failures
    return sampled_curve(values, errors, scale, wanted, failures, settings, positive=positive)


def _record(trace: Array, samples: int, done: int, series: Array, row: int) -> None:
    """Copy q to ``series`` (blocks, samples, LANES)."""
    series[:, done : done + samples + 1] = trace[:, : samples + 1, row]


def _products(q: Array, origins: int) -> tuple[Array, Array, Array]:
    """Means of q(s) q(s + t), of q(s) + q(s + t), (blocks, lags), and of q, (blocks, 1).

    ``q`` is (blocks, samples, LANES), and s the first samples, as many as ``origins``.
    """
    samples, number = q.shape[1], origins * LANES
    length = scipy.fft.next_fast_len(samples, real=True)
    products = np.empty((len(q), samples - origins + 1))
    for own, block in zip(products, q, strict=True):
        first, later = (scipy.fft.rfft(x, length, axis=0) for x in (block[:origins], block))
        own[:] = scipy.fft.irfft(np.sum(first.conj() * later, axis=1), length)[: own.size] / number
    sums = np.cumsum(np.insert(q.sum(axis=2), 0, 0.0, axis=1), axis=1)
    later_sums = (sums[:, origins:] - sums[:, : samples - origins + 1]) / number
    return products, later_sums[:, :1] + later_sums, sums[:, -1:] / (samples * LANES)


def _curve(
    rounds: list[tuple[Array, Array, Array]], spacing: float, at: Array, every: int = 1
) -> Array:
    """Autocovariances of each block, (blocks, lags), about the mean of all.

    By a cubic spline through every sample, or one of ``every``, that begins level: E q v = 0.
    """
    products, sums, means = (np.concatenate(x) for x in zip(*rounds, strict=True))
    # The mean of all is correlated with q: with its variance this is free of bias.
    mean = float(means.mean())
    own = (products - mean * sums + mean**2 + error_of(means) ** 2)[:, ::every]
    t = spacing * every * np.arange(own.shape[1])
    spline = scipy.interpolate.CubicSpline(t, own, axis=1, bc_type=("clamped", "not-a-knot"))
    return np.asarray(spline(at))


def _spline_error(rounds: list[tuple[Array, Array, Array]], spacing: float) -> float:
    """Twice a 15th of what leaving out every other sample changes: it errs 16 times as much."""
    samples = spacing * np.arange(rounds[0][0].shape[1] - 2)  # without the end, where none is asked
    one, two = (_curve(rounds, spacing, samples, every).mean(axis=0) for every in (1, 2))
    return float(np.max(np.abs(one - two))) * 2.0 / 15.0


def _variance(rounds: list[tuple[Array, Array, Array]]) -> float:
    variance = float(_curve(rounds, 1.0, np.zeros(1)).mean())
    return variance if variance > 0.0 else 1.0
