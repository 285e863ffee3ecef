"""What is collected in the stationary state while it steps: crossing rates and power spectra."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import ceil, inf, pi
from time import perf_counter
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.cores import usable_cores
from fpk.dynamics import Curve
from fpk.method import Progress
from fpk.start import Start
from fpk.system import System
from sim.arrays import LANES
from sim.checkpoint import interruptible
from sim.diagnostics import drift_limit, drifts
from sim.ensemble import MAX_COORDINATE
from sim.montecarlo import MonteCarlo
from sim.motion.counting import add_fourier, add_lagged, compiled_counting, count_upcrossings
from sim.motion.motion import Motion, in_rows, needs_steps
from sim.motion.passage import motion_step
from sim.motion.starts import Origin
from sim.random import OTHER_SEED
from sim.relaxation import relaxation_time
from sim.step_size import contact_frequency, highest_frequency
from sim.workers import workers_of

RELAXATIONS = 20.0
"""Relaxation times for which crossings are counted unless a time is given."""

CHUNKS, PIECES, AT_ONCE = 20, 8, 256
"""Parts of the time, compared to see a drift; pieces of a window, and steps of a part at most,
after which Ctrl-C is heard."""

WINDOW = 40.0
"""Length of a window in decay times: the peak of a mode is flattened by (4π²/3)/40² = 0.8 %."""

SAMPLING, OF_CONTACT = 6.0, 3.0
"""Sampling frequency, in units of the highest that is asked for or natural, and of the highest in
contact: what folds back into the range is (1/5)⁴ of it where the spectrum falls as ω^−4."""

MOST_SUMS = 1 << 23
"""Numbers that the windows of one round hold, 64 MB."""

STATIONARY = Start("noise", {"noise": 1.0})


@dataclass(eq=False)
class Watch:
    """Stop at Ctrl-C, where an answer may be partial, and when ``seconds`` have passed."""

    seconds: float
    stopped: Any
    begin: float

    def ends(self) -> bool:
        """Return whether it is time to stop."""
        return bool(self.stopped()) or perf_counter() - self.begin > self.seconds


@contextmanager
def _working(method: MonteCarlo, system: System, tol: float | None) -> Iterator[tuple[Any, ...]]:
    """Yield workers, the watch, and what draws stationary states."""
    compiled_counting()  # here: threads that read find it
    seconds = method.seconds or (method.longest if tol is not None else inf)
    with (
        workers_of(method.cluster, method.threads or usable_cores()) as workers,
        interruptible(method.partial) as stopped,
    ):
        origin = Origin(system, STATIONARY, method.seed, method.burn_in, workers)
        yield workers, Watch(seconds, stopped, perf_counter()), origin


def crossings(
    method: MonteCarlo, system: System, row: int, at: Array, *, tol: float | None,
    progress: Progress,
) -> Curve:  # fmt: skip
    """Return the upcrossings per unit time of the levels ``at`` by q of mass ``row``, counted.

    In the error, one of sampling by independent blocks of trajectories, is what changes at the step
    dt instead of dt/2, by the same random numbers. ``time`` of each trajectory (``RELAXATIONS``
    relaxation times where none is given) is followed by more until ``tol`` is met or ``seconds``
    have passed.
    """
    method.prepare(system)  # refuses what has no stationary state
    wanted = tol if tol is not None else method.tol
    dt = motion_step(method, system, error=wanted)
    paths = -(-method.paths // LANES) * LANES
    order = np.argsort(at, kind="stable")
    time = method.time or RELAXATIONS * relaxation_time(system)
    steps = ceil(time / dt)
    mass = float(system.mass[row])
    with _working(method, system, wanted) as (workers, watch, origin):
        q, p = origin.drawn(paths, 0)
        pair = [
            Motion(system, q, p, h, method.seed, halved=halved, workers=workers)
            for h, halved in ((0.5 * dt, False), (dt, True))
        ]
        counts = [np.zeros((paths // LANES, at.size + 1), dtype=np.int64) for _ in pair]
        ends: list[Array] = []
        squares: list[Array] = []
        scale, error, rates = inf, inf, np.zeros(0)
        while not (done := len(ends) >= CHUNKS and not _more(method, wanted, error)):
            chunk = max(1, steps * (len(ends) + 1) // CHUNKS - steps * len(ends) // CHUNKS)
            for begun in range(0, chunk, AT_ONCE):
                piece = min(AT_ONCE, chunk - begun)
                for motion, own in zip(pair, counts, strict=True):
                    read = partial(
                        count_upcrossings, dt=motion.dt, row=row, momentum=system.n + row,
                        inverse_mass=1.0 / mass, levels=at[order],
                    )  # fmt: skip
                    motion.advance(piece if motion.halved else 2 * piece, read, own)
                if watch.ends():
                    break
            states = in_rows(pair[0].last)
            squares.append(np.mean(states[:, [row, system.n + row]] ** 2, axis=0))
            ends.append(np.cumsum(counts[0], axis=1)[:, :-1].astype(float))
            rates = _rates(counts[0], pair[0].time)
            size = np.sqrt(np.mean(squares, axis=0))
            scale = float(size[1] / mass / (2.0 * pi * size[0])) if size[0] > 0 else 1.0
            error = float(np.max(_error(rates))) / scale
            progress(min(len(ends), CHUNKS), CHUNKS, "crossings")
            if watch.ends():
                break
        failures = [] if done or method.seconds else ["it was ended before all chunks were done"]
        failures += _interrupted(watch) + _lost(states[:, : 2 * system.n], dt)
    per_chunk = np.diff(np.array(ends), axis=0, prepend=0.0).transpose(2, 1, 0)
    failures += _drifting(per_chunk)
    total = paths * pair[0].time
    bias = _rates(counts[1], pair[1].time).mean(axis=0) - rates.mean(axis=0)
    errors, values = np.zeros(at.size), np.zeros(at.size)
    values[order] = rates.mean(axis=0)
    errors[order] = np.sqrt(_error(rates) ** 2 + bias**2 + total**-2.0)
    settings: dict[str, str | float | int] = {
        "dt": 0.5 * dt,
        "coarse dt": dt,
        "paths": paths,
        "time": pair[0].time,
        "seed": method.seed,
        "largest step bias": float(np.max(np.abs(bias))),
    }
    return _curve(values, errors, scale, wanted, failures, settings)


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
    method.prepare(system)
    wanted = tol if tol is not None else method.tol
    spacing, step, length = _sampling(method, system, at)
    paths = -(-method.paths // LANES) * LANES
    own = max(1, min(paths // LANES, MOST_SUMS // (6 * at.size * LANES))) * LANES
    powers: list[Array] = []
    means: list[Array] = []
    scale, error = 1.0, inf
    squares: list[Array] = []
    with _working(method, system, wanted) as (workers, watch, origin):
        number = 0
        while number * own < paths or _more(method, wanted, error):
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
        failures = _interrupted(watch) + _lost(states[:, : 2 * system.n], spacing / step)
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
    return _curve(values, errors, scale, wanted, failures, settings)


def autocovariance(
    method: MonteCarlo, system: System, row: int, spacing: float, lags: int, *, progress: Progress
) -> tuple[Array, Array]:
    """Return E q(0) q(t) at t = 0, ``spacing``, … (``lags`` + 1 of them) and one standard error.

    Of q of mass ``row`` about zero; one origin on each of ``paths`` trajectories.
    """
    method.prepare(system)
    dt = 0.5 * motion_step(method, system)
    stride = ceil(spacing / dt) if needs_steps(system) else 1
    paths = -(-method.paths // LANES) * LANES
    with _working(method, system, None) as (workers, _, origin):
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
    return sums.mean(axis=0) / LANES, _error(sums / LANES)


def _more(method: MonteCarlo, tol: float | None, error: float) -> bool:
    """Whether what was asked for is not met."""
    return error > tol if tol is not None else bool(method.seconds)


def _rates(counts: Any, time: float) -> Array:
    """Crossings per unit time (blocks, levels) from the counts of ``count_upcrossings``."""
    return np.asarray(np.cumsum(counts, axis=1)[:, :-1] / (LANES * time))


def _error(blocks: Array) -> Array:
    """One standard error of the mean of independent ``blocks`` (blocks, ...)."""
    return np.asarray(blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks)))


def _drifting(means: Array) -> list[str]:
    """Words for crossings whose first part differs from the rest, none where chance explains it."""
    if means.shape[2] < 2:
        return ["it ended in its first chunk, where no drift shows; give it more time"]
    z, limit = np.abs(drifts(means)), drift_limit(means.shape[1], 2 * means.shape[0])
    if np.max(z) <= limit:
        return []
    words = f"by {np.max(z):.1f} standard errors (chance explains {limit:.1f})"
    return [f"the rates drift {words}; use a longer burn_in"]


def _interrupted(watch: Watch) -> list[str]:
    return ["partial: interrupted by Ctrl-C"] if watch.stopped() else []


def _lost(states: Array, dt: float) -> list[str]:
    lost = int(np.count_nonzero(~(np.abs(states) < MAX_COORDINATE).all(axis=1)))
    words = f"{lost} trajectories left the finite range; use a smaller dt than {dt:g}"
    return [words] if lost else []


def _sampling(method: MonteCarlo, system: System, at: Array) -> tuple[float, int, int]:
    """Time between samples, steps in it, and samples of a window (even)."""
    highest = max(float(np.max(np.abs(at))), highest_frequency(system))
    frequency = max(SAMPLING * highest, OF_CONTACT * contact_frequency(system))
    spacing = 2.0 * pi / frequency
    dt = 0.5 * motion_step(method, system)
    window = method.time or WINDOW * relaxation_time(system)
    samples = 2 * ceil(0.5 * window / spacing)
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
    return corrected.mean(axis=0), _error(corrected), leakage.mean(axis=0)


def _folded(system: System, row: int, at: Array, spacing: float) -> Array:
    """Bound of the spectrum at 2π k/spacing ± ω, by the tail N_ii/(π m² ω⁴) of white noise."""
    tail = float(system.noise_matrix[row, row]) / (pi * float(system.mass[row]) ** 2)
    below = 2.0 * pi / spacing - np.abs(at)
    # Twice the nearest one: those beyond are less than it together.
    return np.asarray(2.0 * tail / below**4)


def _curve(
    values: Array, errors: Array, scale: float, tol: float | None, failures: list[str],
    settings: dict[str, str | float | int],
) -> Curve:  # fmt: skip
    relative = float(np.max(errors)) / scale
    measured = Measured(
        l1_error=relative,
        mass_defect=0.0,
        minimum=float(np.min(values)) / scale,
        residual=0.0,
        tail_mass=0.0,
        failures=tuple(failures),
        absolute_error=relative,
    )
    certificate = certify(measured, tol=inf if tol is None else tol, sampled=True)
    return Curve(values, errors, certificate, settings, error_kind="sampling")
