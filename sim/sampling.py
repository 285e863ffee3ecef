"""One simulation as it is asked for, and its sampling chunk by chunk until it is enough."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf, isinf
from time import perf_counter
from typing import Any, Literal

import numpy as np

from fpk.effects import effects_of
from fpk.method import Progress
from fpk.observable import Observable
from fpk.system import System
from sim.checkpoint import Autosave
from sim.histogram import Histogram, sampled_density, starts
from sim.montecarlo import MonteCarlo
from sim.record import SNAPSHOTS, Record
from sim.relaxation import relaxation_time
from sim.scheme import Scheme
from sim.statistics import Product, moment_products, sampling_error
from sim.step_size import sampling_interval

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


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that the numbers of one simulation of Eq. (6) depend on; times of the system.

    ``dt`` is the step in which the ensemble advances, the long one where ``scheme`` makes small
    ones. Each trajectory is sampled for ``time``; with ``tol`` until the expected L1 error of the
    first observable is below it, with ``seconds`` until that wall time has passed, or whichever
    comes first. ``histograms`` None: bins that cover what a pilot reaches. ``division`` and
    ``limited_by`` are for the report, see ``sim.report.Steps``.
    """

    method: MonteCarlo
    system: System
    observables: Sequence[Observable]
    scheme: Scheme
    dt: float
    time: float
    histograms: tuple[Histogram, ...] | None = None
    division: str = ""
    limited_by: Literal["", "most_steps"] = ""

    @property
    def tol(self) -> float | None:
        """The target of the expected L1 error of the first observable."""
        return self.method.tol if self.observables else None

    @property
    def seconds(self) -> float:
        """The wall time at which the sampling ends, infinity where only ``time`` ends it."""
        limit = self.method.longest if self.tol is not None else inf
        return limit if self.method.seconds is None else self.method.seconds

    @property
    def open(self) -> bool:
        """Whether the length is not known before."""
        return self.tol is not None or self.seconds < inf

    @cached_property
    def stride(self) -> int:
        """Steps from one sample to the next: closer ones are nearly equal, and cost time each."""
        return max(1, round(sampling_interval(self.system) / self.dt))

    @cached_property
    def burn_in_steps(self) -> int:
        """Steps before the sampling begins."""
        return ceil(self.method.burn_in * relaxation_time(self.system) / self.dt)

    @property
    def mirror(self) -> bool:
        """Whether mirror images of samples are samples, too."""
        return effects_of(self.system).mirror

    @property
    def products(self) -> tuple[Product, ...]:
        """The products whose means are observed."""
        terms = bool(self.system.damping_terms)
        return moment_products(self.system.n, terms=terms) if self.method.moments else ()

    @property
    def identity(self) -> tuple[Any, ...]:
        """What a checkpoint must agree with; it may be resumed with another limit of wall time."""
        m = self.method
        asked = (m.burn_in, self.time, m.moments, self.tol, isinf(self.seconds))
        steps = (self.scheme.name, self.scheme.small, self.dt, m.paths, m.seed)
        edges = [h.edges for h in self.histograms or ()]
        return (self.system, list(self.observables), *steps, *asked, edges)


def sample(
    ensemble: Any,
    record: Record,
    setup: Setup,
    *,
    begin: float,
    autosave: Autosave,
    progress: Progress,
) -> None:
    """Advance until ``setup`` is met, a trajectory is lost or ``autosave`` is interrupted.

    ``record`` gets what the diagnosis needs: the sums at the end of every chunk, and single
    samples of all trajectories at the beginning of some. Where it was restored, as ``ensemble``
    was, the sampling goes on from there. A chunk that was interrupted is not recorded. ``begin`` is
    the time of the clock at which the simulation began.
    """
    stride, tol = setup.stride, setup.tol
    chunks = CHUNKS * (FIRST_CHUNK if setup.open else 1)
    first = max(1, ceil(setup.time / (stride * ensemble.dt * chunks)))
    record.chunk_samples = record.chunk_samples or first
    while True:
        start, length = perf_counter(), record.chunk_samples * stride
        begun = len(record.ends) * length
        if ensemble.phase == begun and record.squares and record.chunks in SNAPSHOTS:
            before = ensemble.sums
            ensemble.advance(stride, stride=stride)
            with np.errstate(over="ignore", invalid="ignore"):  # lost trajectories count below
                record.snapshot(before, ensemble.sums, ensemble.live)
        record.elapsed = start - begin
        autosave.notes |= record.saved()
        interrupted = autosave.advance(ensemble, begun + length - ensemble.phase, stride=stride)
        record.stepping += perf_counter() - start
        if interrupted:
            return
        record.chunks += 1
        if ensemble.lost():
            return
        record.chunk_ends(ensemble)
        record.elapsed = perf_counter() - begin
        late, enough = record.elapsed > setup.seconds, record.chunks >= LEAST_CHUNKS
        if tol is not None and (late or (enough and ensemble.samples >= record.target)):
            record.error = first_error(ensemble, record)
            record.target = CHECK_AT * ensemble.samples * (record.error / tol) ** 2
        share = share_done(ensemble, record, setup)
        progress(min(CHUNKS, int(CHUNKS * share)), CHUNKS, "simulation")
        met = tol is not None and record.error <= tol and enough
        if met or late or (not setup.open and record.chunks == CHUNKS):
            return
        if setup.open and len(record.ends) == 2 * CHUNKS:
            record.join_pairs()


def share_done(ensemble: Any, record: Record, setup: Setup) -> float:
    """Return how much of the sampling is done; beyond 1 where it took longer than predicted."""
    if not setup.open:
        return record.chunks / CHUNKS
    wanted = record.target / CHECK_AT if setup.tol is not None else inf
    return max(ensemble.samples / wanted if wanted else 0.0, record.elapsed / setup.seconds)


def first_error(ensemble: Any, record: Record) -> float:
    """Return the expected L1 sampling error of the first observable."""
    histogram, taken = record.histograms[0], ensemble.paths * ensemble.samples
    counts = ensemble.counts[:, : starts(record.histograms)[1]]
    return sampling_error(sampled_density(histogram, counts, taken=taken, mirror=record.mirror))
