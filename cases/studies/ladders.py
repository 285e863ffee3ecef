"""Families of levels of one averaged equation, and what their errors show: in h, p and by tol."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from typing import Any, Literal

import numpy as np

from cases.studies.answer import FUNCTIONALS, NORMS, Answer, errors
from cases.studies.equations import Equation
from cases.studies.levels import (
    P_DEGREES,
    ByTolerance,
    Discretisation,
    Elements,
    Level,
    degrees,
    elements,
    refined_levels,
    theoretical_order,
)
from fpk.density import Array
from fpk.method import Progress, silent
from fpk.orders import Convergence, GridConvergence, convergence, grid_convergence

Family = Literal["h", "p", "tol"]

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


@dataclass(frozen=True)
class Ladder:
    """Levels from coarse to fine of one family, and what their errors show by norm.

    ``degree`` is that of the elements in h, None else; ``verdicts`` by norm and moment, ``grid`` by
    moment.
    """

    name: str
    equation: str
    dimension: int
    family: Family
    degree: int | None
    levels: tuple[Level, ...]
    verdicts: dict[str, Convergence]
    grid: dict[str, GridConvergence]

    def record(self) -> dict[str, Any]:
        """Return the ladder as plain data."""
        return {**asdict(self), "levels": [level.convergence_record() for level in self.levels]}


def ladders(equation: Equation, *, progress: Progress = silent) -> tuple[Ladder, ...]:
    """Return the h-ladders, a p-ladder, and one by tolerance of the route by elements."""
    steered = ByTolerance(equation.steered[0])
    plans: list[tuple[Discretisation, int]] = [
        *((elements(equation, p), H_LEVELS[equation.dimension])
          for p in H_DEGREES[equation.dimension]),
        (degrees(equation), len(P_DEGREES)),
        (steered, DIGITS),
    ]  # fmt: skip
    results = []
    for k, (first, count) in enumerate(plans):
        progress(k, len(plans), f"convergence of {equation.name}")
        results.append(_ladder(equation, first, count))
    progress(len(plans), len(plans), f"convergence of {equation.name}")
    return tuple(results)


def degree_ladder(equation: Equation) -> Ladder:
    """Return the p-ladder alone."""
    return _ladder(equation, degrees(equation), len(P_DEGREES))


def _ladder(equation: Equation, first: Discretisation, count: int) -> Ladder:
    levels = [level for _, level in refined_levels(first, equation.reference, count)]
    family: Family = first.sweep if isinstance(first, Elements) else "tol"
    degree = first.degree if isinstance(first, Elements) and first.sweep == "h" else None
    floor = floors(equation, given_mesh=family != "tol")
    if family == "tol":  # two tolerances with the same answer are one level
        most = np.maximum.accumulate([0, *(level.unknowns for level in levels)])
        levels = [level for level, n in zip(levels, most, strict=False) if level.unknowns > n]
    return Ladder(
        name=f"h, p = {degree}" if degree else first.name,
        equation=equation.name,
        dimension=equation.dimension,
        family=family,
        degree=degree,
        levels=tuple(levels),
        verdicts=_verdicts(levels, degree, floor),
        grid=_grid(levels, degree, floor) if degree else {},
    )


def _verdicts(
    levels: Sequence[Level], degree: int | None, floor: dict[str, float]
) -> dict[str, Convergence]:
    sizes = [level.size for level in levels]
    return {
        key: convergence(
            sizes,
            [level.errors[key] for level in levels],
            theory=theoretical_order(key, degree) if degree else None,
            floor=floor[key],
        )
        for key in COLUMNS
    }


def _grid(
    levels: Sequence[Level], degree: int, floor: dict[str, float]
) -> dict[str, GridConvergence]:
    sizes = [level.size for level in levels]
    return {
        key: grid_convergence(
            sizes,
            [level.functionals[key] for level in levels],
            theory=theoretical_order(key, degree),
            floor=floor[key],
        )
        for key in FUNCTIONALS
    }


def floors(equation: Equation, *, given_mesh: bool) -> dict[str, float]:
    """Return what cannot be resolved in each norm: the reference's own error, relative to p.

    On a ``given_mesh`` also twice what its end cuts off: the mass is missing there, and appears
    again in the norm of what is left.
    """
    reference = equation.reference
    nothing = Answer(reference.panels, lambda *H: 0.0 * sum(H), 0.0, 0)
    relative = reference.l1_error + ROUND_OFF
    floor = {norm: relative * size for norm, size in errors(nothing, reference).items()}
    if not given_mesh:
        return floor
    ends = [x[-1] for x in equation.coarsest(1)]

    def inside(*H: Array) -> Array:
        within = [x <= end for x, end in zip(H, ends, strict=True)]
        return np.where(reduce(np.logical_and, within), reference.density(*H), 0.0)

    panels = tuple(
        np.unique(np.append(x, end)) for x, end in zip(reference.panels, ends, strict=True)
    )
    cut = errors(Answer(panels, inside, 0.0, 0), reference)
    return {norm: value + 2.0 * cut[norm] for norm, value in floor.items()}
