"""What is true of the full system: a closed form, or a long simulation that stands for it."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.interpolate import PchipInterpolator

from averaging.exact import Exact
from averaging.gaussian import Linear
from cases.comparison.compare import BINS_1D, chance_l1
from fpk.density import Array, Density, SampledDensity
from fpk.method import Method
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

REFERENCE_RELAXATIONS = 200.0
"""Sampled relaxation times of the simulation that stands for the full system where no closed form
does: three times the longest run that is compared with it."""
PATHS = 8192


@dataclass(frozen=True, eq=False)
class FullReference:
    """Shares of the bins of p(q_i) of the full system, and the L1 error of what they rest on."""

    words: str
    shares: Callable[[Array], Array]
    error: float


def full_reference(
    system: System,
    observable: Observable,
    *,
    seed: int,
    relaxations: float = REFERENCE_RELAXATIONS,
) -> FullReference:
    """Return the full system's p(q_i): a closed form, or a long simulation at 0.7 of the step."""
    methods: tuple[Method, ...] = (Exact(), Linear())
    for method in methods:
        if method.refusal(system, observable) is None:
            (density,) = method.solve(system, [observable]).densities
            assert isinstance(density, Density)
            words = f"closed form, {method.name}"
            return FullReference(words, shares_of(density), density.l1_error)
    run = MonteCarlo(paths=PATHS, relaxations=relaxations, seed=seed + 7919, step_factor=sqrt(0.5))
    (found,) = run.solve(system, [observable]).densities
    assert isinstance(found, SampledDensity)
    edges = found.edges[0]
    inside = np.concatenate([[0.0], np.cumsum(found.values * np.diff(edges))])
    # Between the edges of 1024 bins the distribution function is smooth to far below the noise.
    cdf = PchipInterpolator(edges, inside)

    def shares(wanted: Array) -> Array:
        return np.diff(cdf(np.clip(wanted, edges[0], edges[-1])))

    return FullReference("long simulation", shares, chance_l1(coarse(found))[0])


def coarse(sampled: SampledDensity) -> SampledDensity:
    """Join bins to about 128, as the comparison does."""
    bins = sampled.edges[0].size - 1
    return sampled.coarsened(bins // BINS_1D) if bins % BINS_1D == 0 else sampled


def sampled_distance(sampled: SampledDensity, shares: Array) -> float:
    """Return Σ |share − true share| over the bins, all outside of them being one more bin."""
    found = sampled.values * np.diff(sampled.edges[0])
    left = found - shares
    return float(np.sum(np.abs(left)) + abs(np.sum(left)))


def shares_of(density: Density) -> Callable[[Array], Array]:
    """Return the probability of bins by their edges."""

    def shares(edges: Array) -> Array:
        return np.asarray(density.cell_averages(edges) * np.diff(edges))

    return shares
