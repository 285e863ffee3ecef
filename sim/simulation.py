"""One simulation: burn-in, a pilot for the histograms, and sampling until it is enough."""

from functools import partial
from math import ceil, inf
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.clock import left_out, working_time
from fpk.effects import effects_of
from fpk.method import Progress, Result, silent
from sim.assessment import assessed
from sim.checkpoint import Checkpoint, interruptible
from sim.ensemble import Ensemble
from sim.histogram import axis_of, covering, extremes, sampled_density
from sim.record import SNAPSHOTS, Record
from sim.setup import Setup
from sim.statistics import moment_products

PILOT_STATES = 16
"""States of the ensemble from which the pilot takes the ranges of the histograms."""

PILOT_STEPS = 8
"""Sampling intervals between two of them: about a period of the fastest mode."""

PILOT_PATHS = 65536
"""Trajectories at most that the pilot reads: the extremes of more lie within the margin."""

CHUNKS = 20
"""Chunks into which the sampled time is divided."""

FIRST_CHUNK = 32
"""Divisor of the length of a chunk at the beginning of a run without a known end. Whenever it has
2 ``CHUNKS``, they are joined in pairs, and those that follow are twice as long."""

LEAST_CHUNKS = 8
"""Chunks before which a target error is not trusted: halves of four can be compared."""

CHECK_AT = 0.95
"""Share of the samples wanted, as 1/error² predicts them, at which the error is computed again."""


def simulate(setup: Setup, *, workers: Any = None, progress: Progress = silent) -> Result:
    """Sample the stationary state of Eq. (6) as ``setup`` says, by ``workers`` (None: one thread).

    Where the method has a folder for ``checkpoint`` the state is saved at intervals, and a
    simulation of the same setup goes on from there. Where it may be ``partial`` Ctrl-C ends the
    sampling, and what there is by then is the result, not certified.
    """
    method, cut = setup.method, ""
    checkpoint = setup.checkpoint()
    products = moment_products(setup.system.n, terms=bool(setup.system.damping_terms))
    covered = partial(covering, setup.observables, axis=partial(axis_of, setup.system))
    with checkpoint.alone(), interruptible(method.partial) as checkpoint.stopped:
        ensemble = Ensemble(
            setup.system, setup.scheme, setup.dt, method.paths, method.seed, workers=workers
        )
        saved = checkpoint.load()
        # Any ranges: with the kinds of observables as later there is one kernel for all.
        reached = np.full((sum(map(len, setup.observables)), 2), (-1.0, 1.0))
        ensemble.watch(covered(reached), products)
        with left_out():
            ensemble.advance(0, stride=0)  # compiles
        begin = working_time()
        checkpoint.deadline = begin + setup.seconds
        if "reached" in saved:
            reached = saved["reached"]
        else:
            reached, cut = _burnt_in(setup, ensemble, checkpoint, saved, progress=progress)
        ensemble.watch(setup.histograms or covered(reached), products)
        record = Record(ensemble, elapsed=working_time() - begin)
        if "reached" in saved:
            ensemble.restore(saved)
            record.restore(saved)
        if cut:
            ensemble.advance(1, stride=setup.stride)  # a sample of the states that there are
        else:
            checkpoint.notes["reached"] = reached
            _sample(setup, record, checkpoint=checkpoint, progress=progress)
            checkpoint.save(ensemble)
    of = "" if setup.open else f" of {CHUNKS}"
    where = cut or f"after {record.chunks}{of} chunks"
    interrupted = f"partial: interrupted {where}" if checkpoint.interrupted else ""
    limit, first = f"the limit of {setup.seconds:g} s came", "in its first chunk, before any drift"
    limited = "" if interrupted or record.chunks else f"{limit} {cut or first}; give it more time"
    return assessed(setup, record, interrupted=interrupted, limited=limited)


def _burnt_in(
    setup: Setup, ensemble: Ensemble, checkpoint: Checkpoint, saved: Any, *, progress: Progress
) -> tuple[Array, str]:
    """Advance to the end of the burn-in, from the state in ``saved`` if there is one.

    Returns the extremes (coordinates, 2) of ``PILOT_STATES`` states that follow, from which the
    histograms are chosen where they are not given; and where Ctrl-C or the limit of time cut all
    this short, in words, empty where it did not.
    """
    if saved:
        ensemble.restore(saved)
    whole = setup.burn_in_steps
    for k in range(1, CHUNKS + 1):
        if checkpoint.advance(ensemble, whole * k // CHUNKS - ensemble.done, stride=0):
            break
        progress(k, CHUNKS, "burn-in")
    share = min(ensemble.done / whole, 1.0)
    pilot, done = [], share == 1.0
    for k in range(PILOT_STATES if setup.histograms is None else 0):
        steps = PILOT_STEPS * setup.stride
        done = done and not checkpoint.advance(ensemble, steps, stride=0, saving=False)
        if done or k == 0:
            states = ensemble.phase_points(PILOT_PATHS)
            pilot.append(extremes(setup.system, setup.observables, *states))
    cut = "" if done else f"after {share:.2g} of the burn-in"
    if not pilot:
        return np.zeros((0, 2)), cut
    return np.stack([np.min(pilot, axis=0)[:, 0], np.max(pilot, axis=0)[:, 1]], axis=1), cut


def _sample(setup: Setup, record: Record, *, checkpoint: Checkpoint, progress: Progress) -> None:
    """Advance until ``setup`` is met or ``checkpoint`` is interrupted.

    ``record`` gets the sums at the end of every chunk, and single samples of all trajectories at
    the beginning of some; a chunk that was interrupted, or that the limit of time cut short, is not
    recorded.
    """
    ensemble, stride, tol = record.ensemble, setup.stride, setup.tol
    begin = working_time() - record.elapsed
    checkpoint.deadline = begin + setup.seconds
    chunks = CHUNKS * (FIRST_CHUNK if setup.open else 1)
    first = max(1, ceil(setup.time / (stride * ensemble.dt * chunks)))
    record.chunk_samples = record.chunk_samples or first
    while True:
        start, length = working_time(), record.chunk_samples * stride
        begun = len(record.ends) * length
        if ensemble.phase == begun and record.chunks in SNAPSHOTS:
            record.snapshot(stride)
        record.elapsed = start - begin
        checkpoint.notes |= record.saved()
        stopped = checkpoint.advance(ensemble, begun + length - ensemble.phase, stride=stride)
        record.stepping += working_time() - start
        if stopped:
            return
        record.chunks += 1
        record.chunk_ends()
        record.elapsed = working_time() - begin
        ends = record.elapsed > setup.seconds or (not setup.open and record.chunks == CHUNKS)
        enough = record.chunks >= LEAST_CHUNKS and ensemble.samples >= record.target
        if tol < inf and (ends or enough):
            taken = ensemble.paths * ensemble.samples
            error = sampled_density(
                *next(ensemble.counted()),
                taken=taken,
                mirror=effects_of(setup.system).mirror,
                everywhere=False,
            ).l1_error
            record.target = CHECK_AT * ensemble.samples * (error / tol) ** 2
            ends |= error <= tol
        done = record.chunks / CHUNKS
        if setup.open:
            sampled = CHECK_AT * ensemble.samples / record.target if record.target else 0.0
            done = max(sampled, record.elapsed / setup.seconds)
        progress(min(CHUNKS, int(CHUNKS * done)), CHUNKS, "simulation")
        if ends:
            return
        if setup.open and len(record.ends) == 2 * CHUNKS:  # one of every two
            record.ends, record.chunk_samples = record.ends[1::2], 2 * record.chunk_samples
