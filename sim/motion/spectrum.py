"""Power spectra of the full system (6) by simulation."""

from functools import partial
from math import ceil, pi

import numpy as np

from fpk.arrays import Array
from fpk.dynamics import Curve, Question
from fpk.errors import InvalidInput
from fpk.system import System
from sim.arrays import LANES
from sim.montecarlo import MonteCarlo
from sim.motion.rounds import error_of, in_rounds, sampled_curve
from sim.motion.steps import motion_step, needs_steps
from sim.relaxation import relaxation_time
from sim.step_size import contact_frequency, highest_frequency

WINDOW = 40.0
"""Length of a window in decay times: the peak of a mode is flattened by (4π²/3)/40² = 0.8 %."""

SAMPLING, OF_CONTACT = 6.0, 3.0
"""Sampling frequency, in units of the highest that is asked for or natural, and of the highest in
contact: what folds back into the range is (1/5)⁴ of it where the spectrum falls as ω^−4."""

MOST_FREQUENCIES = 1024
"""Frequencies beyond which they are refused: 8192 windows of 3000 samples then take minutes."""

MOST_SAMPLES = 1 << 22
"""Samples of a window beyond which a frequency is refused: 8192 windows take minutes and more."""


def spectrum(method: MonteCarlo, asked: Question) -> Curve:
    """Return the power spectral density of q of mass ``row`` at the angular frequencies ``at``.

    By Welch's method at just these frequencies: |Σ w q e^(−iωt)|² of one Hann window w on each
    trajectory, ``WINDOW`` decay times long, the variance about the mean of all. Leakage flattens it
    by a constant over the square of the length: windows of half the length, on the same samples,
    show it, and a third of the difference is added. Stated is, in quadrature, the error by blocks
    of trajectories, all of that third, and a bound of what sampling folds back. Steps are half
    those of a density, of whose bias a sixteenth is left.
    """
    system, row, at, progress = asked.system, asked.row, asked.at, asked.progress
    wanted = method.tol if asked.tol is None else asked.tol
    spacing, step, length, too_long = _sampling(method, system, at)
    powers: list[Array] = []
    means: list[Array] = []
    squares: list[Array] = []
    scale = 1.0

    def estimate(sums: list[Array], square: Array) -> float:
        nonlocal scale
        split = sums[0].reshape(-1, at.size, 3, 2, LANES)
        means.append(split.mean(axis=(0, 4)))
        powers.append(np.sum(split**2, axis=3).mean(axis=3))
        squares.append(square[[row, system.n + row]])
        size = np.sqrt(np.mean(squares, axis=0))
        scale = float(size[0] ** 3 / size[1] * system.mass[row]) if size[1] > 0 else 1.0
        return float(np.max(_welch(powers, means, length, spacing)[1])) / scale

    read = partial(_add_fourier, row=row, omega=at * spacing, length=length)
    windows, failures = in_rounds(
        method, system, wanted, [(spacing / step, step, False)], length, (6 * at.size, LANES), read,
        estimate, what="spectrum", progress=progress,
    )  # fmt: skip
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


def _sampling(method: MonteCarlo, system: System, at: Array) -> tuple[float, int, int, list[str]]:
    """Time between samples, steps in it, samples of a window (even); why they are not certified.

    Raises ``InvalidInput`` for too many frequencies, or one so high that a window has too many
    samples.
    """
    if at.size > MOST_FREQUENCIES:
        words = f"frequencies, each of which is summed on its own; ask for {MOST_FREQUENCIES}"
        raise InvalidInput("at", at.size, words)
    highest = max(float(np.max(np.abs(at))), highest_frequency(system))
    frequency = max(SAMPLING * highest, OF_CONTACT * contact_frequency(system))
    spacing = 2.0 * pi / frequency
    dt, failures = motion_step(method, system, too_long=1.0)  # no second step shows the bias
    window = method.time or WINDOW * relaxation_time(system)
    samples = 2 * ceil(0.5 * window / spacing)
    if samples > MOST_SAMPLES:
        words = f"a window takes {samples:.1e} samples at the highest frequency; ask for lower ones"
        raise InvalidInput("at", highest, words)
    if not needs_steps(system):
        return spacing, 1, samples, []
    return spacing, ceil(2.0 * spacing / dt), samples, failures


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
