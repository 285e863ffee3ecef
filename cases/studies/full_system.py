"""The full system's own density: by a route that solves (6), or by a long simulation."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.interpolate import PchipInterpolator

import cases.comparison.routes  # noqa: F401  (registers every route)
from cases.comparison.compare import chance_l1
from cases.studies.runs import coarse
from fpk.density import Array, Density, SampledDensity
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
    """Probabilities of the bins of p(q_i) of the full system, by their edges.

    ``error`` is the L1 error of what they rest on; ``sampled`` whether that is a simulation.
    """

    words: str
    shares: Callable[[Array], Array]
    error: float
    sampled: bool = False


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
        return FullReference(route, shares_of(density), density.l1_error)
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
    distribution = PchipInterpolator(edges, below)

    def shares(of: Array) -> Array:
        return np.diff(distribution(np.clip(of, edges[0], edges[-1])))

    return FullReference("long simulation", shares, chance_l1(coarse(sampled))[0], sampled=True)


def sampled_distance(sampled: SampledDensity, shares: Array) -> float:
    """Return Σ |share − true share| over the bins, all outside of them being one more bin."""
    difference = sampled.values * np.diff(sampled.edges[0]) - shares
    return float(np.sum(np.abs(difference)) + abs(np.sum(difference)))


def shares_of(density: Density) -> Callable[[Array], Array]:
    """Return the probability of bins by their edges."""

    def shares(edges: Array) -> Array:
        return np.asarray(density.cell_averages(edges) * np.diff(edges))

    return shares
