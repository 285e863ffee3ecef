"""A request of the full simulation: its run, and a second one at half the step."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, inf
from typing import Any

from fpk.cores import usable_cores
from fpk.method import Progress, Result
from fpk.observable import Observable
from fpk.system import System
from sim.histogram import Histogram
from sim.montecarlo import MonteCarlo
from sim.random import OTHER_SEED
from sim.report import Report, StepBias
from sim.setup import setup_of
from sim.simulation import simulate
from sim.statistics import l1_difference
from sim.workers import workers_of


def run(
    method: MonteCarlo,
    system: System,
    observables: Sequence[Observable],
    progress: Progress,
    *,
    beside: Sequence[Observable] = (),
) -> Result:
    """Return the densities of ``observables`` with their report, as ``method`` asks for them.

    Those of ``beside`` are sampled with them.
    """
    setup = setup_of(method, system, [*observables, *beside])
    with workers_of(method.cluster, method.threads or usable_cores()) as workers:
        result = simulate(setup, workers=workers, progress=progress)
        report = result.report
        assert isinstance(report, Report)
        if method.step_pair and report.diagnosis is not None:
            seed = (method.seed + OTHER_SEED) % 2**64
            densities: Any = result.densities  # of histograms
            half = replace(
                setup,
                method=replace(method, seed=seed),
                dt=0.5 * setup.dt,
                time=report.steps.time,
                tol=inf,
                seconds=2.0 / 3.0 * method.seconds if method.seconds else inf,
                histograms=tuple(Histogram(d.observable, d.bins) for d in densities),
            )
            report = with_step_bias(result, simulate(half, workers=workers, progress=progress))
    asked = len(observables)
    densities, others = result.densities[:asked], result.densities[asked:]
    return replace(
        result,
        densities=densities,
        beside=others,
        report=report,
        settings=report.settings(densities),
    )


def with_step_bias(result: Result, at_half: Result) -> Report:
    """Return the report of ``result`` with the differences from the run at half the step.

    Of a run that was interrupted or has no chunk by the limit of time there are none.
    """
    report, half = result.report, at_half.report
    assert isinstance(report, Report) and isinstance(half, Report)
    if half.interrupted or half.diagnosis is None:
        words = "interrupted" if half.interrupted else "the limit of time came"
        return replace(report, step_pair=f"not measured: {words}")
    pairs: Any = zip(result.densities, at_half.densities, strict=True)  # of histograms
    biases = {a.name: StepBias(*l1_difference(a, b)) for a, b in pairs}
    for a, b in zip(report.moments, half.moments, strict=True):
        biases[a.name] = StepBias(a.mean - b.mean, hypot(a.error, b.error))
    return replace(report, step_biases=biases, step_pair="dt against dt/2")
