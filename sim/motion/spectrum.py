"""Power spectra of the full system (6) by simulation, and autocovariances."""

from functools import partial
from math import ceil, inf, pi

import numpy as np

from fpk.arrays import Array
from fpk.dynamics import Curve
from fpk.errors import InvalidInput
from fpk.method import Progress
from fpk.system import System
from sim.arrays import LANES
from sim.montecarlo import MonteCarlo
from sim.motion.motion import Motion, in_rows, needs_steps
from sim.motion.stationary import error_of, interruption, losses, not_met, sampled_curve, working
from sim.motion.steps import motion_step
from sim.motion.sums import add_fourier, add_lagged, compiled_sums
from sim.random import OTHER_SEED
from sim.relaxation import relaxation_time
from sim.step_size import contact_frequency, highest_frequency

PIECES = 8
"""Pieces of a window, after which Ctrl-C is heard."""

WINDOW = 40.0
"""Length of a window in decay times: the peak of a mode is flattened by (4π²/3)/40² = 0.8 %."""

SAMPLING, OF_CONTACT = 6.0, 3.0
"""Sampling frequency, in units of the highest that is asked for or natural, and of the highest in
contact: what folds back into the range is (1/5)⁴ of it where the spectrum falls as ω^−4."""

MOST_SAMPLES = 1 << 22
"""Samples of a window beyond which a frequency is refused: 8192 windows take minutes and more."""

MOST_SUMS = 1 << 23
"""Numbers that the windows of one round hold, 64 MB."""


def spectrum(
    method: MonteCarlo, system: System, row: int, at: Array, *, tol: float | None,
    progress: Progress,
) -> Curve:  # fmt: skip
    """Return the power spectral density of q of mass ``row`` at the angular frequencies ``at``.

    By Welch's method at just these frequencies: |Σ w q e^(−iωt)|² of one Hann window w on each
    trajectory, ``WINDOW`` decay times long, the variance about the mean of all. Leakage flattens it
    by a constant over the square of the length: windows of half the length, on the same samples,
    show it, and a third of the difference is added. Stated is, in quadrature, the error by blocks
    of trajectories, all of that third, and a bound of what sampling folds back. Steps are half
    those of a density, of whose bias a sixteenth is left.
    """
    compiled_sums()  # here: threads that read find it
    method.prepare(system)
    wanted = tol if tol is not None else method.tol
    spacing, step, length = _sampling(method, system, at)
    paths = -(-method.paths // LANES) * LANES
    own = max(1, min(paths // LANES, MOST_SUMS // (6 * at.size * LANES))) * LANES
    powers: list[Array] = []
    means: list[Array] = []
    scale, error = 1.0, inf
    squares: list[Array] = []
    with working(method, system, wanted) as (workers, watch, origin):
        number = 0
        while number * own < paths or not_met(method, wanted, error):
            seed = (method.seed + number * OTHER_SEED) % 2**64
            q, p = origin.drawn(own, number)
            motion = Motion(
                system, q, p, spacing / step, seed, stride=step, workers=workers
            )  # fmt: skip
            sums = np.zeros((own // LANES, 6 * at.size, LANES))
            read = partial(add_fourier, row=row, omega=at * spacing, length=length)
            for k in range(PIECES):
                motion.advance(length * (k + 1) // PIECES - length * k // PIECES, read, sums)
                if watch.ends() and number:
                    break
            if motion.samples < length:
                break
            states = in_rows(motion.last)
            squares.append(np.mean(states[:, [row, system.n + row]] ** 2, axis=0))
            number += 1
            split = sums.reshape(own // LANES, at.size, 3, 2, LANES)
            means.append(split.mean(axis=(0, 4)))
            powers.append(np.sum(split**2, axis=3).mean(axis=3))
            values, errors, leakage = _welch(powers, means, number * own, length, spacing)
            size = np.sqrt(np.mean(squares, axis=0))
            scale = float(size[0] ** 3 / size[1] * system.mass[row]) if size[1] > 0 else 1.0
            error = float(np.max(errors)) / scale
            progress(min(number * own, paths), paths, "spectrum")
            if watch.ends():
                break
        failures = interruption(watch) + losses(states[:, : 2 * system.n], spacing / step)
    folded = _folded(system, row, at, spacing)
    settings: dict[str, str | float | int] = {
        "dt": spacing / step,
        "sampled every": spacing,
        "window": length * spacing,
        "windows": number * own,
        "seed": method.seed,
        "largest leakage": float(np.max(np.abs(leakage))),
        "largest folding": float(np.max(folded)),
    }
    errors = np.sqrt(errors**2 + leakage**2 + folded**2)
    return sampled_curve(values, errors, scale, wanted, failures, settings)


def autocovariance(
    method: MonteCarlo, system: System, row: int, spacing: float, lags: int, *, progress: Progress
) -> tuple[Array, Array]:
    """Return E q(0) q(t) at t = 0, ``spacing``, … (``lags`` + 1 of them) and one standard error.

    Of q of mass ``row`` about zero; one origin on each of ``paths`` trajectories.
    """
    compiled_sums()  # here: threads that read find it
    method.prepare(system)
    dt = 0.5 * motion_step(method, system)
    stride = ceil(spacing / dt) if needs_steps(system) else 1
    paths = -(-method.paths // LANES) * LANES
    with working(method, system, None) as (workers, _, origin):
        q, p = origin.drawn(paths, 0)
        motion = Motion(
            system, q, p, spacing / stride, method.seed, stride=stride, workers=workers
        )  # fmt: skip
        begin = motion.last[:, row : row + 1].copy()
        sums = np.zeros((paths // LANES, 1 + lags))
        sums[:, 0] = np.sum(begin**2, axis=(1, 2))
        for k in range(PIECES):
            read = partial(add_lagged, row=row)
            motion.advance(lags * (k + 1) // PIECES - lags * k // PIECES, read, begin, sums)
            progress(k + 1, PIECES, "autocovariance")
    return sums.mean(axis=0) / LANES, error_of(sums / LANES)


def _sampling(method: MonteCarlo, system: System, at: Array) -> tuple[float, int, int]:
    """Time between samples, steps in it, and samples of a window (even).

    Raises ``InvalidInput`` for a frequency so high that a window has too many.
    """
    highest = max(float(np.max(np.abs(at))), highest_frequency(system))
    frequency = max(SAMPLING * highest, OF_CONTACT * contact_frequency(system))
    spacing = 2.0 * pi / frequency
    dt = 0.5 * motion_step(method, system)
    window = method.time or WINDOW * relaxation_time(system)
    samples = 2 * ceil(0.5 * window / spacing)
    if samples > MOST_SAMPLES:
        words = f"a window takes {samples:.1e} samples at the highest frequency; ask for lower ones"
        raise InvalidInput("at", highest, words)
    return spacing, ceil(spacing / dt) if needs_steps(system) else 1, samples


def _welch(
    powers: list[Array], means: list[Array], paths: int, length: int, spacing: float
) -> tuple[Array, Array, Array]:
    """Spectra, their errors by blocks, and the part that is added for leakage, (frequencies,)."""
    power = np.concatenate(powers)  # (blocks, frequencies, windows)
    about = np.sum(np.mean(means, axis=0) ** 2, axis=2) * (paths / (paths - 1.0))
    # Σ w² of a Hann window is 3/8 of its samples.
    norm = spacing / (2.0 * pi * 0.375 * length)
    whole = norm * (power[:, :, 0] * paths / (paths - 1.0) - about[:, 0])
    halves = norm * 2.0 * ((power[:, :, 1:] * paths / (paths - 1.0)) - about[:, 1:]).mean(axis=2)
    leakage = (whole - halves) / 3.0
    corrected = whole + leakage
    return corrected.mean(axis=0), error_of(corrected), leakage.mean(axis=0)


def _folded(system: System, row: int, at: Array, spacing: float) -> Array:
    """Bound of the spectrum at 2π k/spacing ± ω, by the tail N_ii/(π m² ω⁴) of white noise."""
    tail = float(system.noise_matrix[row, row]) / (pi * float(system.mass[row]) ** 2)
    below = 2.0 * pi / spacing - np.abs(at)
    # Twice the nearest one: those beyond are less than it together.
    return np.asarray(2.0 * tail / below**4)
