"""Runs of the full system's simulation as the studies read them, and the largest step to try."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan, sqrt

from cases.comparison.compare import BINS_1D
from cases.studies.timing import timed_first
from fpk.density import SampledDensity
from fpk.errors import InvalidInput
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.report import Report, Steps

LARGEST = 4.0
"""Largest step tried, in units of the chosen one: beyond it no scheme is stable in contact."""
SMALL = 0.25
"""Step, in units of the chosen one, below which a slow trial ends the search."""
TRIAL = 0.4
"""Relaxation times of a trial, after one of burn-in: an unstable step is lost within one."""


@dataclass(frozen=True)
class Run:
    """One simulation: its ``steps``, E q_i² ``value`` with one standard ``error``, and a density.

    ``value`` is not a number where trajectories were lost; ``density`` is that of the first
    observable in about 128 bins, None without one; ``seconds`` of processor time.
    """

    steps: Steps
    value: float
    error: float
    seconds: float
    density: SampledDensity | None

    @property
    def sampled(self) -> float:
        """The sampled time of all paths."""
        return self.steps.paths * self.steps.time


def observed_mass(system: System) -> int:
    """Return the index of the mass that is studied: the first that touches, else the last."""
    return system.contact_masses[0] if system.contact_masses else system.n - 1


def run(system: System, method: MonteCarlo, observables: Sequence[Observable] = ()) -> Run:
    """Run ``method``; E q² is that of ``observed_mass``."""
    result, seconds = timed_first(lambda: method.solve(system, observables))
    report = result.report
    assert isinstance(report, Report)
    density = next((d for d in result.densities if isinstance(d, SampledDensity)), None)
    # Nothing is known of the means where trajectories were lost.
    moment = report.moments[observed_mass(system)] if report.moments else None
    return Run(
        report.steps,
        nan if moment is None else moment.mean,
        nan if moment is None else moment.error,
        seconds,
        None if density is None else coarse(density),
    )


def coarse(sampled: SampledDensity) -> SampledDensity:
    """Join bins to about 128, as the comparison does."""
    bins = sampled.edges[0].size - 1
    return sampled.coarsened(bins // BINS_1D) if bins % BINS_1D == 0 else sampled


def largest_stable(
    system: System, method: MonteCarlo, *, smallest: float, patience: float
) -> float | None:
    """Return the largest step, in units of the chosen one, that loses no trajectory.

    None where there is none above ``smallest``, or a trial of a small step takes more than
    ``patience`` seconds.
    """
    trial = replace(method, paths=LEAST_PATHS, relaxations=TRIAL, burn_in=1.0)
    factor = LARGEST
    while factor > smallest:
        try:
            tried = run(system, replace(trial, step_factor=factor))
        except InvalidInput as refusal:
            if refusal.key != "dt":
                raise
            factor /= sqrt(2.0)  # at or above the stability limit, which the method itself refuses
            continue
        if isfinite(tried.value):
            return factor
        if factor < SMALL and tried.seconds > patience:
            return None
        factor /= sqrt(2.0) if factor > 2.0 * SMALL else 2.0
    return None
