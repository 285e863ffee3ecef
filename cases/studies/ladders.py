"""Levels of refinement of one averaged equation: in h, in p, and in both by a tolerance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Literal

import numpy as np

from cases.studies.answer import FUNCTIONALS, NORMS, Answer, errors, functionals
from cases.studies.equations import Equation
from cases.studies.names import BY_TOL
from fpk.density import Array
from fpk.method import Progress, silent
from fpk.orders import Convergence, GridConvergence, convergence, grid_convergence

Family = Literal["h", "p", "tol"]

H_DEGREES = {1: (1, 2, 4), 2: (1, 2, 3)}
"""Degrees in h, by the number of energies. Of two, degree 4 has two orders within 0.15 of 5 only at
37 000 unknowns and near the floor of the mesh's end, in as long as all others together."""
H_LEVELS = {1: 7, 2: 5}
"""Meshes, each the bisection of the one before, by the number of energies."""
P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
TOLERANCES = tuple(10.0**-k for k in range(1, 13))
ROUND_OFF = 1e-15
"""Relative floor of any answer: a few rounding errors of its largest values."""


@dataclass(frozen=True)
class Level:
    """One level: its settings in words, what it costs, its errors by norm and moment."""

    label: str
    size: float
    unknowns: int
    errors: dict[str, float]
    estimate: float
    functionals: dict[str, float]

    @property
    def honest(self) -> bool:
        """Whether the true L1 error is within the answer's own estimate."""
        return self.errors["L1"] <= self.estimate


@dataclass(frozen=True)
class Ladder:
    """Levels from coarse to fine of one family, and what their errors show by norm.

    ``size`` of a level is h for the family "h"; for "p" and "tol" it is exp(−p) and exp(−√N),
    so that orders are the nats of error that one degree, or one of √N unknowns, takes off.
    """

    equation: str
    dimension: int
    family: Family
    degree: int | None
    levels: tuple[Level, ...]
    verdicts: dict[str, Convergence]
    grid: dict[str, GridConvergence]

    @property
    def name(self) -> str:
        """The ladder in words."""
        words = {"p": "p on a fixed mesh", "tol": BY_TOL[self.dimension]}
        return f"h, p = {self.degree}" if self.family == "h" else words[self.family]


def ladders(equation: Equation, *, progress: Progress = silent) -> tuple[Ladder, ...]:
    """Return the h-ladders, a p-ladder, and one by tolerance."""
    plans: list[tuple[Family, int | None, list[tuple[str, float, Callable[[], Answer]]]]] = [
        *(("h", degree, _by_h(equation, degree)) for degree in H_DEGREES[equation.dimension]),
        ("p", None, _by_p(equation)),
        ("tol", None, _by_tol(equation)),
    ]
    total = sum(len(plan) for _, _, plan in plans)
    done, found = 0, []
    for family, degree, plan in plans:
        levels = []
        for label, size, solve in plan:
            answer = solve()
            # Only a solver that is steered by a tolerance has several ways.
            way = f", {answer.made}" if family == "tol" and answer.made else ""
            levels.append(_level(equation, label + way, size, answer))
            done += 1
            progress(done, total, f"convergence of {equation.name}")
        found.append(_judged(equation, family, degree, levels))
    return tuple(found)


def degree_ladder(equation: Equation) -> Ladder:
    """Return the p-ladder alone: on a fixed mesh with the contact energies among its nodes."""
    levels = [_level(equation, label, size, solve()) for label, size, solve in _by_p(equation)]
    return _judged(equation, "p", None, levels)


def bisected(nodes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the nodes of every axis with the middles between them."""
    return tuple(np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])])) for x in nodes)


def h_meshes(equation: Equation, degree: int, levels: int) -> list[tuple[Array, ...]]:
    """Return the coarsest mesh for ``degree`` and its bisections."""
    meshes = [equation.coarsest(degree)]
    for _ in range(levels - 1):
        meshes.append(bisected(meshes[-1]))
    return meshes


def _by_h(equation: Equation, degree: int) -> list[tuple[str, float, Callable[[], Answer]]]:
    meshes = h_meshes(equation, degree, H_LEVELS[equation.dimension])
    return [
        (
            " x ".join(str(x.size - 1) for x in nodes) + " elements",
            2.0**-k,
            partial(equation.on_mesh, nodes, degree),
        )
        for k, nodes in enumerate(meshes)
    ]


def _by_p(equation: Equation) -> list[tuple[str, float, Callable[[], Answer]]]:
    nodes = bisected(equation.coarsest(4))
    return [(f"p = {p}", float(np.exp(-p)), partial(equation.on_mesh, nodes, p)) for p in P_DEGREES]


def _by_tol(equation: Equation) -> list[tuple[str, float, Callable[[], Answer]]]:
    return [(f"tol = {tol:.0e}", 0.0, partial(equation.adaptive, tol)) for tol in TOLERANCES]


def _level(equation: Equation, label: str, size: float, answer: Answer) -> Level:
    if not size:
        size = float(np.exp(-np.sqrt(answer.unknowns)))
    return Level(
        label=label,
        size=size,
        unknowns=answer.unknowns,
        errors=errors(answer, equation.reference),
        estimate=answer.l1_error + equation.reference.l1_error,
        functionals=functionals(answer),
    )


def floors(equation: Equation, *, given_mesh: bool) -> dict[str, float]:
    """Return what cannot be resolved in each norm: the reference's own error, relative to p.

    On a ``given_mesh`` also twice what its end cuts off: the mass is missing there, and found again
    in the norm of what is left.
    """
    reference = equation.reference
    nothing = Answer(reference.panels, lambda *H: 0.0 * sum(H), 0.0, 0)
    relative = reference.l1_error + ROUND_OFF
    found = {norm: relative * size for norm, size in errors(nothing, reference).items()}
    if given_mesh:
        ends = [x[-1] for x in equation.coarsest(1)]

        def inside(*H: Array) -> Array:
            keep = [x <= end for x, end in zip(H, ends, strict=True)]
            return np.where(reduce(np.logical_and, keep), reference.density(*H), 0.0)

        panels = tuple(
            np.unique(np.append(x, end)) for x, end in zip(reference.panels, ends, strict=True)
        )
        cut = errors(Answer(panels, inside, 0.0, 0), reference)
        found = {norm: floor + 2.0 * cut[norm] for norm, floor in found.items()}
    return found


def _judged(
    equation: Equation, family: Family, degree: int | None, levels: Sequence[Level]
) -> Ladder:
    floor = floors(equation, given_mesh=family != "tol")
    if family == "tol":  # the same answer twice, for two tolerances, is one level
        levels = [level for k, level in enumerate(levels) if k == 0 or _finer(levels, k)]
    sizes = [level.size for level in levels]
    verdicts = {}
    for key in (*NORMS, *FUNCTIONALS):
        verdicts[key] = convergence(
            sizes,
            [level.errors[key] for level in levels],
            theory=theoretical_order(key, degree) if degree else None,
            floor=floor[key],
        )
    grid = {}
    if degree:
        for key in FUNCTIONALS:
            values = [level.functionals[key] for level in levels]
            order = theoretical_order(key, degree)
            grid[key] = grid_convergence(sizes, values, theory=order, floor=floor[key])
    return Ladder(equation.name, equation.dimension, family, degree, tuple(levels), verdicts, grid)


def _finer(levels: Sequence[Level], k: int) -> bool:
    return levels[k].unknowns > max(level.unknowns for level in levels[:k])


def theoretical_order(key: str, degree: int) -> float:
    """Return p + 1 of the norms, 2 p of the moments (Galerkin duality), smoothness allowing it."""
    return float(degree + 1 if key in NORMS else 2 * degree)
