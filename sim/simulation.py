"""One simulation: burn-in, pilot, sampling in chunks until the sample is large enough."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from time import perf_counter

import numpy as np

from fpk.density import Certificate, SampledDensity
from fpk.effects import effects_of
from fpk.method import Progress, silent
from fpk.observable import Observable
from fpk.system import System
from sim.ensemble import Ensemble
from sim.histogram import Histogram, ranged, sampled_density, starts
from sim.relaxation import relaxation_time
from sim.scheme import Scheme
from sim.statistics import Moments, l1_error, moment_products
from sim.step_size import sampling_interval, temperature

CHUNKS = 20
"""Calls into which the sampled time is divided: progress is told and losses are seen between."""

SNAPSHOTS = 16
"""States of the whole ensemble from which the pilot finds the ranges of the histograms."""

LARGEST_TAIL = 1e-3
"""Share of samples outside a histogram above which its density is not certified."""

LARGEST_Z = 5.0
"""|z| of a moment identity that chance explains (6e-7 each)."""

STEP_BIAS = 1e-3
"""Defect of a moment identity, relative to its right side (a virial: to kT), that the step may
leave beyond chance; a long run sees less than this, and ``residual`` then shows the |z| of it."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What one run found; ``lost`` trajectories left the finite range."""

    densities: tuple[SampledDensity, ...]
    moments: Moments | None
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
    progress: Progress = silent,
) -> Simulation:
    """Sample the stationary state of Eq. (6) for ``time`` on each of ``paths`` trajectories.

    ``burn_in`` counts relaxation times (``sim.relaxation``). With ``tol`` the sampling goes on
    in chunks until the expected L1 error of the first observable is below it, at most for
    ``longest`` seconds of wall time. Samples are about an eighth of the shortest natural
    period apart: closer ones are nearly equal and cost a histogram entry each.
    """
    begin = perf_counter()
    ensemble = Ensemble(system, scheme, dt, paths, seed, threads)
    stride = max(1, round(sampling_interval(system) / dt))
    burnt = ceil(burn_in * relaxation_time(system) / dt)
    ensemble.advance(burnt)
    q, p = [], []
    for _ in range(SNAPSHOTS):
        ensemble.advance(8 * stride)
        q.append(ensemble.phase_points()[0])
        p.append(ensemble.phase_points()[1])
    effects = effects_of(system)
    with np.errstate(over="ignore", invalid="ignore"):
        histograms = ranged(
            system, observables, np.concatenate(q), np.concatenate(p), mirror=effects.mirror
        )
    products = moment_products(system.n, terms=effects.state_damping) if moments else ()
    ensemble.watch(histograms, products)
    chunk = stride * max(1, ceil(time / (dt * stride * CHUNKS)))
    stepping, chunks, failures = 0.0, 0, []
    while chunks < CHUNKS or tol is not None:
        start = perf_counter()
        ensemble.advance(chunk, stride=stride)
        stepping += perf_counter() - start
        chunks += 1
        progress(min(chunks, CHUNKS), CHUNKS, "simulation")
        if lost := ensemble.lost():
            failures.append(
                f"{lost} of {paths} trajectories left the finite range; use a smaller dt than {dt}"
            )
            break
        if tol is not None and (found := _first_error(ensemble, histograms)) <= tol:
            break
        if tol is not None and perf_counter() - begin > longest:
            failures.append(
                f"the sampling error {found:.3g} of {longest:g} s is above tol = {tol:g}"
            )
            break
    settings: dict[str, str | float | int] = {
        "scheme": scheme.name,
        "dt": dt,
        "paths": paths,
        "steps": chunks * chunk,
        "time": chunks * chunk * dt,
        "burn_in": burnt * dt,
        "stride": stride,
        "batches": ensemble.edges.size - 1,
        "seed": seed,
        "threads": threads,
        "kT": temperature(system),
        "ns_per_particle_step": 1e9 * stepping * threads / (paths * chunks * chunk),
    }
    return _judged(system, ensemble, histograms, failures, moments=moments, settings=settings)


def _first_error(ensemble: Ensemble, histograms: Sequence[Histogram]) -> float:
    certificate = Certificate(0.0, 0.0, 0.0, 0.0)
    counts = ensemble.counts[:, : histograms[0].size + 1]
    return l1_error(sampled_density(histograms[0], counts, certificate, {}))


def _judged(
    system: System,
    ensemble: Ensemble,
    histograms: Sequence[Histogram],
    failures: list[str],
    *,
    moments: bool,
    settings: dict[str, str | float | int],
) -> Simulation:
    lost = ensemble.lost()
    found = Moments(system, ensemble.batch_means()) if moments else None
    worst = 0.0
    if found is not None and not lost:
        for identity in found.identities():
            worst = max(worst, abs(identity.z))
            allowed = STEP_BIAS * (identity.expected or temperature(system))
            if abs(identity.value - identity.expected) > LARGEST_Z * identity.error + allowed:
                failures.append(
                    f"{identity.name} is off by {identity.z:.1f} standard errors; use a smaller dt"
                )
    densities, first = [], starts(histograms)
    for m, histogram in enumerate(histograms):
        counts = ensemble.counts[:, first[m] : first[m + 1]]
        total = counts.sum(axis=0)
        tail = float(total[-1]) / max(1, int(total.sum()))
        words = list(failures)
        if tail > LARGEST_TAIL:
            words.append(f"{tail:.2g} of the samples lie outside the histogram")
        certificate = Certificate(
            mass_defect=abs(float(total[:-1].sum()) / max(1, int(total.sum())) + tail - 1.0),
            minimum=float(total[:-1].min()) / max(1, int(total[:-1].max())),
            residual=worst,
            tail_mass=tail,
            failures=tuple(words),
        )
        densities.append(sampled_density(histogram, counts, certificate, settings))
    return Simulation(tuple(densities), found, lost, settings)
