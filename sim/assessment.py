"""Certified densities, moment identities and the report, from the record of a sample."""

from math import inf, nan

from fpk.effects import effects_of
from fpk.method import Result
from sim.diagnostics import Diagnosis, diagnosis
from sim.ensemble import Ensemble
from sim.histogram import sampled_density
from sim.record import Record
from sim.relaxation import relaxation_time
from sim.report import Report, Steps
from sim.setup import Setup
from sim.statistics import moment_identities
from sim.step_size import temperature

LARGEST_Z = 5.0
"""|z| of a moment identity that chance explains: by Student's t 2e-5 of 32 batches, 5e-6 of 64."""

STEP_BIAS = 1e-3
"""Defect of a moment identity, relative to its right side (a virial: to kT), that the step may
leave beyond chance."""


def assessed(setup: Setup, record: Record, *, interrupted: str, limited: str) -> Result:
    """Return the certified densities, the moment identities and the report.

    ``interrupted``, in words and empty if it was not, stands against a certificate, as does what
    the limit of time cut short so that nothing can be diagnosed (``limited``). Of a system with
    mirror symmetry mirror images of samples count as samples.
    """
    ensemble = record.ensemble
    steps = _steps(setup, ensemble, record.stepping)
    failures = [*(words for words in (interrupted, limited) if words), *setup.failures]
    identities = moment_identities(setup.system, ensemble.batch_means())
    stationary = ensemble.done - ensemble.phase >= setup.burn_in_steps
    judged = identities if stationary else ()
    failures += [
        f"{identity.name} is off by {identity.z:.1f} standard errors; use a smaller dt"
        for identity in judged
        if abs(identity.value - identity.expected)
        > LARGEST_Z * identity.error + STEP_BIAS * (identity.expected or temperature(setup.system))
    ]
    diagnosed: Diagnosis | None = None
    if not (interrupted or limited):
        diagnosed = diagnosis(
            record.effective(), record.names, record.means(),
            time=ensemble.samples * (ensemble.dt * setup.stride), paths=ensemble.paths,
            burn_in=steps.burn_in,
        )  # fmt: skip
        failures += diagnosed.failures
    densities = tuple(
        sampled_density(
            histogram,
            counts,
            taken=ensemble.paths * ensemble.samples,
            mirror=effects_of(setup.system).mirror,
            residual=max((abs(identity.z) for identity in judged), default=nan),
            tol=setup.tol if m == 0 else inf,
            failures=failures,
        )
        for m, (histogram, counts) in enumerate(ensemble.counted())
    )
    report = Report(
        steps=steps,
        diagnosis=diagnosed,
        moments=record.moments(),
        interrupted=interrupted,
    )
    partial = bool(interrupted)
    return Result(setup.method, densities, identities=identities, partial=partial, report=report)


def _steps(setup: Setup, ensemble: Ensemble, seconds: float) -> Steps:
    steps = ensemble.samples * setup.stride
    return Steps(
        dt=setup.dt / setup.scheme.small,
        paths=ensemble.paths,
        time=steps * setup.dt,
        burn_in=min(setup.burn_in_steps, ensemble.done - ensemble.phase) * setup.dt,
        relaxation_time=relaxation_time(setup.system),
        scheme=setup.scheme.name,
        steps=steps,
        stride=setup.stride,
        batches=ensemble.edges.size - 1,
        seed=ensemble.seed,
        threads=ensemble.threads,
        kT=temperature(setup.system),
        long_step=setup.dt,
        ns_per_particle_step=1e9 * seconds * ensemble.threads / (ensemble.paths * steps),
        small_steps=setup.division,
        limited_by=setup.limited_by,
    )
