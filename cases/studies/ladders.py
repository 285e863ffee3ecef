"""Families of levels of one averaged equation, and their observed orders: in h, p and by tol."""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from cases.studies.equations import P_DEGREES, Equation
from cases.studies.levels import (
    FUNCTIONALS,
    NORMS,
    Discretisation,
    Level,
    errors,
    refined_levels,
    sizes,
)
from cases.studies.orders import Convergence, GridConvergence, convergence, grid_convergence
from fpk.density import Array
from fpk.method import Progress, silent

H_DEGREES = {1: (1, 2, 4), 2: (1, 2, 3)}
"""Degrees in h, by the number of energies."""
H_LEVELS = {1: 7, 2: 5}
"""Meshes, each the bisection of the one before, by the number of energies."""
DIGITS = 12
"""Tolerances are 1e-1 to 1e-12."""
ROUND_OFF = 1e-15
"""Relative floor of any answer: a few rounding errors of its largest values."""


@dataclass(frozen=True)
class Ladder:
    """Levels from coarse to fine of one family, with their orders by norm and moment.

    ``degree`` is that of the elements in h, None else; ``grid`` holds Richardson's value and the
    grid convergence index by moment, in h only.
    """

    name: str
    equation: str
    dimension: int
    family: str
    degree: int | None
    levels: tuple[Level, ...]
    verdicts: dict[str, Convergence]
    grid: dict[str, GridConvergence]


def ladders(equation: Equation, *, progress: Progress = silent) -> tuple[Ladder, ...]:
    """Return the h-ladders, a p-ladder, and one by tolerance of the route by elements."""
    n, route = equation.dimension, next(iter(equation.by_tolerance))
    plans = [
        *((equation.elements(degree), H_LEVELS[n]) for degree in H_DEGREES[n]),
        (equation.degrees(), len(P_DEGREES)),
        (equation.to_tolerance(route), DIGITS),
    ]
    results = []
    for k, (first, count) in enumerate(plans, start=1):
        results.append(ladder(equation, first, count))
        progress(k, len(plans), f"convergence of {equation.name}")
    return tuple(results)


def degree_ladder(equation: Equation) -> Ladder:
    """Return the p-ladder alone."""
    return ladder(equation, equation.degrees(), len(P_DEGREES))


def ladder(equation: Equation, first: Discretisation, count: int) -> Ladder:
    """Return ``count`` levels from ``first`` on, with their observed orders."""
    levels = [level for _, level in refined_levels(first, equation.reference, count)]
    if first.family == "tol":  # two tolerances with the same answer are one level
        most = np.maximum.accumulate([0, *(level.unknowns for level in levels)])
        levels = [level for level, n in zip(levels, most, strict=False) if level.unknowns > n]
    floor = floors(equation, given_mesh=first.family != "tol")
    h, degree, theory = [level.size for level in levels], first.degree, dict[str, float]()
    if degree:  # Galerkin duality doubles the order of moments
        theory = dict.fromkeys(NORMS, degree + 1.0) | dict.fromkeys(FUNCTIONALS, 2.0 * degree)
    verdicts = {
        key: convergence(h, [v.errors[key] for v in levels], theory=theory.get(key), floor=low)
        for key, low in floor.items()
    }
    grid = {
        key: grid_convergence(
            h, [v.functionals[key] for v in levels], theory=theory[key], floor=floor[key]
        )
        for key in FUNCTIONALS
        if theory
    }
    name = f"h, p = {degree}" if degree else first.name
    of = equation.name, equation.dimension, first.family, degree
    return Ladder(name, *of, tuple(levels), verdicts, grid)


def floors(equation: Equation, *, given_mesh: bool) -> dict[str, float]:
    """Return what cannot be resolved in each norm: the reference's own error, relative to p.

    On a ``given_mesh`` also what its end cuts off: the mass is missing there, and scales up what is
    left; ∫p² takes twice that.
    """
    p, ends = equation.reference, equation.ends
    relative, sized = p.l1_error + ROUND_OFF, sizes(p)
    if not given_mesh:
        return {key: relative * size for key, size in sized.items()}

    def inside(*H: Array) -> Array:
        within = [x <= end for x, end in zip(H, ends, strict=True)]
        return np.where(reduce(np.logical_and, within), p.density(*H), 0.0)

    cut = errors(replace(p, panels=tuple(map(np.union1d, p.panels, ends)), density=inside), p)
    return {key: (relative + 2.0 * cut["L1"]) * size + cut[key] for key, size in sized.items()}
