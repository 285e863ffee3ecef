"""Autocovariances, power spectra and upcrossing rates of displacements of the full system (6)."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import ceil, inf, pi
from typing import Any

import numpy as np
import scipy  # its parts are loaded at their first use

from fpk.answer.certificate import Measured, certify, tolerance
from fpk.answer.dynamics import Curve
from fpk.answer.question import Asked
from fpk.answer.sampled_density import standard_error
from fpk.numeric.arrays import Array
from fpk.numeric.errors import require
from sim.questions.limits import Reach, longest_step, motion_step, needs_steps
from sim.questions.passing import count_upcrossings
from sim.questions.rounds import MOST_SUMS, Simulation, in_rounds
from sim.sample.diagnostics import CHUNKS, drifts, largest_by_chance
from sim.sample.settings import Settings
from sim.step.arrays import LANES, MAX_BATCHES
from sim.step.step_size import contact_frequency, highest_frequency, relaxation_time

RECORD_TIMES = 20.0
"""Length of a trajectory in relaxation times if no ``time`` is given: of the crossings, of the
first factor of a product, and of half the window of a spectrum, whose full length flattens the peak
of a mode by (4π²/3)/40² = 0.8 %."""

EXTRA_LAGS = 6
"""Samples beyond the longest lag: the spline is least accurate at its end."""


def sample_correlation(method: Settings, asked: Asked) -> Curve:
    """Return the autocovariance of q of mass ``asked.row`` at the lags ``asked.at``.

    Products q(s) q(s + t) about the common mean, for samples s in ``RECORD_TIMES`` relaxation times
    or the ``time``, or fewer if memory does not suffice; a cubic spline between samples of t. The
    error has three parts: the spread of blocks of trajectories, the difference between the steps dt
    and dt/2, and the spline. Raises ``InvalidInput`` for lags that are too long for memory.
    """
    system, at = asked.system, asked.at
    dt, too_long = motion_step(method, system, Reach())
    stepped = needs_steps(system)
    step = max(1, int(longest_step(system, Reach()) / dt)) if stepped else 1
    spacing, longest = step * dt, float(np.max(at))
    read = partial(copy_displacements, row=asked.row)
    simulations: list[Simulation] = [(dt, step, True, read)]
    if stepped:
        simulations.insert(0, (0.5 * dt, 2 * step, False, read))
    most = MOST_SUMS // (LANES * len(simulations))
    remedy = f"a lag takes {longest / spacing:.1e} samples at once; ask for shorter ones"
    require(longest <= 0.5 * most * spacing, "at", longest, remedy)
    lags = 2 * ceil(0.5 * longest / spacing) + EXTRA_LAGS
    origins = ceil((method.time or RECORD_TIMES * relaxation_time(system)) / spacing)
    origins = min(origins, most - lags)
    rounds: list[list[tuple[Array, ...]]] = [[] for _ in simulations]

    def estimate(series: list[Array], *_: Any) -> tuple[Array, float]:
        for sums, q in zip(rounds, series, strict=True):
            sums.append(products_at_lags(q, origins))
        curves = autocovariance(rounds[0], spacing, np.append(at, 0.0))
        return curves[:, :-1], float(curves[:, -1].mean())

    samples = origins + lags
    blocks, scale, paths, failures = in_rounds(
        method, asked, simulations, samples, (samples + 1, LANES), estimate, "correlation"
    )
    bias = autocovariance(rounds[-1], spacing, at).mean(axis=0) - blocks.mean(axis=0)
    spline = spline_error(rounds[0], spacing)
    settings = {"dt": simulations[0][0], "coarse dt": dt, "sampled every": spacing}
    settings |= {"time": origins * spacing, "paths": paths, "seed": method.seed}
    settings |= {"largest step bias": float(np.max(np.abs(bias))), "error of the spline": spline}
    positive = scale - np.abs(blocks.mean(axis=0))
    failures += too_long
    return curve_answer(method, asked, blocks, (bias, spline), scale, failures, settings, positive)


def curve_answer(
    method: Settings,
    asked: Asked,
    blocks: Array,
    beside: tuple[Array | float, ...],
    scale: float,
    failures: list[str],
    settings: Mapping[str, float],
    positive: Array | None = None,
) -> Curve:
    """Return the mean of independent ``blocks`` (blocks, points) as a curve, with its certificate.

    Its standard error and the errors ``beside``, (points,) or one number, are added in squares.
    Tolerances are in units of ``scale``. The answer is certified only without ``failures``, words
    against it, and if ``positive`` (points,), None: the values, is not negative within the error.
    ``settings`` are for readers.
    """
    errors = np.sqrt(sum(e**2 for e in (standard_error(blocks), *beside)))
    values = blocks.mean(axis=0)
    relative, least = float(np.max(errors)) / scale, values if positive is None else positive
    measured = Measured(relative, None, float(np.min(least)) / scale, None, None)
    measured = replace(measured, failures=tuple(failures), absolute_error=relative)
    certificate = certify(measured, tol=tolerance(asked.tol, method.tol or inf), sampled=True)
    return Curve(values, errors, certificate, settings, error_kind="sampling")


def copy_displacements(trace: Array, samples: int, done: int, series: Array, row: int) -> None:
    """Copy q of mass ``row`` from ``trace`` to ``series`` (blocks, …, LANES); a ``Reader``.

    These are the ``samples`` + 1 states from number ``done`` on.
    """
    series[:, done : done + samples + 1] = trace[:, : samples + 1, row]


def products_at_lags(q: Array, origins: int) -> tuple[Array, ...]:
    """Return means of q(s) q(s + t), of q(s) + q(s + t), (blocks, lags), and of q, (blocks, 1).

    ``q``: (blocks, samples, LANES); s: the first ``origins`` samples; lags t: 0 … samples −
    ``origins`` samples.
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


def autocovariance(
    rounds: list[tuple[Array, ...]], spacing: float, at: Array, every: int = 1
) -> Array:
    """Return the autocovariances (blocks, lags) at the lags ``at`` about the common mean.

    ``rounds``: results of ``products_at_lags``. A cubic spline through each ``every``-th sample,
    ``spacing`` apart; its slope is 0 at t = 0, as E q v = 0.
    """
    products, sums, means = (np.concatenate(x) for x in zip(*rounds, strict=True))
    # Unbiased: the variance of the mean, which is correlated with q, is added.
    mean = float(means.mean())
    own = (products - mean * sums + mean**2 + standard_error(means) ** 2)[:, ::every]
    t = spacing * every * np.arange(own.shape[1])
    spline = scipy.interpolate.CubicSpline(t, own, axis=1, bc_type=("clamped", "not-a-knot"))
    return np.asarray(spline(at))


def spline_error(rounds: list[tuple[Array, ...]], spacing: float) -> float:
    """Return the largest error of the spline in ``autocovariance`` of samples ``spacing`` apart.

    With every other sample the error is 16 times as large: 2/15 of the change is twice the error.
    """
    samples = spacing * np.arange(rounds[0][0].shape[1] - 2)  # without the end, where no lag is
    fine, coarse = (autocovariance(rounds, spacing, samples, k).mean(axis=0) for k in (1, 2))
    return float(np.max(np.abs(fine - coarse))) * 2.0 / 15.0


SAMPLING, OF_CONTACT = 6.0, 3.0
"""Least sampling frequency of a spectrum over the highest output or natural frequency; over the
highest in contact. Aliasing adds (1/5)⁴ of the spectrum where it falls as ω^−4."""


def sample_spectrum(method: Settings, asked: Asked) -> Curve:
    """Return the two-sided power spectral density of q of mass ``asked.row`` at ``asked.at``.

    These are frequencies in rad per unit time; its integral over all of them is the variance.
    Welch's method: |Σ w q e^(−iωt)|² of one Hann window w on each trajectory, 2 ``RECORD_TIMES``
    relaxation times or the ``time`` long, about the common mean. Leakage is a constant over the
    square of the length: a third of the difference to windows of half the length is added. The
    error has three parts: the spread of blocks, this third, and a bound of the aliasing. The step
    is half the step of a density. Raises ``InvalidInput`` for so many or so high frequencies that
    they would take minutes.
    """
    system, row, at, most = asked.system, asked.row, asked.at, MOST_SUMS // (MAX_BATCHES * LANES)
    words = f"frequencies, each of which is summed on its own; ask for {most}"
    require(at.size <= most, "at", at.size, words)  # of 8192 windows of 3000 samples
    highest = max(float(np.max(np.abs(at))), highest_frequency(system))
    spacing = 2.0 * pi / max(SAMPLING * highest, OF_CONTACT * contact_frequency(system))
    dt, too_long = motion_step(method, system, Reach(), too_long=1.0)  # the bias is not measured
    length = 0.5 * (method.time or 2.0 * RECORD_TIMES * relaxation_time(system))
    length = 2 * ceil(length / spacing)
    words = f"a window takes {length:.1e} samples at the highest frequency; ask for lower ones"
    require(length <= MOST_SUMS // 2, "at", highest, words)
    step, too_long = (ceil(2.0 * spacing / dt), too_long) if needs_steps(system) else (1, [])
    powers, means, leakage = list[Array](), list[Array](), np.zeros(0)

    def estimate(sums: list[Array], rms: Array, _: int) -> tuple[Array, float]:
        nonlocal leakage
        split = sums[0].reshape(-1, at.size, 3, 2, LANES)
        means.append(split.mean(axis=(0, 4)))
        powers.append(np.sum(split**2, axis=3).mean(axis=3))
        power = np.concatenate(powers)  # (blocks, frequencies, windows)
        paths, mean = len(power) * LANES, np.sum(np.mean(means, axis=0) ** 2, axis=2)
        power = power * paths / (paths - 1.0) - mean * (paths / (paths - 1.0))
        norm = spacing / (2.0 * pi * 0.375 * length)  # Σ w² of a Hann window: 3/8 of its samples
        whole, halves = norm * power[:, :, 0], norm * 2.0 * power[:, :, 1:].mean(axis=2)
        leaks = (whole - halves) / 3.0
        leakage = leaks.mean(axis=0)
        return whole + leaks, float(rms[0] ** 3 / rms[1]) if rms[1] > 0.0 else 1.0

    read = partial(add_fourier_sums, row=row, omega=at * spacing, length=length)
    simulation, numbers = (spacing / step, step, False, read), (6 * at.size, LANES)
    blocks, scale, windows, failures = in_rounds(
        method, asked, [simulation], length, numbers, estimate, "spectrum"
    )
    # The spectrum has the tail N_ii/(π m² ω⁴). The aliases at 2π k/spacing ± ω together are less
    # than twice the nearest alias.
    tail = float(system.noise_matrix[row, row]) / (pi * float(system.mass[row]) ** 2)
    folded = 2.0 * tail / (2.0 * pi / spacing - np.abs(at)) ** 4
    settings = {"dt": spacing / step, "sampled every": spacing, "window": length * spacing}
    settings |= {"windows": windows, "seed": method.seed}
    settings["largest leakage"] = float(np.max(np.abs(leakage)))
    settings["largest folding"] = float(np.max(folded))
    return curve_answer(
        method, asked, blocks, (leakage, folded), scale, failures + too_long, settings
    )


def add_fourier_sums(
    trace: Array, samples: int, done: int, sums: Array, row: int, omega: Array, length: int
) -> None:
    """Add w q cos and w q sin to ``sums`` (blocks, 6 · frequencies, LANES); a ``Reader``.

    q of mass ``row``: the states after the first of ``trace`` are the samples from ``done`` on of
    the window, and samples beyond ``length`` do not count; ``omega`` (frequencies,) in radians per
    sample. The rows of a frequency are cos and sin of the Hann window over ``length`` samples, of
    the window over its first half, and of the window over its second half.
    """
    t = np.arange(done, min(done + samples, length))
    whole, part = (0.5 - 0.5 * np.cos(2.0 * pi * k * t / length) for k in (1, 2))
    windows = np.stack([whole, part * (2 * t < length), part * (2 * t >= length)])
    waves = np.stack([np.cos(np.outer(omega, t)), np.sin(np.outer(omega, t))])
    weights = np.einsum("wt,cft->fwct", windows, waves).reshape(-1, t.size)
    sums += weights @ trace[:, 1 : t.size + 1, row]


def sample_crossings(method: Settings, asked: Asked) -> Curve:
    """Return the upcrossings per unit time of the levels ``asked.at`` by q of mass ``asked.row``.

    Crossings by the noise within a step are not counted; their share is proportional to the step.
    The rate is extrapolated from dt and dt/2, by the same random numbers, and may be negative
    within its error: the whole difference, the spread of blocks and the rate of a single crossing
    in the whole sample, added in squares. Trajectories are ``time`` or ``RECORD_TIMES`` relaxation
    times long, and longer until ``tol`` is met.
    """
    system, row, order = asked.system, asked.row, np.argsort(asked.at)
    dt, too_long = motion_step(method, system, Reach(), error=tolerance(asked.tol, method.tol))
    whole = ceil((method.time or RECORD_TIMES * relaxation_time(system)) / dt)
    numbers: Any = {"row": row, "momentum": system.n + row, "levels": asked.at[order]}
    numbers["inverse_mass"] = 1.0 / float(system.mass[row])
    simulations: list[Simulation] = [
        (dt / each, each, each == 1, partial(count_upcrossings, dt=dt / each, **numbers))
        for each in (2, 1)
    ]
    # Upcrossings in each chunk, (steps, blocks, levels), and the number of its steps.
    counts, made, at_half = list[Array](), list[int](), np.zeros(0)

    def estimate(counted: list[Array], rms: Array, steps: int) -> tuple[Array, float]:
        nonlocal at_half
        made.append(steps)
        counts.append(np.cumsum(counted, axis=2)[:, :, :-1])
        at_half, at_whole = np.sum(counts, axis=0) / (LANES * (sum(made) * dt))
        scale = float(rms[1] / (2.0 * pi * rms[0])) if rms[0] > 0.0 else 1.0
        return 2.0 * at_half - at_whole, scale

    rates, scale, paths, failures = in_rounds(
        method, asked, simulations, whole, (asked.at.size + 1,), estimate, "crossings", least=CHUNKS
    )
    if sum(made) < whole and not method.seconds:
        failures.insert(0, "it was ended before all chunks were done")
    failures += too_long
    # Without chunks that were cut short, whose means are too noisy.
    full = [k for k, steps in enumerate(made) if steps >= whole // CHUNKS]
    if len(full) < 2:
        failures.append("it ended before its second chunk, no drift shows; give it more time")
    else:
        # (levels, blocks, chunks)
        means = np.array(counts)[full, 0].T / (np.array(made)[full] * dt)
        z, limit = np.abs(drifts(means)), largest_by_chance(means.shape[1], 2 * means.shape[0])
        if np.max(z) > limit:
            words = f"by {np.max(z):.1f} standard errors (chance explains {limit:.1f})"
            failures.append(f"the rates drift {words}; use a longer burn_in")
    bias, time = (rates - at_half).mean(axis=0), sum(made) * dt
    settings = {"dt": 0.5 * dt, "coarse dt": dt, "paths": paths, "time": time, "seed": method.seed}
    settings["largest step bias"] = float(np.max(np.abs(bias)))
    back, single = np.argsort(order), 1.0 / (paths * time)  # the rate of a single crossing
    rates = np.take(rates, back, axis=1)
    return curve_answer(method, asked, rates, (bias[back], single), scale, failures, settings)
