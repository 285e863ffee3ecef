"""Autocovariances, power spectra and upcrossing rates of displacements of the full system (6)."""

from functools import partial
from math import ceil, inf, pi
from typing import Any

import numpy as np
import scipy  # its parts are loaded at their first use

from fpk.answer.certificate import tolerance
from fpk.answer.dynamics import Curve
from fpk.answer.question import Asked
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from sim.questions.limits import longest_step, motion_step, needs_steps
from sim.questions.passing import count_upcrossings
from sim.questions.rounds import MOST_SUMS, Simulation, error_of, in_rounds, sampled_curve
from sim.sample.diagnostics import CHUNKS, drift_limit, drifts
from sim.sample.settings import Settings
from sim.step.arrays import LANES
from sim.step.step_size import contact_frequency, highest_frequency, relaxation_time

RELAXATIONS = 20.0
"""Relaxation times of each trajectory in which products of an autocovariance begin, or crossings
are counted, unless a time is given."""

BEYOND = 6
"""Samples beyond the longest lag: the spline is worst at its end."""

Products = tuple[Array, Array, Array]
"""Sums of a round, as of ``_products``."""


def correlation(method: Settings, asked: Asked) -> Curve:
    """Return the autocovariance of q of mass ``row`` at the lags ``at``.

    Products q(s) q(s + t) about the mean of all, at samples s in ``RELAXATIONS`` relaxation times
    or the ``time`` of each trajectory, less where memory ends it; between samples of t a cubic
    spline. Stated is, in quadrature, the error by blocks of trajectories, what changes at the step
    dt instead of dt/2, by the same random numbers, and the largest error of the spline, see
    ``_spline_error``. Raises ``InvalidInput`` for lags that are too long for memory.
    """
    system, at, wanted = asked.system, asked.at, tolerance(asked.tol, method.tol)
    dt, too_long = motion_step(method, system)
    stepped = needs_steps(system)
    step = max(1, int(longest_step(system) / dt)) if stepped else 1
    spacing = step * dt

    read = partial(_record, row=asked.row)
    simulations: list[Simulation] = [(dt, step, True, step, read)]
    if stepped:
        simulations.insert(0, (0.5 * dt, 2 * step, False, 2 * step, read))
    longest = float(np.max(at))
    most = MOST_SUMS // (LANES * len(simulations))
    if longest > 0.5 * most * spacing:
        remedy = f"a lag takes {longest / spacing:.1e} samples at once; ask for shorter ones"
        raise InvalidInput("at", longest, remedy)
    lags = 2 * ceil(0.5 * longest / spacing) + BEYOND
    wished = ceil((method.time or RELAXATIONS * relaxation_time(system)) / spacing)
    origins = min(wished, most - lags)
    rounds: list[list[Products]] = [[] for _ in simulations]

    def estimate(series: list[Array], _: Array, __: int) -> float:
        for sums, q in zip(rounds, series, strict=True):
            sums.append(_products(q, origins))
        return float(np.max(error_of(_curve(rounds[0], spacing, at)))) / _variance(rounds[0])

    samples = origins + lags
    paths, failures = in_rounds(
        method, asked, simulations, samples, (samples + 1, LANES), estimate, "correlation"
    )
    curves = [_curve(sums, spacing, at) for sums in rounds]
    values, coarse = (curve.mean(axis=0) for curve in (curves[0], curves[-1]))
    spline = _spline_error(rounds[0], spacing)
    errors = np.sqrt(error_of(curves[0]) ** 2 + (coarse - values) ** 2 + spline**2)
    settings: dict[str, str | float | int] = {
        "dt": simulations[0][0],
        "coarse dt": dt,
        "sampled every": spacing,
        "time": origins * spacing,
        "paths": paths,
        "seed": method.seed,
        "largest step bias": float(np.max(np.abs(coarse - values))),
        "error of the spline": spline,
    }
    scale = _variance(rounds[0])
    positive, failures = scale - np.abs(values), too_long + failures
    return sampled_curve(values, errors, scale, wanted, failures, settings, positive)


def _record(trace: Array, samples: int, done: int, series: Array, row: int) -> None:
    """Copy q to ``series`` (blocks, samples, LANES)."""
    series[:, done : done + samples + 1] = trace[:, : samples + 1, row]


def _products(q: Array, origins: int) -> Products:
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


def _curve(rounds: list[Products], spacing: float, at: Array, every: int = 1) -> Array:
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


def _spline_error(rounds: list[Products], spacing: float) -> float:
    """Twice a 15th of what leaving out every other sample changes: it errs 16 times as much."""
    samples = spacing * np.arange(rounds[0][0].shape[1] - 2)  # without the end, where none is asked
    one, two = (_curve(rounds, spacing, samples, every).mean(axis=0) for every in (1, 2))
    return float(np.max(np.abs(one - two))) * 2.0 / 15.0


def _variance(rounds: list[Products]) -> float:
    variance = float(_curve(rounds, 1.0, np.zeros(1)).mean())
    return variance if variance > 0.0 else 1.0


WINDOW = 40.0
"""Length of a window in decay times: the peak of a mode is flattened by (4π²/3)/40² = 0.8 %."""

SAMPLING, OF_CONTACT = 6.0, 3.0
"""Sampling frequency, in units of the highest that is asked for or natural, and of the highest in
contact: what folds back into the range is (1/5)⁴ of it where the spectrum falls as ω^−4."""

MOST_FREQUENCIES = 1024
"""Frequencies beyond which they are refused: 8192 windows of 3000 samples then take minutes."""


def spectrum(method: Settings, asked: Asked) -> Curve:
    """Return the power spectral density of q of mass ``row`` at the angular frequencies ``at``.

    By Welch's method at just these frequencies: |Σ w q e^(−iωt)|² of one Hann window w on each
    trajectory, ``WINDOW`` decay times long, the variance about the mean of all. Leakage flattens it
    by a constant over the square of the length: windows of half the length, on the same samples,
    show it, and a third of the difference is added. Stated is, in quadrature, the error by blocks
    of trajectories, all of that third, and a bound of what sampling folds back. Steps are half
    those of a density, of whose bias a sixteenth is left.

    Raises ``InvalidInput`` for too many frequencies, or one so high that a window has more samples
    than are taken in minutes.
    """
    system, row, at = asked.system, asked.row, asked.at
    wanted = tolerance(asked.tol, method.tol)
    if at.size > MOST_FREQUENCIES:
        words = f"frequencies, each of which is summed on its own; ask for {MOST_FREQUENCIES}"
        raise InvalidInput("at", at.size, words)
    highest = max(float(np.max(np.abs(at))), highest_frequency(system))
    spacing = 2.0 * pi / max(SAMPLING * highest, OF_CONTACT * contact_frequency(system))
    dt, too_long = motion_step(method, system, too_long=1.0)  # no second step shows the bias
    length = 2 * ceil(0.5 * (method.time or WINDOW * relaxation_time(system)) / spacing)
    if length > MOST_SUMS // 2:
        words = f"a window takes {length:.1e} samples at the highest frequency; ask for lower ones"
        raise InvalidInput("at", highest, words)
    step, too_long = (ceil(2.0 * spacing / dt), too_long) if needs_steps(system) else (1, [])
    powers, means, squares = list[Array](), list[Array](), list[Array]()
    scale = 1.0

    def estimate(sums: list[Array], square: Array, _: int) -> float:
        nonlocal scale
        split = sums[0].reshape(-1, at.size, 3, 2, LANES)
        means.append(split.mean(axis=(0, 4)))
        powers.append(np.sum(split**2, axis=3).mean(axis=3))
        squares.append(square[[row, system.n + row]])
        size = np.sqrt(np.mean(squares, axis=0))
        scale = float(size[0] ** 3 / size[1] * system.mass[row]) if size[1] > 0 else 1.0
        return float(np.max(_welch(powers, means, length, spacing)[1])) / scale

    read = partial(_add_fourier, row=row, omega=at * spacing, length=length)
    simulations: list[Simulation] = [(spacing / step, step, False, step, read)]
    windows, failures = in_rounds(
        method, asked, simulations, length, (6 * at.size, LANES), estimate, "spectrum"
    )
    values, errors, leakage = _welch(powers, means, length, spacing)
    # Bound of the spectrum at 2π k/spacing ± ω, by the tail N_ii/(π m² ω⁴) of white noise: twice
    # the nearest one, as all beyond are less than it together.
    tail = float(system.noise_matrix[row, row]) / (pi * float(system.mass[row]) ** 2)
    folded = 2.0 * tail / (2.0 * pi / spacing - np.abs(at)) ** 4
    settings: dict[str, str | float | int] = {
        "dt": spacing / step,
        "sampled every": spacing,
        "window": length * spacing,
        "windows": windows,
        "seed": method.seed,
        "largest leakage": float(np.max(np.abs(leakage))),
        "largest folding": float(np.max(folded)),
    }
    errors = np.sqrt(errors**2 + leakage**2 + folded**2)
    return sampled_curve(values, errors, scale, wanted, failures + too_long, settings)


def _add_fourier(
    trace: Array, samples: int, done: int, sums: Array, row: int, omega: Array, length: int
) -> None:
    """Add w q cos and w q sin to ``sums`` (blocks, 6 · frequencies, LANES); a ``Reader``.

    ``omega`` (frequencies,) is in radians per sample. Of each frequency the rows are those of a
    Hann window over ``length`` samples, of one over its first half, and of one over its second.
    """
    t = np.arange(done, min(done + samples, length))
    whole, part = (0.5 - 0.5 * np.cos(2.0 * pi * k * t / length) for k in (1, 2))
    windows = np.stack([whole, part * (2 * t < length), part * (2 * t >= length)])
    waves = np.stack([np.cos(np.outer(omega, t)), np.sin(np.outer(omega, t))])
    weights = np.einsum("wt,cft->fwct", windows, waves).reshape(-1, t.size)
    sums += weights @ trace[:, 1 : t.size + 1, row]


def _welch(
    powers: list[Array], means: list[Array], length: int, spacing: float
) -> tuple[Array, Array, Array]:
    """Spectra, their errors by blocks, and the part that is added for leakage, (frequencies,)."""
    power = np.concatenate(powers)  # (blocks, frequencies, windows)
    paths = len(power) * LANES
    about = np.sum(np.mean(means, axis=0) ** 2, axis=2) * (paths / (paths - 1.0))
    # Σ w² of a Hann window is 3/8 of its samples.
    norm = spacing / (2.0 * pi * 0.375 * length)
    whole = norm * (power[:, :, 0] * paths / (paths - 1.0) - about[:, 0])
    halves = norm * 2.0 * ((power[:, :, 1:] * paths / (paths - 1.0)) - about[:, 1:]).mean(axis=2)
    leakage = (whole - halves) / 3.0
    corrected = whole + leakage
    return corrected.mean(axis=0), error_of(corrected), leakage.mean(axis=0)


def crossings(method: Settings, asked: Asked) -> Curve:
    """Return the upcrossings per unit time of the levels ``at`` by q of mass ``row``, counted.

    Crossings that the noise makes within a step are not seen: a share of all that falls as the
    step. Returned is the rate extrapolated from dt and dt/2 by the same random numbers, twice that
    at dt/2 less that at dt; whole in its error, beside that of sampling by independent blocks of
    trajectories, is what the extrapolation changes. Where hardly anything crosses, a rate may be
    negative within its error. The trajectories are followed for ``time`` (``RELAXATIONS``
    relaxation times where none is given), and on until ``tol`` is met or ``seconds`` have passed.
    """
    system, row, at = asked.system, asked.row, asked.at
    wanted, mass, order = tolerance(asked.tol, method.tol), float(system.mass[row]), np.argsort(at)
    dt, too_long = motion_step(method, system, error=wanted)
    whole = ceil((method.time or RELAXATIONS * relaxation_time(system)) / dt)
    known: Any = {"row": row, "momentum": system.n + row, "levels": at[order]}
    simulations: list[Simulation] = []
    for h, each in ((0.5 * dt, 2), (dt, 1)):
        read = partial(count_upcrossings, dt=h, inverse_mass=1.0 / mass, **known)
        simulations.append((h, each, each == 1, 1, read))
    counts, times, squares = list[Array](), list[float](), list[Array]()
    scale, made, rates, at_half = inf, 0, np.zeros(0), np.zeros(0)

    def counted(counts_of_both: list[Array], square: Array, steps: int) -> float:
        nonlocal scale, made, rates, at_half
        made += steps
        # Upcrossings of each block in the chunk, (steps, blocks, levels).
        counts.append(np.cumsum(counts_of_both, axis=2)[:, :, :-1])
        times.append(steps * dt)
        at_half, at_whole = np.sum(counts, axis=0) / (LANES * (made * dt))
        rates = 2.0 * at_half - at_whole
        squares.append(square[[row, system.n + row]])
        size = np.sqrt(np.mean(squares, axis=0))
        scale = float(size[1] / mass / (2.0 * pi * size[0])) if size[0] > 0 else 1.0
        return float(np.max(error_of(rates))) / scale

    paths, failures = in_rounds(
        method, asked, simulations, whole, (at.size + 1,), counted, "crossings", least=CHUNKS
    )
    if made < whole and not method.seconds:
        failures.insert(0, "it was ended before all chunks were done")
    failures += too_long
    # The mean of a chunk that was cut short is too noisy to show a drift.
    full = [k for k, time in enumerate(times) if time >= (whole // CHUNKS - 0.5) * dt]
    if len(full) < 2:
        failures.append("it ended in its first chunk, where no drift shows; give it more time")
    else:
        means = np.array(counts)[full, 0].T / np.array(times)[full]  # (levels, blocks, chunks)
        z, limit = np.abs(drifts(means)), drift_limit(means.shape[1], 2 * means.shape[0])
        if np.max(z) > limit:
            words = f"by {np.max(z):.1f} standard errors (chance explains {limit:.1f})"
            failures.append(f"the rates drift {words}; use a longer burn_in")
    bias = (rates - at_half).mean(axis=0)
    time = made * dt
    once = 1.0 / (paths * time)
    values, errors = rates.mean(axis=0), np.sqrt(error_of(rates) ** 2 + bias**2 + once**2)
    settings: dict[str, str | float | int] = {
        "dt": 0.5 * dt,
        "coarse dt": dt,
        "paths": paths,
        "time": time,
        "seed": method.seed,
        "largest step bias": float(np.max(np.abs(bias))),
    }
    back = np.argsort(order)
    return sampled_curve(values[back], errors[back], scale, wanted, failures, settings)
