"""The full system's own density: by a route that solves (6), or by a long simulation."""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy.interpolate import PchipInterpolator

import cases.comparison.routes  # noqa: F401  (registers every route)
from cases.comparison.compare import chance_l1
from cases.studies.runs import coarse
from fpk.certificate import Measured
from fpk.density import Array, Density, SampledDensity, certified_density
from fpk.errors import NotCertified
from fpk.method import Method
from fpk.observable import Observable
from fpk.route import ROUTES, Solves
from fpk.system import System
from sim.montecarlo import MonteCarlo

REFERENCE_RELAXATIONS = 200.0
"""Sampled relaxation times of the simulation that is the reference where no other route solves (6):
three times the longest run that is compared with it."""
PATHS = 8192
SEED_STEP = 7919
"""What is added to the seed for the reference, which must be independent of what it judges."""


@dataclass(frozen=True, eq=False)
class FullReference:
    """p(q_i) of the full system; ``words`` name its source, ``error`` is its L1 error."""

    words: str
    density: Density
    error: float


def deterministic(system: System, observable: Observable, solves: Solves) -> list[Method]:
    """Return the methods, not sampled, that give ``observable``, in the order of registration."""
    routes = [r for r in ROUTES.values() if r.solves == solves and not r.sampled]
    methods = [route.make() for route in routes]
    return [m for m in methods if m.refusal(system, observable) is None]


def full_density(system: System, observable: Observable) -> tuple[str, Density] | None:
    """Return the first certified density of the full system that is not sampled, and its route."""
    for method in deterministic(system, observable, "full"):
        (density,) = method.solve(system, [observable]).densities
        if isinstance(density, Density) and density.certificate.certified:
            return method.route.label, density
    return None


def full_reference(
    system: System,
    observable: Observable,
    *,
    seed: int,
    relaxations: float = REFERENCE_RELAXATIONS,
) -> FullReference:
    """Return the full system's p(q_i); where none solves (6), a long simulation at 0.7 of the step.

    Raises ``NotCertified`` where that simulation has no density.
    """
    if answer := full_density(system, observable):
        route, density = answer
        return FullReference(route, density, density.l1_error)
    method = MonteCarlo(
        paths=PATHS, relaxations=relaxations, seed=seed + SEED_STEP, step_factor=sqrt(0.5)
    )
    (sampled,) = method.solve(system, [observable]).densities
    assert isinstance(sampled, SampledDensity)
    if not np.all(np.isfinite(sampled.values)):
        raise NotCertified("the long simulation that is the reference has no density")
    edges = sampled.edges[0]
    below = np.concatenate([[0.0], np.cumsum(sampled.values * np.diff(edges))])
    # Between the edges of 1024 bins the distribution function is smooth to far below the noise.
    slope = PchipInterpolator(edges, below).derivative()

    def pdf(q: Array) -> Array:
        return np.where((q >= edges[0]) & (q <= edges[-1]), slope(q), 0.0)

    error = chance_l1(coarse(sampled))[0]
    tail = sampled.certificate.tail_mass
    measured = Measured(error, 0.0, 0.0, sampled.certificate.residual, tail)
    density = certified_density(
        observable, (edges,), pdf, lambda q: sampled.at(q)[1], measured=measured, tol=inf
    )
    return FullReference("long simulation", density, error)
