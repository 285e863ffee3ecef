"""What a sample is worth: identities, diagnosis, certified densities and the report."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np

from fpk.density import SampledDensity
from fpk.method import Identity
from fpk.system import System
from sim.diagnostics import Diagnosis, Effective, diagnosis
from sim.ensemble import batch_sizes
from sim.histogram import sampled_density, starts
from sim.record import Record
from sim.report import DensityError, Moment, Report, Steps
from sim.statistics import Moments, sampling_error
from sim.step_size import temperature

LARGEST_Z = 5.0
"""|z| of a moment identity that chance explains: by Student's t 2e-5 each of 32 batches (4096
paths), 5e-6 of 64 (8192 and more)."""

STEP_BIAS = 1e-3
"""Defect of a moment identity, relative to its right side (a virial: to kT), that the step may
leave beyond chance; a long run resolves less than this, and ``residual`` then is the |z| of it."""


def assessed(
    system: System,
    ensemble: Any,
    record: Record,
    steps: Steps,
    *,
    interrupted: str,
    failures: Sequence[str],
    tol: float | None,
) -> tuple[tuple[SampledDensity, ...], tuple[Identity, ...], Report]:
    """Return the densities with their certificates, the moment identities and the report.

    ``failures`` and ``interrupted`` (in words, empty if it was not) stand against a certificate;
    ``tol`` is asked of the first density. Where trajectories were lost, or the sampling was
    interrupted, there is nothing to diagnose.
    """
    words, lost = [interrupted] if interrupted else [], ensemble.lost()
    if lost:
        words.append(
            f"{lost} of {ensemble.paths} trajectories left the finite range;"
            f" use a smaller dt than {steps.dt:g}"
        )
    words += failures
    identities: tuple[Identity, ...] = ()
    if record.products:
        identities = Moments(system, ensemble.batch_means()).identities()
    judged = identities if not lost else ()
    words += [text for identity in judged if (text := _defect(system, identity))]
    effective, diagnosed = _diagnosed(ensemble, record, steps, lost=bool(lost or interrupted))
    words += diagnosed.failures if diagnosed else ()
    densities, first = [], starts(record.histograms)
    for m, histogram in enumerate(record.histograms):
        densities.append(
            sampled_density(
                histogram,
                ensemble.counted(first[m], first[m + 1]),
                taken=ensemble.paths * ensemble.samples,
                mirror=record.mirror,
                residual=max((abs(identity.z) for identity in judged), default=nan),
                tol=tol if tol is not None and m == 0 else inf,
                failures=words,
            )
        )
    report = Report(
        steps=steps,
        errors=tuple(DensityError(d.observable, sampling_error(d)) for d in densities),
        diagnosis=diagnosed,
        moments=moments_of(ensemble, record, effective) if record.products and not lost else (),
        interrupted=interrupted,
        lost=lost,
    )
    return tuple(densities), identities, report


def with_provenance(densities: Sequence[SampledDensity], report: Report) -> Any:
    """Return the densities with the settings of the report as their provenance."""
    return tuple(replace(density, provenance=report.settings()) for density in densities)


def _defect(system: System, identity: Identity) -> str:
    """What is wrong with an identity, empty where chance and a small step bias explain it."""
    allowed = STEP_BIAS * (identity.expected or temperature(system))
    if abs(identity.value - identity.expected) > LARGEST_Z * identity.error + allowed:
        return f"{identity.name} is off by {identity.z:.1f} standard errors; use a smaller dt"
    return ""


def _diagnosed(
    ensemble: Any, record: Record, steps: Steps, *, lost: bool
) -> tuple[tuple[Effective, ...], Diagnosis | None]:
    """Effective samples of every quantity, squares first, and what follows from them."""
    interval = ensemble.dt * steps.stride
    effective = () if lost else record.effective(ensemble, interval)
    if not effective:
        return (), None
    return effective, diagnosis(
        effective,
        record.names,
        record.means(),
        time=ensemble.samples * interval,
        paths=ensemble.paths,
        burn_in=steps.burn_in,
    )


def moments_of(ensemble: Any, record: Record, effective: Sequence[Effective]) -> tuple[Moment, ...]:
    """Return E q_i² and E v_i² over all trajectories, with errors from the means of single ones."""
    each = record.path_means(ensemble)
    errors = np.sqrt(each.var(axis=1, ddof=1) / ensemble.paths)
    sizes = batch_sizes(ensemble.edges, ensemble.paths)
    means = sizes @ ensemble.batch_means() / ensemble.paths
    samples = {e.name: e.samples for e in effective}
    return tuple(
        Moment(name, factor * float(means[k]), float(error), samples.get(name, nan))
        for (name, k, factor), error in zip(record.squares, errors, strict=True)
    )
