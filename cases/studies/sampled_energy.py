"""Simulation of the averaged equation (24): what the elements solve, by sampling."""

from dataclasses import replace
from functools import partial
from math import isfinite

import numpy as np

from cases.comparison.averaged import AveragedSimulation
from cases.comparison.compare import chance_l1
from cases.studies.equations import Equation
from cases.studies.full_system import coarse, sampled_distance, shares_of
from cases.studies.priced import NotTimed, Point, Priced
from cases.studies.timing import Timing, timed_first
from fpk.certificate import Certificate
from fpk.density import Density, SampledDensity
from fpk.method import Progress, silent
from fpk.system import System

ROUTE = "simulation of (24)"
PATHS = (256, 4096, 16384)


def averaged_route(
    system: System, equation: Equation, *, seed: int, progress: Progress = silent
) -> Priced | NotTimed:
    """Return the simulation of (24) in N, each run once after one that compiles."""
    method = AveragedSimulation("nonintegrable", seed=seed, threads=1)
    reference = equation.reference
    density = Density(
        equation.observable,
        reference.panels,
        reference.density,
        lambda *H: 0.0 * H[0],
        reference.l1_error,
        Certificate(0.0, 0.0, 0.0, 0.0),
    )
    points: list[Point] = []
    fewest = replace(method, paths=PATHS[0])
    _, compiling = timed_first(partial(fewest.solve, system, [equation.observable]))
    for k, paths in enumerate(PATHS):
        progress(k, len(PATHS), ROUTE)
        own = replace(method, paths=paths)
        result, seconds = timed_first(partial(own.solve, system, [equation.observable]))
        (found,) = result.densities
        assert isinstance(found, SampledDensity)
        sampled = coarse(found)
        true = sampled_distance(sampled, shares_of(density)(sampled.edges[0]))
        mean, quantile = chance_l1(sampled)
        allowed = quantile + reference.l1_error
        settings = f"{paths} paths, step {own.step:g}"
        if not (isfinite(true) and true <= allowed):
            words = "differs from the closed form by more than chance explains"
            return NotTimed(ROUTE, equation.name, settings, true, allowed, words)
        first = max(0.0, compiling - seconds) if k == 0 else 0.0
        points.append(
            Point(settings, mean, mean, Timing(seconds, np.nan, 1, first, np.nan, np.nan))
        )
    axis = "sampling error: expected L1 of p(H), found within chance of the reference"
    return Priced(ROUTE, equation.name, axis, tuple(points))
