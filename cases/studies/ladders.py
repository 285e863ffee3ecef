"""Families of levels of one averaged equation, and what their errors show: in h, p and by tol."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from cases.studies.answer import FUNCTIONALS, NORMS, errors, sizes
from cases.studies.levels import P_DEGREES, Discretisation, Equation, Level, refined_levels
from fpk.density import Array
from fpk.method import Progress, silent
from fpk.orders import Convergence, GridConvergence, convergence, grid_convergence

H_DEGREES = {1: (1, 2, 4), 2: (1, 2, 3)}
"""Degrees in h, by the number of energies. Of two, degree 4 has two orders within 0.15 of 5 only at
37 000 unknowns and near the floor of the mesh's end, in as long as all others together."""
H_LEVELS = {1: 7, 2: 5}
"""Meshes, each the bisection of the one before, by the number of energies."""
DIGITS = 12
"""Tolerances are 1e-1 to 1e-12."""
ROUND_OFF = 1e-15
"""Relative floor of any answer: a few rounding errors of its largest values."""
COLUMNS = (*NORMS, *FUNCTIONALS)
"""Errors of a level in the order in which tables show them."""


@dataclass(frozen=True, eq=False)
class Ladder:
    """Levels from coarse to fine that start with ``first``, and what their errors show by norm.

    ``degree`` is that of the elements in h, None else; ``verdicts`` by norm and moment, ``grid`` by
    moment.
    """

    equation: Equation
    first: Discretisation
    degree: int | None
    levels: tuple[Level, ...]
    verdicts: dict[str, Convergence]
    grid: dict[str, GridConvergence]

    @property
    def name(self) -> str:
        """The family in tables and legends."""
        return f"h, p = {self.degree}" if self.degree else self.first.name

    def record(self) -> dict[str, Any]:
        """Return the ladder as plain data."""
        return {
            "name": self.name,
            "equation": self.equation.name,
            "dimension": self.equation.dimension,
            "family": self.first.family,
            "degree": self.degree,
            "levels": [{"label": v.settings, **asdict(v)} for v in self.levels],
            "verdicts": {key: asdict(v) for key, v in self.verdicts.items()},
            "grid": {key: asdict(g) for key, g in self.grid.items()},
        }


def ladders(equation: Equation, *, progress: Progress = silent) -> tuple[Ladder, ...]:
    """Return the h-ladders, a p-ladder, and one by tolerance of the route by elements."""
    n = equation.dimension
    plans: list[tuple[Discretisation, int]] = [
        *((equation.elements(degree), H_LEVELS[n]) for degree in H_DEGREES[n]),
        (equation.degrees(), len(P_DEGREES)),
        (equation.by_tolerance[0].at(1), DIGITS),
    ]
    results = []
    for k, (first, count) in enumerate(plans):
        progress(k, len(plans), f"convergence of {equation.name}")
        results.append(_ladder(equation, first, count))
    progress(len(plans), len(plans), f"convergence of {equation.name}")
    return tuple(results)


def degree_ladder(equation: Equation) -> Ladder:
    """Return the p-ladder alone."""
    return _ladder(equation, equation.degrees(), len(P_DEGREES))


def _ladder(equation: Equation, first: Discretisation, count: int) -> Ladder:
    levels = [level for _, level in refined_levels(first, equation.reference, count)]
    floor = floors(equation, given_mesh=first.family != "tol")
    if first.family == "tol":  # two tolerances with the same answer are one level
        most = np.maximum.accumulate([0, *(level.unknowns for level in levels)])
        levels = [level for level, n in zip(levels, most, strict=False) if level.unknowns > n]
    degree = first.degree if first.family == "h" else None
    h = [level.size for level in levels]
    verdicts = {
        key: convergence(
            h,
            [level.errors[key] for level in levels],
            theory=theoretical_order(key, degree) if degree else None,
            floor=floor[key],
        )
        for key in COLUMNS
    }
    grid = {
        key: grid_convergence(
            h,
            [level.functionals[key] for level in levels],
            theory=theoretical_order(key, degree),
            floor=floor[key],
        )
        for key in FUNCTIONALS
        if degree
    }
    return Ladder(equation, first, degree, tuple(levels), verdicts, grid)


def theoretical_order(key: str, degree: int) -> float:
    """Return p + 1 of the norms, 2 p of the moments (Galerkin duality), smoothness allowing it."""
    return float(degree + 1 if key in NORMS else 2 * degree)


def floors(equation: Equation, *, given_mesh: bool) -> dict[str, float]:
    """Return what cannot be resolved in each norm: the reference's own error, relative to p.

    On a ``given_mesh`` also twice what its end cuts off: the mass is missing there, and appears
    again in the norm of what is left.
    """
    p = equation.reference
    floor = {key: (p.l1_error + ROUND_OFF) * size for key, size in sizes(p).items()}
    if not given_mesh:
        return floor
    ends = [x[-1] for x in equation.coarsest(1)]

    def inside(*H: Array) -> Array:
        within = [x <= end for x, end in zip(H, ends, strict=True)]
        return np.where(reduce(np.logical_and, within), p.density(*H), 0.0)

    panels = tuple(np.unique(np.append(x, end)) for x, end in zip(p.panels, ends, strict=True))
    cut = errors(replace(p, panels=panels, density=inside), p)
    return {key: value + 2.0 * cut[key] for key, value in floor.items()}


def observed_rates(ladder: Ladder) -> list[str]:
    """Return the nats of error that a degree took off, by level; a dash where none is known."""
    orders: Sequence[float] = ladder.verdicts["L1"].orders
    known = ["–", *(f"{o:.2f}" for o in orders)]
    return known + ["–"] * (len(ladder.levels) - len(known))
