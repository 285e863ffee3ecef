"""The convergence study of a scene: every averaged equation, and the simulation.

An averaged equation is studied in h and p on given meshes and by tolerance, each a ``Ladder``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from time import perf_counter
from typing import Any

import numpy as np

from cases.scene.errors import BadInput
from cases.scene.scene import Scene
from cases.study.equations import EQUATIONS, P_DEGREES, Equation
from cases.study.levels import FUNCTIONALS, NORMS, Discretisation, Level, errors, refined_levels
from cases.study.orders import (
    LIMITS,
    Convergence,
    GridConvergence,
    convergence,
    grid_convergence,
)
from cases.study.weak import SampleSlope, WeakOrder, sample_slope, weak_order
from fpk.answer.method import Progress, silent
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable, NotCertified
from sim.montecarlo import MonteCarlo

H_DEGREES = {1: (1, 2, 4), 2: (1, 2, 3)}
"""Degrees in h, by the number of energies."""
H_LEVELS = {1: 7, 2: 5}
"""Meshes, each the bisection of the one before, by the number of energies."""
DIGITS = 12
"""Tolerances are 1e-1 to 1e-12."""
ROUND_OFF = 4e-15
"""Relative floor of any answer, some twenty roundings of its largest values: sums in another order,
as another processor takes them, differ by half of it."""
SIMULATION = MonteCarlo().route.method
SCHEMES_STUDIED = ("exact_flow", "baoab", "euler_maruyama")
SECONDS = 10.0
"""Processor time that the steps of one scheme may take where the resolution wanted needs more."""


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


@dataclass
class ConvergenceStudy:
    """All that was measured for a scene; ``refusals`` are routes that do not apply, with reason.

    ``equations`` describe the averaged equations, each with its ``ladders``; the last of (24) is
    that in p of the same system without contacts, which shows whether the kink at the contact
    energy costs the exponential convergence.
    """

    scene: Scene
    equations: list[dict[str, Any]] = field(default_factory=list)
    schemes: list[WeakOrder] = field(default_factory=list)
    samples: SampleSlope | None = None
    refusals: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def ladders(self) -> list[Ladder]:
        """Every ladder."""
        return [ladder for e in self.equations for ladder in e["ladders"]]

    @property
    def problems(self) -> tuple[str, ...]:
        """Every estimate that is below the true error, in words."""
        return tuple(
            f"{ladder.equation}, {ladder.name}, {level.settings}: the estimate {level.estimate:.2g}"
            f" is below the true L1 error {level.error:.2g}"
            for ladder in self.ladders
            for level in ladder.levels
            if not level.honest
        )

    def record(self) -> dict[str, Any]:
        """Return the study as ``plain`` takes it."""
        return {**vars(self), "scene": self.scene.name, "limits_of_the_index": LIMITS}


def chosen_routes(route: str | None, of: str | None) -> tuple[str, ...]:
    """Return the routes asked for by name, by observable or by both; ``BadInput`` for none."""
    known = {name: observable for name, (_, observable, _) in EQUATIONS.items()}
    known |= {SIMULATION: ""}
    chosen = tuple(n for n, o in known.items() if route in (None, n) and of in (None, o))
    if not chosen:
        asked = " ".join(f"--{k} {v}" for k, v in (("route", route), ("of", of)) if v is not None)
        raise BadInput(
            f"{asked}: use --route {', '.join(known)}, or --of H for (24), H1,H2 for (17)"
        )
    return chosen


def study_convergence(
    scene: Scene,
    routes: Sequence[str],
    *,
    seconds: float = SECONDS,
    seed: int = 1,
    threads: int | None = None,
    solver: str = "fem",
    progress: Progress = silent,
) -> ConvergenceStudy:
    """Measure how the errors of ``routes`` fall; ``seconds`` is for the steps of each scheme.

    Elements on given meshes and by tolerance are those of ``solver``, "fem" or "scikit-fem".
    Of several routes those that do not apply are named with the reason; one alone raises
    ``NotApplicable`` or ``NotCertified``.
    """
    start, system, study = perf_counter(), scene.system, ConvergenceStudy(scene)
    for route in routes:
        try:
            if route == SIMULATION:
                method = MonteCarlo(seed=seed, threads=threads)
                for scheme in SCHEMES_STUDIED:
                    own = replace(method, scheme=scheme)
                    study.schemes.append(weak_order(system, own, seconds=seconds))
                    progress(len(study.schemes), len(SCHEMES_STUDIED), f"steps of {scheme}")
                study.samples = sample_slope(system, method)
                continue
            *_, make = EQUATIONS[route]
            equation = make(system, solver)
            measured = list(ladders(equation, progress=progress))
            if equation.dimension == 1 and system.contacts:
                try:
                    free = make(replace(system, contacts=()), solver)
                    free = replace(free, name=f"{free.name} without contact")
                    measured.append(measured_ladder(free, free.degrees()))
                except (NotApplicable, NotCertified) as reason:  # stops may be what makes it stable
                    study.refusals[f"{route} without contact"] = str(reason)
            study.equations.append(
                {
                    "theory": route,
                    "equation": equation.name,
                    "observable": equation.reference.name,
                    "dimension": equation.dimension,
                    "reference": equation.reference_words,
                    "reference_error": equation.reference.l1_error,
                    "by_tolerance": equation.words,
                    "ladders": measured,
                }
            )
        except (NotApplicable, NotCertified) as reason:
            if len(routes) == 1:  # it was asked for, and there is nothing else to show
                raise
            study.refusals[route] = str(reason)
    study.seconds = perf_counter() - start
    return study


def ladders(equation: Equation, *, progress: Progress = silent) -> tuple[Ladder, ...]:
    """Return the h-ladders, a p-ladder, and one by tolerance of the route by elements."""
    route, results = next(iter(equation.by_tolerance)), []
    by_degree = map(equation.elements, H_DEGREES[equation.dimension])
    families = [*by_degree, equation.degrees(), equation.to_tolerance(route)]
    for k, first in enumerate(families, start=1):
        results.append(measured_ladder(equation, first))
        progress(k, len(families), f"convergence of {equation.name}")
    return tuple(results)


def measured_ladder(equation: Equation, first: Discretisation) -> Ladder:
    """Return the levels from ``first`` on, with their observed orders."""
    count = {"h": H_LEVELS[equation.dimension], "p": len(P_DEGREES), "tol": DIGITS}[first.family]
    levels = [v for _, v in refined_levels(first, equation.reference, count)]
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
            [v.functionals[key] for v in levels], theory=theory[key], floor=floor[key]
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
    relative, sizes = p.l1_error + ROUND_OFF, errors(p)
    if not given_mesh:
        return {key: relative * size for key, size in sizes.items()}

    def beyond(*H: Array) -> Array:
        return np.where(reduce(np.logical_or, map(np.greater, H, ends)), p(*H), 0.0)

    cut = errors(replace(p, panels=tuple(map(np.union1d, p.panels, ends)), pdf=beyond))
    return {key: (relative + 2.0 * cut["L1"]) * size + cut[key] for key, size in sizes.items()}
