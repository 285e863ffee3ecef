"""The sampling of a burnt-in ensemble, chunk by chunk, until it is enough."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf
from time import perf_counter
from typing import Any

import numpy as np

from fpk.certificate import Certificate
from fpk.method import Progress
from sim.checkpoint import Keeper
from sim.histogram import Histogram, mirrored, sampled_density, starts
from sim.record import SNAPSHOTS, Record
from sim.statistics import l1_error, told

CHUNKS = 20
"""Calls into which the sampled time is divided: progress is told and losses are seen between."""

FIRST_CHUNK = 32
"""Share of such a chunk, as a divisor, with which a run begins that may stop at any time; whenever
there are twice ``CHUNKS``, they are joined in pairs and those that follow are twice as long."""

LEAST_CHUNKS = 8
"""Chunks before which a target error is not believed: halves of four can be compared."""

LOOK_BEFORE = 0.95
"""Share of the samples wanted, as 1/error² foretells them, at which the error is computed again."""


@dataclass(frozen=True)
class Stop:
    """When the sampling ends: after ``time``, unless ``tol`` or ``seconds`` are given.

    ``tol`` is the expected L1 error of the first observable, ``seconds`` wall time since ``begin``;
    with both the first to come ends it, and a ``tol`` not met is a failure.
    """

    time: float
    tol: float | None
    seconds: float
    begin: float

    @property
    def open(self) -> bool:
        """Whether the length is not known before."""
        return self.tol is not None or self.seconds < inf

    def chunk_samples(self, interval: float) -> int:
        """Return the samples of the first chunk, ``interval`` apart."""
        return max(1, ceil(self.time / (interval * CHUNKS * (FIRST_CHUNK if self.open else 1))))


def sample(
    ensemble: Any, record: Record, stop: Stop, *, stride: int, keeper: Keeper, progress: Progress
) -> tuple[float, list[str]]:
    """Advance ``ensemble`` until ``stop``; return the seconds of stepping and what went wrong.

    ``record`` gets what the diagnosis needs: the sums at the end of every chunk, and single
    samples of all trajectories at the beginning of some. ``keeper`` keeps the state at intervals;
    where it has notes of this loop, the loop goes on from them, ``ensemble`` and ``record`` having
    been restored. A chunk that was interrupted is not in the record.
    """
    samples = stop.chunk_samples(stride * ensemble.dt)
    stepping, chunks, error, target, begun = 0.0, 0, inf, 0.0, 0
    if "loop" in keeper.notes:
        chunks, samples, begun = (int(number) for number in keeper.notes["loop"])
        stepping, error, target, _ = (float(number) for number in keeper.notes["measured"])
    while True:
        start = perf_counter()
        if ensemble.phase == begun and record.squares and chunks in SNAPSHOTS:
            before = ensemble.sums.copy()
            ensemble.advance(stride, stride=stride)
            with np.errstate(over="ignore", invalid="ignore"):  # lost trajectories are told below
                record.snapshot(before, ensemble.sums, ensemble.live)
        loop, measured = (chunks, samples, begun), (stepping, error, target, start - stop.begin)
        keeper.notes |= {"loop": np.array(loop), "measured": np.array(measured), **record.saved()}
        rest = begun + samples * stride - ensemble.phase
        if keeper.advance(ensemble, rest, stride=stride):
            words = f"partial: interrupted after {chunks}"
            words += " chunks" if stop.open else f" of {CHUNKS} chunks"
            return stepping + perf_counter() - start, [words]
        stepping += perf_counter() - start
        chunks, begun = chunks + 1, ensemble.phase
        if lost := ensemble.lost():
            small = ensemble.dt / ensemble.scheme.small
            words = f"{lost} of {ensemble.paths} trajectories left the finite range"
            return stepping, [f"{words}; use a smaller dt than {small:g}"]
        record.chunk_ends(ensemble)
        elapsed = perf_counter() - stop.begin
        late = elapsed > stop.seconds
        if stop.tol is not None and (
            late or (chunks >= LEAST_CHUNKS and ensemble.samples >= target)
        ):
            error = first_error(ensemble, record.histograms, mirror=record.mirror)
            target = LOOK_BEFORE * ensemble.samples * (error / stop.tol) ** 2
        wanted = target / LOOK_BEFORE if stop.tol is not None else inf
        share = max(ensemble.samples / wanted if wanted else 0.0, elapsed / stop.seconds)
        share = share if stop.open else chunks / CHUNKS
        progress(min(CHUNKS, int(CHUNKS * share)), CHUNKS, "simulation")
        if stop.tol is not None and error <= stop.tol and chunks >= LEAST_CHUNKS:
            return stepping, []
        if late and stop.tol is not None and error > stop.tol:
            words = f"the sampling error {error:.3g} of {stop.seconds:g} s is above"
            return stepping, [f"{words} tol = {stop.tol:g}"]
        if late or (not stop.open and chunks == CHUNKS):
            return stepping, []
        if stop.open and len(record.ends) == 2 * CHUNKS:
            record.join_pairs()
            samples *= 2


def first_error(ensemble: Any, histograms: Sequence[Histogram], *, mirror: bool) -> float:
    """Return the expected L1 error of the first observable, as ``l1_error`` tells it."""
    counts = ensemble.counted(0, int(starts(histograms)[1]))
    if mirror:
        counts = mirrored(histograms[0], counts)
    passed = Certificate(0.0, 0.0, 0.0, 0.0)
    return l1_error(told(sampled_density(histograms[0], counts, passed, {})))
