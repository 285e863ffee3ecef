"""One request of the full simulation: its step, its run, and a second one at half the step."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import hypot

from fpk.cores import usable_cores
from fpk.errors import InvalidInput
from fpk.method import Progress, Result
from fpk.observable import Observable
from fpk.system import System
from sim.cluster import workers_of
from sim.histogram import Histogram
from sim.montecarlo import MonteCarlo
from sim.relaxation import relaxation_time
from sim.report import Report, StepBias
from sim.sampling import Setup
from sim.scheme import SCHEMES
from sim.simulation import simulate
from sim.statistics import l1_difference
from sim.step_size import check_step, chosen_step
from sim.substeps import cost, with_long_steps

OTHER_SEED = 0x9E3779B97F4A7C15
"""Added to the seed for the second simulation of a pair: 2**64 over the golden ratio."""


def run(
    method: MonteCarlo, system: System, observables: Sequence[Observable], progress: Progress
) -> Result:
    """Return the densities of ``observables`` with their report, as ``method`` asks for them."""
    unstable = _unstable(method, system)
    setup = _setup(method, system, observables)
    with workers_of(method.cluster, method.threads or usable_cores()) as workers:
        simulated = partial(simulate, workers=workers, failures=unstable, progress=progress)
        densities, identities, report = simulated(setup)
        if method.step_pair and not (report.lost or report.interrupted):
            seed = (method.seed + OTHER_SEED) % 2**64
            half = replace(
                setup,
                method=replace(method, seed=seed, tol=None, seconds=None),
                dt=0.5 * setup.dt,
                time=report.steps.time,
                histograms=tuple(Histogram(d.observable, d.edges) for d in densities),
            )
            others, _, half_report = simulated(half)
            distances = [l1_difference(a, b) for a, b in zip(densities, others, strict=True)]
            report = _with_step_bias(report, half_report, distances)
    settings = report.settings()
    return Result(
        method=method,
        densities=tuple(replace(density, provenance=settings) for density in densities),
        identities=identities,
        settings=settings,
        partial=bool(report.interrupted),
        report=report,
    )


def _step(method: MonteCarlo, system: System) -> float:
    return method.step_factor * chosen_step(system) if method.dt is None else method.dt


def _unstable(method: MonteCarlo, system: System) -> tuple[str, ...]:
    """Why no answer with the step can be certified; raise ``InvalidInput`` unless it is allowed."""
    dt = _step(method, system)
    try:
        check_step(system, SCHEMES[method.scheme], dt)
    except InvalidInput as error:
        if not method.allow_unstable:
            raise
        return (f"the step {dt:g} was insisted on: it {error.remedy}",)
    return ()


def _setup(method: MonteCarlo, system: System, observables: Sequence[Observable]) -> Setup:
    dt = _step(method, system)
    scheme, long, division = with_long_steps(system, SCHEMES[method.scheme], dt)
    time = wanted = method.time or method.relaxations * relaxation_time(system)
    if method.time is None:
        price = cost(system, dt, scheme.small) if scheme.small > 1 else 1.0
        time = min(wanted, method.most_steps * dt / price)
    return Setup(
        method=method,
        system=system,
        observables=tuple(observables),
        scheme=scheme,
        dt=long,
        time=time,
        division=division,
        limited_by="most_steps" if time < wanted else "",
    )


def _with_step_bias(
    report: Report, half: Report, distances: Sequence[tuple[float, float]]
) -> Report:
    """Return the report with the differences from the run at half the step, by ``l1_difference``.

    Of a run that was interrupted there are none, and of one that lost trajectories no moments.
    """
    if half.interrupted:
        return replace(report, step_pair="not measured: interrupted")
    pairs = zip(report.errors, distances, strict=True)
    errors = tuple(replace(e, step_bias=StepBias(*distance)) for e, distance in pairs)
    if half.lost:
        words = f"{half.lost} trajectories left the finite range at dt/2"
        return replace(report, errors=errors, step_pair=words)
    moments = tuple(
        replace(a, step_bias=StepBias(a.mean - b.mean, hypot(a.error, b.error)))
        for a, b in zip(report.moments, half.moments, strict=True)
    )
    return replace(report, errors=errors, moments=moments, step_pair="dt against dt/2")
