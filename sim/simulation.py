"""One simulation: burn-in, pilot, sampling in chunks until the sample is large enough."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from math import ceil, inf
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fpk.certificate import Certificate
from fpk.density import SampledDensity
from fpk.effects import effects_of
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.checkpoint import Keeper, checkpoint_of, edges_of, heard_interrupt, histograms_of
from sim.control import PathMeans, path_means
from sim.diagnostics import diagnosis
from sim.ensemble import Ensemble, batch_sizes
from sim.histogram import Histogram, covering, extremes, mirrored, sampled_density, starts
from sim.record import Record
from sim.relaxation import relaxation_time
from sim.sampling import Stop, sample
from sim.scheme import Scheme
from sim.statistics import Moments, l1_error, moment_products, told
from sim.step_size import sampling_interval, temperature

PARTIAL = "partial"
"""Setting of a simulation that Ctrl-C ended: when."""

SNAPSHOTS = 16
"""States of the ensemble from which the pilot finds the ranges of the histograms."""

PILOTS = 65536
"""Trajectories at most that the pilot looks at: the extremes of more lie within the margin."""

LARGEST_TAIL = 1e-3
"""Share of samples outside a histogram above which its density is not certified."""

LARGEST_Z = 5.0
"""|z| of a moment identity that chance explains: by Student's t 2e-5 each of 32 batches (4096
paths), 5e-6 of 64 (8192 and more)."""

STEP_BIAS = 1e-3
"""Defect of a moment identity, relative to its right side (a virial: to kT), that the step may
leave beyond chance; a long run sees less than this, and ``residual`` then shows the |z| of it."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What one run found; ``lost`` trajectories left the finite range.

    ``paths`` are the means of the products on each trajectory, None without moments.
    """

    densities: tuple[SampledDensity, ...]
    histograms: tuple[Histogram, ...]
    moments: Moments | None
    paths: PathMeans | None
    lost: int
    settings: dict[str, str | float | int]


def simulate(
    system: System,
    observables: Sequence[Observable],
    *,
    scheme: Scheme,
    dt: float,
    paths: int,
    time: float,
    seed: int,
    threads: int,
    burn_in: float = 10.0,
    moments: bool = True,
    tol: float | None = None,
    longest: float = 60.0,
    seconds: float | None = None,
    histograms: Sequence[Histogram] | None = None,
    make: Callable[..., Any] = Ensemble,
    folder: Path | None = None,
    partial: bool = False,
    known: Sequence[str] = (),
    progress: Progress = silent,
) -> Simulation:
    """Sample the stationary state of Eq. (6) for ``time`` on each of ``paths`` trajectories.

    Where the scheme makes small steps, ``dt`` is the long one; ``steps`` and nanoseconds in the
    settings count long ones, "dt" there is the small one. ``burn_in`` counts relaxation times
    (``sim.relaxation``). With ``tol`` the sampling goes on in chunks until the expected L1 error of
    the first observable is below it, at most for ``longest`` seconds of wall time; with ``seconds``
    until that wall time has passed. Samples are about an eighth of the shortest natural period
    apart: closer ones are nearly equal and cost a histogram entry each. ``histograms`` None: bins
    that cover what a pilot reaches.

    ``make`` makes the ensemble, here or on a cluster. In ``folder`` the state is kept at intervals,
    and a simulation of the same settings goes on from there. With ``partial`` Ctrl-C ends the
    sampling, and what there is by then is the result, not certified. ``known`` says what is known
    beforehand to stand against a certificate.

    Where the system has the mirror symmetry, densities are those of the samples and of their
    mirror images.
    """
    begin = perf_counter()
    ensemble = make(system, scheme, dt, paths, seed, threads)
    stride = max(1, round(sampling_interval(system) / dt))
    burnt = ceil(burn_in * relaxation_time(system) / dt)
    effects = effects_of(system)
    asked = (burn_in, time, moments, tol, seconds is None, [h.edges for h in histograms or ()])
    identity = (
        system,
        scheme.name,
        scheme.small,
        dt,
        paths,
        seed,
        list(map(observable_name, observables)),
    )
    products = moment_products(system.n, terms=effects.state_damping) if moments else ()
    keeper = Keeper(None if folder is None else checkpoint_of(folder, (*identity, *asked)))
    kept = keeper.load()
    sampling = "loop" in kept
    if sampling:
        histograms = histograms_of(kept, observables)
    else:
        # Any ranges: with the kinds of observables as later there is one kernel for all.
        reached = np.full((sum(map(len, observables)), 2), (-1.0, 1.0))
        ensemble.watch(covering(observables, reached, mirror=effects.mirror), products)
        if kept:
            ensemble.restore(kept)
        keeper.advance(ensemble, burnt - ensemble.done, stride=0)
    if histograms is None:
        reached = np.full((sum(map(len, observables)), 2), (inf, -inf))
        for _ in range(SNAPSHOTS):
            ensemble.advance(8 * stride, stride=0)
            found = extremes(system, observables, *ensemble.phase_points(PILOTS))
            reached[:, 0] = np.minimum(reached[:, 0], found[:, 0])
            reached[:, 1] = np.maximum(reached[:, 1], found[:, 1])
        histograms = covering(observables, reached, mirror=effects.mirror)
    ensemble.watch(histograms, products)
    record = Record(histograms, products, system.mass, effects.mirror)
    limit = seconds if seconds is not None else longest if tol is not None else inf
    if sampling:
        ensemble.restore(kept)
        record.restore(kept)
        keeper.notes = {name: kept[name] for name in ("loop", "measured")}
        begin -= float(kept["measured"][-1])
    keeper.notes |= edges_of(histograms)
    stop = Stop(time, tol, limit, begin)
    with heard_interrupt() if partial else nullcontext() as keeper.stopped:
        stepping, failures = sample(
            ensemble, record, stop, stride=stride, keeper=keeper, progress=progress
        )
    keeper.save(ensemble)
    failures = [*failures, *known]
    steps = ensemble.samples * stride
    settings: dict[str, str | float | int] = {
        "scheme": scheme.name,
        "dt": dt / scheme.small,
        "paths": paths,
        "steps": steps,
        "time": steps * dt,
        "burn_in": burnt * dt,
        "stride": stride,
        "batches": ensemble.edges.size - 1,
        "seed": seed,
        "threads": ensemble.threads,
        "kT": temperature(system),
        "long_step": dt,
        "ns_per_particle_step": 1e9 * stepping * ensemble.threads / (paths * steps),
    }
    if keeper.interrupted:
        settings[PARTIAL] = failures[0]
    return _judged(system, ensemble, record, failures, settings=settings)


def _judged(
    system: System,
    ensemble: Ensemble,
    record: Record,
    failures: list[str],
    *,
    settings: dict[str, str | float | int],
) -> Simulation:
    """Certify what was sampled; where trajectories were lost there is nothing to diagnose."""
    lost = ensemble.lost()
    found = Moments(system, ensemble.batch_means()) if record.products else None
    paths, worst = None, 0.0
    if found is not None and not lost:
        mean = batch_sizes(ensemble.edges, ensemble.paths) @ found.batch_means / ensemble.paths
        paths = path_means(
            system, ensemble.sums, ensemble.live, ensemble.samples, whole=(ensemble.paths, mean)
        )
        for identity in found.identities():
            worst = max(worst, abs(identity.z))
            allowed = STEP_BIAS * (identity.expected or temperature(system))
            if abs(identity.value - identity.expected) > LARGEST_Z * identity.error + allowed:
                failures.append(
                    f"{identity.name} is off by {identity.z:.1f} standard errors; use a smaller dt"
                )
    interval = ensemble.dt * int(settings["stride"])
    effective = () if lost or PARTIAL in settings else record.effective(ensemble, interval)
    if effective:
        diagnosed = diagnosis(
            effective,
            record.names,
            record.means(),
            time=ensemble.samples * interval,
            paths=ensemble.paths,
            burn_in=float(settings["burn_in"]),
        )
        failures += diagnosed.failures
        settings |= diagnosed.settings()
    densities, first = [], starts(record.histograms)
    for m, histogram in enumerate(record.histograms):
        counts = ensemble.counted(first[m], first[m + 1])
        total = counts.sum(axis=0)
        taken = ensemble.paths * ensemble.samples
        tail = float(total[-1]) / max(1, taken)
        words = list(failures)
        if int(total.sum()) != taken:
            words.append(f"{int(total.sum())} samples were counted of {taken} taken")
        if tail > LARGEST_TAIL:
            words.append(f"{tail:.2g} of the samples lie outside the histogram")
        certificate = Certificate(
            mass_defect=abs(float(total.sum()) / max(1, taken) - 1.0),
            minimum=float(total[:-1].min()) / max(1, int(total[:-1].max())),
            residual=worst,
            tail_mass=tail,
            failures=tuple(words),
        )
        if record.mirror:
            counts = mirrored(histogram, counts)
        densities.append(sampled_density(histogram, counts, certificate, settings))
        settings[f"sampling error of {densities[-1].name}"] = l1_error(told(densities[-1]))
    return Simulation(tuple(densities), tuple(record.histograms), found, paths, lost, settings)
