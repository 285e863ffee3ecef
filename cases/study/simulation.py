"""The full system (6): its simulation as the studies read it, and its density by another route."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt
from time import process_time
from typing import NamedTuple

from cases.compare.compare import chance_l1, join_bins
from cases.compare.routes import listed_routes
from cases.compare.stationary import answers_of
from cases.study.levels import timed_first
from fpk.answer.certificate import Measured
from fpk.answer.density import AnyDensity, Density, certify_density
from fpk.answer.method import Method, Result, Solves
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import InvalidInput, NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import Report
from sim.sample.settings import LEAST_PATHS

LARGEST, SMALLEST = 4.0, 2.0**-10
"""Steps tried, in units of the chosen one: beyond the largest no scheme is stable in contact."""
SMALL_STEP = 0.25
"""Step, in units of the chosen one, below which runs have fewer paths and a slow trial is final."""
TRIAL = 0.4
"""Relaxation times of a trial, after one of burn-in: an unstable step is seen within one."""
REFERENCE_RELAXATIONS = 200.0
"""Sampled relaxation times of a simulation as reference: three times the longest compared run."""
SEED_STEP = 7919
"""Added to the seed for the reference, which must be independent of what it judges."""


class Reference(NamedTuple):
    """Reference density of the full system, and as it was given; ``words`` name its method."""

    words: str
    density: Density
    given: AnyDensity


@dataclass(frozen=True)
class Run:
    """E q_i² of one simulation at the step ``dt``: its ``value`` with one standard ``error``.

    ``sampled`` is the sampled time of all paths, ``seconds`` the processor time.
    """

    dt: float
    value: float
    error: float
    sampled: float
    seconds: float


def observed(system: System) -> Observable:
    """Return the displacement that is studied: of the first mass that touches, else of the last."""
    index = system.contact_masses[0] if system.contact_masses else system.n - 1
    return (Coordinate("q", index),)


def squared(system: System) -> str:
    """Return the name of its square, such as ``q2²``."""
    return f"{observable_name(observed(system))}²"


def run(
    system: System, method: MonteCarlo, observables: Sequence[Observable] = ()
) -> tuple[Run, Result]:
    """Run ``method``; E q² is that of the ``observed`` displacement."""
    result, seconds = timed_first(lambda: method.solve(system, observables))
    assert isinstance(result.report, Report)
    report, square = result.report, result.report.moments[squared(system)]
    return Run(report.dt, square.value, square.error, report.paths * report.time, seconds), result


def largest_stable(system: System, method: MonteCarlo, *, patience: float) -> float | None:
    """Return the largest step, in units of the chosen one, that is not seen to be unstable.

    None where there is none down to ``SMALLEST``, or a trial of a small step takes more than
    ``patience`` seconds.
    """
    trial = replace(method, paths=LEAST_PATHS, relaxations=TRIAL, burn_in=1.0)
    factor = LARGEST
    while factor > SMALLEST:
        begin = process_time()
        try:
            run(system, replace(trial, step_factor=factor))
            return factor
        except InvalidInput as refusal:  # beyond the limit of stability
            if refusal.key != "dt":
                raise
        except NotCertified:
            if factor < SMALL_STEP and process_time() - begin > patience:
                return None
        factor /= sqrt(2.0) if factor > 2.0 * SMALL_STEP else 2.0
    return None


def deterministic(solves: Solves) -> list[Method]:
    """Return the quick methods, not sampled, that solve the full or an averaged equation."""
    routes = [r for r in listed_routes() if r.solves == solves and not r.sampled and r.quick]
    return [route.make() for route in routes]


def best_answer(
    methods: Sequence[Method], system: System, observable: Observable, problems: list[str]
) -> tuple[str, AnyDensity] | None:
    """Return the label and density of the certified answer with the smallest stated error.

    An answer that is not certified is taken where there is no other. Adds to ``problems`` what is
    wrong with it; where there is none, which methods failed.
    """
    answers = answers_of(system, [observable], methods)
    offers = [
        (not d.certificate.certified, d.l1_error if isinstance(d, Density) else 0.0, route.label, d)
        for route, d in answers.densities(observable).items()
    ]
    if not offers:
        problems += [f"{r.route.label}: {r.reason}" for r in answers.refused if r.failed]
        return None
    *_, label, density = min(offers, key=lambda offer: offer[:2])
    problems += [f"{label}: {failure}" for failure in density.certificate.failures]
    return label, density


def full_density(system: System, observable: Observable) -> Reference | None:
    """Return a certified density of the full system that is not sampled, None without one."""
    answer = best_answer(deterministic("full"), system, observable, [])
    label, density = answer or ("", None)
    if isinstance(density, Density) and density.certificate.certified:
        return Reference(label, density, density)
    return None


def full_reference(system: System, *, seed: int) -> Reference:
    """Return the full system's p(q_i); where none solves (6), a long simulation at 0.7 of the step.

    Raises ``NotCertified`` where the step of that simulation is unstable.
    """
    observable = observed(system)
    if known := full_density(system, observable):
        return known
    long = MonteCarlo(relaxations=REFERENCE_RELAXATIONS, seed=seed + SEED_STEP)
    method = replace(long, step_factor=sqrt(0.5))
    (sampled,) = method.solve(system, [observable]).densities
    assert isinstance(sampled, SampledDensity)
    few, own = join_bins(sampled), sampled.certificate
    measured = Measured(chance_l1(few)[0], None, None, own.residual, own.tail_mass)
    density = certify_density(
        observable, few.edges, sampled, lambda q: sampled.at(q)[1], measured=measured, tol=inf
    )
    return Reference("long simulation", density, sampled)
