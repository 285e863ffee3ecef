"""The sampling of a burnt-in ensemble, chunk by chunk, until it is enough."""

from dataclasses import dataclass
from math import ceil, inf
from time import perf_counter
from typing import Any

import numpy as np

from fpk.method import Progress
from sim.checkpoint import Autosave
from sim.histogram import sampled_density, starts
from sim.record import SNAPSHOTS, Record
from sim.statistics import sampling_error

CHUNKS = 20
"""Chunks into which the sampled time is divided; after each progress is reported and trajectories
that left the finite range are counted."""

FIRST_CHUNK = 32
"""Divisor of the length of a chunk at the beginning of a run without a known end. Whenever such a
run has 2 ``CHUNKS``, they are joined in pairs, and those that follow are twice as long."""

LEAST_CHUNKS = 8
"""Chunks before which a target error is not trusted: halves of four can be compared."""

CHECK_AT = 0.95
"""Share of the samples wanted, as 1/error² predicts them, at which the error is computed again."""


@dataclass(frozen=True)
class Stop:
    """When the sampling ends: after ``time``, unless ``tol`` or ``seconds`` are given.

    ``tol`` is the expected L1 error of the first observable, ``seconds`` wall time since ``begin``;
    with both the first to come ends it.
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


@dataclass
class Loop:
    """Where the sampling stands: what a checkpoint holds beside the ensemble and the record.

    ``samples`` is the length of a chunk and ``begun`` the phase of the ensemble at its start;
    ``stepping`` and ``elapsed`` are seconds; ``target`` is the number of samples at which the
    ``error`` is computed again.
    """

    samples: int
    chunks: int = 0
    begun: int = 0
    stepping: float = 0.0
    error: float = inf
    target: float = 0.0
    elapsed: float = 0.0

    def saved(self) -> dict[str, Any]:
        """Return all of it as arrays."""
        return {
            "loop": np.array([self.samples, self.chunks, self.begun]),
            "measured": np.array([self.stepping, self.error, self.target, self.elapsed]),
        }

    @staticmethod
    def restored(saved: Any) -> "Loop":
        """Return the loop that ``saved`` returned."""
        return Loop(*map(int, saved["loop"]), *map(float, saved["measured"]))


def sample(
    ensemble: Any,
    record: Record,
    stop: Stop,
    *,
    stride: int,
    autosave: Autosave,
    progress: Progress,
    loop: Loop | None = None,
) -> Loop:
    """Advance ``ensemble`` until ``stop``, a trajectory is lost or ``autosave`` is interrupted.

    ``record`` gets what the diagnosis needs: the sums at the end of every chunk, and single
    samples of all trajectories at the beginning of some. With a ``loop`` it goes on from there,
    ``ensemble`` and ``record`` having been restored. A chunk that was interrupted is not recorded.
    """
    loop = loop or Loop(stop.chunk_samples(stride * ensemble.dt))
    while True:
        start = perf_counter()
        if ensemble.phase == loop.begun and record.squares and loop.chunks in SNAPSHOTS:
            before = ensemble.sums.copy()
            ensemble.advance(stride, stride=stride)
            with np.errstate(over="ignore", invalid="ignore"):  # lost trajectories count below
                record.snapshot(before, ensemble.sums, ensemble.live)
        loop.elapsed = start - stop.begin
        autosave.notes |= {**loop.saved(), **record.saved()}
        rest = loop.begun + loop.samples * stride - ensemble.phase
        interrupted = autosave.advance(ensemble, rest, stride=stride)
        loop.stepping += perf_counter() - start
        if interrupted:
            return loop
        loop.chunks, loop.begun = loop.chunks + 1, ensemble.phase
        if ensemble.lost():
            return loop
        record.chunk_ends(ensemble)
        loop.elapsed = perf_counter() - stop.begin
        late = loop.elapsed > stop.seconds
        if stop.tol is not None and (
            late or (loop.chunks >= LEAST_CHUNKS and ensemble.samples >= loop.target)
        ):
            loop.error = _first_error(ensemble, record)
            loop.target = CHECK_AT * ensemble.samples * (loop.error / stop.tol) ** 2
        share = _share_done(ensemble, stop, loop)
        progress(min(CHUNKS, int(CHUNKS * share)), CHUNKS, "simulation")
        met = stop.tol is not None and loop.error <= stop.tol and loop.chunks >= LEAST_CHUNKS
        if met or late or (not stop.open and loop.chunks == CHUNKS):
            return loop
        if stop.open and len(record.ends) == 2 * CHUNKS:
            record.join_pairs()
            loop.samples *= 2


def _share_done(ensemble: Any, stop: Stop, loop: Loop) -> float:
    """How much of the sampling is done; beyond 1 where it took longer than predicted."""
    if not stop.open:
        return loop.chunks / CHUNKS
    wanted = loop.target / CHECK_AT if stop.tol is not None else inf
    return max(ensemble.samples / wanted if wanted else 0.0, loop.elapsed / stop.seconds)


def _first_error(ensemble: Any, record: Record) -> float:
    """Expected L1 sampling error of the first observable."""
    histogram, taken = record.histograms[0], ensemble.paths * ensemble.samples
    counts = ensemble.counted(0, int(starts(record.histograms)[1]))
    return sampling_error(sampled_density(histogram, counts, taken=taken, mirror=record.mirror))
