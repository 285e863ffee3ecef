"""One simulation: burn-in, pilot, sampling in chunks until the sample is large enough."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf, isinf
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fpk.density import SampledDensity
from fpk.effects import effects_of
from fpk.method import Identity, Progress, silent
from fpk.observable import Observable
from fpk.system import System
from sim.assessment import assessed
from sim.checkpoint import Autosave, checkpoint_of, edges_of, histograms_of, interruptible
from sim.ensemble import Ensemble
from sim.histogram import Histogram, covering, extremes
from sim.record import Record
from sim.relaxation import relaxation_time
from sim.report import Report, Steps
from sim.sampling import CHUNKS, Loop, Stop, sample
from sim.scheme import Scheme
from sim.statistics import Product, moment_products
from sim.step_size import sampling_interval, temperature

SNAPSHOTS = 16
"""States of the ensemble from which the pilot takes the ranges of the histograms."""

PILOT_STEPS = 8
"""Sampling intervals between two of them: about a period of the fastest mode."""

PILOTS = 65536
"""Trajectories at most that the pilot reads: the extremes of more lie within the margin."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that the numbers of one simulation of Eq. (6) depend on; times of the system.

    ``dt`` is the step in which the ensemble advances, the long one where ``scheme`` makes small
    ones. ``burn_in`` counts relaxation times (``sim.relaxation``). Each of ``paths`` trajectories
    is sampled for ``time``; with ``tol`` until the expected L1 error of the first observable is
    below it, with ``seconds`` until that wall time has passed, or whichever comes first.
    ``histograms`` None: bins that cover what a pilot reaches.
    """

    system: System
    observables: Sequence[Observable]
    scheme: Scheme
    dt: float
    paths: int
    seed: int
    time: float
    burn_in: float = 10.0
    moments: bool = True
    tol: float | None = None
    seconds: float = inf
    histograms: tuple[Histogram, ...] | None = None

    @property
    def stride(self) -> int:
        """Steps from one sample to the next: closer ones are nearly equal, and cost time each."""
        return max(1, round(sampling_interval(self.system) / self.dt))

    @cached_property
    def burn_in_steps(self) -> int:
        """Steps before the sampling begins."""
        return ceil(self.burn_in * relaxation_time(self.system) / self.dt)

    @property
    def mirror(self) -> bool:
        """Whether mirror images of samples are samples, too."""
        return effects_of(self.system).mirror

    @property
    def products(self) -> tuple[Product, ...]:
        """The products whose means are observed."""
        terms = effects_of(self.system).state_damping
        return moment_products(self.system.n, terms=terms) if self.moments else ()

    @property
    def identity(self) -> tuple[Any, ...]:
        """What a checkpoint must agree with; it may be resumed with another limit of wall time."""
        asked = (self.burn_in, self.time, self.moments, self.tol, isinf(self.seconds))
        steps = (self.scheme.name, self.scheme.small, self.dt, self.paths, self.seed)
        edges = [h.edges for h in self.histograms or ()]
        return (self.system, list(self.observables), *steps, *asked, edges)


@dataclass(frozen=True, eq=False)
class Simulation:
    """What one simulation returns; ``identities`` are empty without moments."""

    densities: tuple[SampledDensity, ...]
    histograms: tuple[Histogram, ...]
    identities: tuple[Identity, ...]
    report: Report


def simulate(
    setup: Setup,
    *,
    make: Callable[..., Any] = Ensemble,
    threads: int = 1,
    folder: Path | None = None,
    partial: bool = False,
    failures: Sequence[str] = (),
    progress: Progress = silent,
) -> Simulation:
    """Sample the stationary state of Eq. (6) as ``setup`` says.

    ``make`` makes the ensemble, here or on a cluster. In ``folder`` the state is saved at
    intervals, and a simulation of the same setup goes on from there. With ``partial`` Ctrl-C ends
    the sampling, and what there is by then is the result, not certified. ``failures`` say what is
    known beforehand to stand against a certificate.

    Where the system has the mirror symmetry, mirror images of samples count as samples.
    """
    begin = perf_counter()
    ensemble = make(setup.system, setup.scheme, setup.dt, setup.paths, setup.seed, threads)
    autosave = Autosave(None if folder is None else checkpoint_of(folder, setup.identity))
    saved, loop = autosave.load(), None
    if "loop" in saved:
        histograms, loop = histograms_of(saved, setup.observables), Loop.restored(saved)
        begin -= loop.elapsed
    else:
        _burn_in(setup, ensemble, autosave, saved)
        histograms = setup.histograms or _pilot(setup, ensemble)
    ensemble.watch(histograms, setup.products)
    record = Record(histograms, setup.products, setup.system.mass, setup.mirror)
    if loop is not None:
        ensemble.restore(saved)
        record.restore(saved)
    autosave.notes |= edges_of(histograms)
    stop = Stop(setup.time, setup.tol, setup.seconds, begin)
    with interruptible() if partial else nullcontext() as autosave.stopped:
        loop = sample(
            ensemble, record, stop,
            stride=setup.stride, autosave=autosave, progress=progress, loop=loop,
        )  # fmt: skip
    autosave.save(ensemble)
    interrupted = ""
    if autosave.interrupted:
        chunks = f"{loop.chunks} chunks" if stop.open else f"{loop.chunks} of {CHUNKS} chunks"
        interrupted = f"partial: interrupted after {chunks}"
    steps = _steps(setup, ensemble, loop.stepping)
    densities, identities, report = assessed(
        setup.system, ensemble, record, steps,
        interrupted=interrupted, failures=failures, tol=setup.tol,
    )  # fmt: skip
    return Simulation(densities, tuple(histograms), identities, report)


def _burn_in(setup: Setup, ensemble: Any, autosave: Autosave, saved: Any) -> None:
    """Advance to the end of the burn-in, from the state in ``saved`` if there is one."""
    # Any ranges: with the kinds of observables as later there is one kernel for all.
    reached = np.full((sum(map(len, setup.observables)), 2), (-1.0, 1.0))
    ensemble.watch(covering(setup.observables, reached, mirror=setup.mirror), setup.products)
    if saved:
        ensemble.restore(saved)
    autosave.advance(ensemble, setup.burn_in_steps - ensemble.done, stride=0)


def _pilot(setup: Setup, ensemble: Any) -> tuple[Histogram, ...]:
    """Histograms that cover what the trajectories reach in ``SNAPSHOTS`` states."""
    reached = np.full((sum(map(len, setup.observables)), 2), (inf, -inf))
    for _ in range(SNAPSHOTS):
        ensemble.advance(PILOT_STEPS * setup.stride, stride=0)
        states = ensemble.phase_points(PILOTS)
        low, high = extremes(setup.system, setup.observables, *states).T
        reached[:, 0] = np.minimum(reached[:, 0], low)
        reached[:, 1] = np.maximum(reached[:, 1], high)
    return covering(setup.observables, reached, mirror=setup.mirror)


def _steps(setup: Setup, ensemble: Any, seconds: float) -> Steps:
    steps = ensemble.samples * setup.stride
    return Steps(
        scheme=setup.scheme.name,
        dt=setup.dt / setup.scheme.small,
        paths=setup.paths,
        steps=steps,
        time=steps * setup.dt,
        burn_in=setup.burn_in_steps * setup.dt,
        stride=setup.stride,
        batches=ensemble.edges.size - 1,
        seed=setup.seed,
        threads=ensemble.threads,
        temperature=temperature(setup.system),
        long_step=setup.dt,
        nanoseconds=1e9 * seconds * ensemble.threads / (setup.paths * steps),
        relaxation_time=relaxation_time(setup.system),
        small=setup.scheme.small,
    )
