"""Paths of averaged energies, their histograms and sampling errors."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil, inf, nan

import numpy as np

from fpk.arrays import Array
from fpk.bins import BinAxis
from fpk.errors import InvalidInput
from fpk.machine import working_time
from fpk.method import Progress, silent
from fpk.observable import Coordinate, Observable
from fpk.sampled_density import SampledDensity
from sim.averaged.square_root import SquareRootForm, advanced, never
from sim.histogram import MARGIN, binned, covering, log_states, sampled_density
from sim.random import stream_of

BATCHES = 64
"""Independent batches of paths, each with its own stream of random numbers."""

LEAST_PATHS = 4 * BATCHES
"""Paths at the least: four a batch."""

PILOT_PATHS = 4096
"""Paths whose largest energies choose the ranges of the histograms."""

PILOT_SHARE = 0.25
"""Share of the time that a pilot may take: as many paths as half of those that follow it."""

BINS = (512, 64)
"""Bins of each axis of a histogram of one and of two energies."""


def simulate_energies(
    form: SquareRootForm,
    observables: Sequence[Observable],
    *,
    interval: float,
    steps: int,
    time: float,
    burn_in: float,
    paths: int = 16384,
    seed: int = 1,
    threads: int = 1,
    seconds: float | None = None,
    tol: float = inf,
    failures: Sequence[str] = (),
    progress: Progress = silent,
) -> tuple[SampledDensity, ...]:
    """Return sampled densities of energies H_i, pairs of them and H = Σ H_i, with their errors.

    ``paths`` in all are sampled every ``interval``, in ``steps`` steps, for ``time`` after
    ``burn_in``. Streams belong to batches of paths: the answer does not depend on ``threads``.
    Ranges come from a pilot with a stream of its own. ``seconds`` of wall time end it; nothing is
    certified where they are over in the burn-in.

    Raises ``InvalidInput`` for paths that fill no batches.
    """
    if paths < LEAST_PATHS or paths % BATCHES:
        raise InvalidInput("paths", paths, f"use a multiple of {BATCHES}, {LEAST_PATHS} or more")
    own, samples = paths // BATCHES, max(1, round(time / interval))
    begun = partial(burnt_in, form, interval=interval, steps=steps, time=burn_in)
    pilot_ends = Shares(seconds and PILOT_SHARE * seconds, 1).ends(BATCHES)
    shares = Shares(seconds, threads)
    pilot = form.energies(begun(PILOT_PATHS, stream_of(seed, BATCHES), pilot_ends))
    reached = np.array([(0.0, column(pilot, c).max()) for o in observables for c in o])
    histograms = covering(observables, reached, partial(energy_axis, form), bins=BINS)
    counts = [np.zeros((BATCHES, h.size + 1), dtype=np.int64) for h in histograms]
    short, taken = np.zeros(BATCHES, dtype=bool), np.zeros(BATCHES, dtype=np.int64)

    def sample(batch: int) -> None:
        stream, ends = stream_of(seed, batch), shares.ends(batch)
        X = begun(own, stream, ends)
        short[batch] = ends()
        for number in range(samples):
            if number and ends():
                break
            taken[batch] += own
            X = advanced(form, X, interval / steps, steps, stream, ends=ends)
            H = form.energies(X)
            for total, histogram in zip(counts, histograms, strict=True):
                total[batch] += histogram.counted([column(H, c) for c in histogram.observable])[0]

    with ThreadPoolExecutor(threads) as pool:
        for done, _ in enumerate(pool.map(sample, range(BATCHES)), start=1):
            progress(done, BATCHES, "averaged simulation")
    over = f"{seconds or 0.0:.3g} s were over in the burn-in; give it more time"
    too_short = [over] if short.any() else []
    densities = []
    for histogram, total in zip(histograms, counts, strict=True):
        density = sampled_density(
            histogram,
            total,
            taken=int(taken.sum()),
            residual=nan,  # no identity of the averaged equations is evaluated
            tol=tol,
            failures=[*failures, *too_short],
        )
        densities.append(replace(density, values=density.batch_values.mean(axis=0)))
    return tuple(densities)


def burnt_in(
    form: SquareRootForm,
    paths: int,
    stream: np.random.Generator,
    ends: Callable[[], bool] = never,
    *,
    interval: float,
    steps: int,
    time: float,
) -> Array:
    """Return X (paths, d) after ``time``, in intervals of ``steps`` each, from exponential ones.

    Or from the step on after which it ``ends()``.
    """
    X = stream.exponential(form.scales, (paths, form.scales.size))
    return advanced(form, X, interval / steps, ceil(time / interval) * steps, stream, ends=ends)


@dataclass(frozen=True)
class Shares:
    """The ``seconds`` of wall time from now on, None for ever, of batches in ``threads``."""

    seconds: float | None
    threads: int
    begin: float = field(default_factory=working_time)

    def ends(self, batch: int, part: float = 1.0) -> Callable[[], bool]:
        """Return what says that a batch, which begins now, has had a ``part`` of its share.

        Batches begin in order. What one takes less, or more, those that follow have more, or less.
        """
        if self.seconds is None:
            return never
        now, turns = working_time(), -(-BATCHES // self.threads)
        end = self.begin + self.seconds * min(1.0, (batch // self.threads + 1) / turns)
        end = now + part * (end - now)
        return lambda: working_time() > end


def energy_axis(
    form: SquareRootForm, coordinate: Coordinate, low: float, high: float, bins: int,
    *, rises: bool = False,
) -> BinAxis:  # fmt: skip
    """Return bins of an energy that was seen up to ``high``, as ``sim.histogram.axis_of`` does."""
    total = coordinate.index is None
    kinks = [*([0.0] if rises else []), *(form.kinks if total else ())]
    reference = partial(log_states, form.degrees_of_freedom if total else 1)
    high = (1.0 + 2.0 * MARGIN) * high
    return binned(0.0, high, kinks, bins, widening=True, reference=reference)


def column(H: Array, coordinate: Coordinate) -> Array:
    """Return one energy of the columns of H (paths, d), or their sum."""
    return np.asarray(H.sum(axis=1) if coordinate.index is None else H[:, coordinate.index])
