"""One simulation: burn-in, pilot, sampling, and what the sample is worth."""

from collections.abc import Sequence
from contextlib import nullcontext
from math import inf, nan
from time import perf_counter
from typing import Any

import numpy as np

from fpk.density import SampledDensity
from fpk.method import Identity, Progress, silent
from fpk.system import System
from sim.checkpoint import Autosave, checkpoint_of, interruptible
from sim.diagnostics import Diagnosis, diagnosis
from sim.ensemble import Ensemble
from sim.histogram import Array, covering, extremes, sampled_density, starts
from sim.record import Record
from sim.relaxation import relaxation_time
from sim.report import DensityError, Report, Steps
from sim.sampling import CHUNKS, Setup, sample
from sim.statistics import Moments, sampling_error
from sim.step_size import temperature

SNAPSHOTS = 16
"""States of the ensemble from which the pilot takes the ranges of the histograms."""

PILOT_STEPS = 8
"""Sampling intervals between two of them: about a period of the fastest mode."""

PILOTS = 65536
"""Trajectories at most that the pilot reads: the extremes of more lie within the margin."""

LARGEST_Z = 5.0
"""|z| of a moment identity that chance explains: by Student's t 2e-5 each of 32 batches (4096
paths), 5e-6 of 64 (8192 and more)."""

STEP_BIAS = 1e-3
"""Defect of a moment identity, relative to its right side (a virial: to kT), that the step may
leave beyond chance; a long run resolves less than this, and ``residual`` then is the |z| of it."""


Answer = tuple[tuple[SampledDensity, ...], tuple[Identity, ...], Report]
"""The densities, the moment identities (none without moments), and the report."""


def simulate(
    setup: Setup,
    *,
    workers: Any = None,
    failures: Sequence[str] = (),
    progress: Progress = silent,
) -> Answer:
    """Sample the stationary state of Eq. (6) as ``setup`` says.

    ``workers`` do the work (None: one thread here). ``failures`` say what is known beforehand to
    stand against a certificate. The state is saved at intervals where the method has a folder for
    ``checkpoint``, and a simulation of the same setup goes on from there. Where its answer may be
    ``partial`` Ctrl-C ends the sampling, and what there is by then is the result, not certified.

    Where the system has the mirror symmetry, mirror images of samples count as samples.
    """
    begin = perf_counter()
    method, folder = setup.method, setup.method.checkpoint
    ensemble = Ensemble(
        setup.system, setup.scheme, setup.dt, method.paths, method.seed, workers=workers
    )
    autosave = Autosave(None if folder is None else checkpoint_of(folder, setup.identity))
    saved = autosave.load()
    sampling = "reached" in saved
    reached = saved["reached"] if sampling else _burnt_in(setup, ensemble, autosave, saved)
    histograms = setup.histograms or covering(setup.observables, reached, mirror=setup.mirror)
    ensemble.watch(histograms, setup.products)
    record = Record(histograms, setup.products, setup.system.mass, setup.mirror)
    if sampling:
        ensemble.restore(saved)
        record.restore(saved)
        begin -= record.elapsed
    autosave.notes["reached"] = reached
    with interruptible() if method.partial else nullcontext() as autosave.stopped:
        sample(ensemble, record, setup, begin=begin, autosave=autosave, progress=progress)
    autosave.save(ensemble)
    interrupted = ""
    if autosave.interrupted:
        chunks = f"{record.chunks} chunks" if setup.open else f"{record.chunks} of {CHUNKS} chunks"
        interrupted = f"partial: interrupted after {chunks}"
    return _assessed(setup, ensemble, record, interrupted=interrupted, failures=failures)


def _burnt_in(setup: Setup, ensemble: Any, autosave: Autosave, saved: Any) -> Array:
    """Advance to the end of the burn-in, from the state in ``saved`` if there is one.

    Returns the extremes (coordinates, 2) of what the trajectories then reach in ``SNAPSHOTS``
    states, to choose the histograms by where they are not given.
    """
    coordinates = sum(map(len, setup.observables))
    # Any ranges: with the kinds of observables as later there is one kernel for all.
    reached = np.full((coordinates, 2), (-1.0, 1.0))
    ensemble.watch(covering(setup.observables, reached, mirror=setup.mirror), setup.products)
    if saved:
        ensemble.restore(saved)
    autosave.advance(ensemble, setup.burn_in_steps - ensemble.done, stride=0)
    if setup.histograms is None:
        reached = np.full((coordinates, 2), (inf, -inf))
        for _ in range(SNAPSHOTS):
            ensemble.advance(PILOT_STEPS * setup.stride, stride=0)
            states = ensemble.phase_points(PILOTS)
            low, high = extremes(setup.system, setup.observables, *states).T
            reached[:, 0] = np.minimum(reached[:, 0], low)
            reached[:, 1] = np.maximum(reached[:, 1], high)
    return reached


def _assessed(
    setup: Setup, ensemble: Any, record: Record, *, interrupted: str, failures: Sequence[str]
) -> Answer:
    """Return the certified densities, the moment identities and the report.

    ``failures`` and ``interrupted`` (in words, empty if it was not) stand against a certificate.
    Where trajectories were lost, or the sampling was interrupted, there is nothing to diagnose.
    """
    steps = _steps(setup, ensemble, record.stepping)
    words, lost = [interrupted] if interrupted else [], ensemble.lost()
    if lost:
        words.append(
            f"{lost} of {ensemble.paths} trajectories left the finite range;"
            f" use a smaller dt than {steps.dt:g}"
        )
    words += failures
    identities: tuple[Identity, ...] = ()
    if record.products:
        identities = Moments(setup.system, ensemble.batch_means()).identities()
    judged = identities if not lost else ()
    words += [text for identity in judged if (text := _defect(setup.system, identity))]
    diagnosed: Diagnosis | None = None
    effective = [] if lost or interrupted else record.effective(ensemble)
    if effective:
        time = ensemble.samples * (ensemble.dt * setup.stride)
        diagnosed = diagnosis(
            effective, record.names, record.means(),
            time=time, paths=ensemble.paths, burn_in=steps.burn_in,
        )  # fmt: skip
        words += diagnosed.failures
    first = starts(record.histograms)
    densities = tuple(
        sampled_density(
            histogram,
            ensemble.counts[:, first[m] : first[m + 1]],
            taken=ensemble.paths * ensemble.samples,
            mirror=record.mirror,
            residual=max((abs(identity.z) for identity in judged), default=nan),
            tol=setup.tol if setup.tol is not None and m == 0 else inf,
            failures=words,
        )
        for m, histogram in enumerate(record.histograms)
    )
    report = Report(
        steps=steps,
        errors=tuple(DensityError(d.observable, sampling_error(d)) for d in densities),
        diagnosis=diagnosed,
        moments=record.moments(ensemble, effective) if record.products and not lost else (),
        interrupted=interrupted,
        lost=lost,
    )
    return densities, identities, report


def _defect(system: System, identity: Identity) -> str:
    """Return why a moment identity fails, empty where chance and a small step bias explain it."""
    allowed = STEP_BIAS * (identity.expected or temperature(system))
    if abs(identity.value - identity.expected) > LARGEST_Z * identity.error + allowed:
        return f"{identity.name} is off by {identity.z:.1f} standard errors; use a smaller dt"
    return ""


def _steps(setup: Setup, ensemble: Any, seconds: float) -> Steps:
    steps = ensemble.samples * setup.stride
    return Steps(
        scheme=setup.scheme.name,
        dt=setup.dt / setup.scheme.small,
        paths=ensemble.paths,
        steps=steps,
        time=steps * setup.dt,
        burn_in=setup.burn_in_steps * setup.dt,
        stride=setup.stride,
        batches=ensemble.edges.size - 1,
        seed=ensemble.seed,
        threads=ensemble.threads,
        temperature=temperature(setup.system),
        long_step=setup.dt,
        nanoseconds=1e9 * seconds * ensemble.threads / (ensemble.paths * steps),
        relaxation_time=relaxation_time(setup.system),
        small=setup.scheme.small,
        division=setup.division,
        limited_by=setup.limited_by,
    )
