"""The work-precision study of a scene: what each digit costs, by every route."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from cases.compare.compare import distance_between
from cases.scene.scene import Scene
from cases.study.converge import H_LEVELS
from cases.study.equations import EQUATIONS, Equation
from cases.study.law import FULL, Law, averaged_route, full_routes, solved_routes
from cases.study.levels import Discretisation, refined_levels, timed_first, timing
from cases.study.prices import NotTimed, Priced, crossovers, passage_routes, price_list
from cases.study.simulation import Reference, deterministic, full_reference
from fpk.answer.method import Progress, silent
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.system import System

DEGREES = (1, 2, 4, 8)
"""Degrees of the elements that are timed."""
TOLERANCES, STRIDE = 6, 2
"""Tolerances that are timed, from 1e-2 on, and digits from one to the next."""
JUDGE = 5e-4
"""L1 error up to which a solution of (6) is its reference: that of a long simulation."""
LONGEST = 0.4
"""Seconds of one solve beyond which a route is not refined further: the next takes up to ten times
as long in two dimensions."""


@dataclass(frozen=True)
class Model:
    """An averaged theory as an answer to the full system: averaging error, never numerical.

    ``distance`` is L1 of p(q_i) to the full system, known to ``error``.
    """

    theory: str
    observable: str
    distance: float
    error: float
    seconds: float


@dataclass
class CostStudy:
    """Priced routes, those not timed and why, laws of sampling, and averaging errors.

    ``floors`` are the errors of the references by equation; ``full_reference`` says what the full
    system is held against.
    """

    scene: Scene
    routes: list[Priced] = field(default_factory=list)
    not_timed: list[NotTimed] = field(default_factory=list)
    laws: list[Law] = field(default_factory=list)
    models: list[Model] = field(default_factory=list)
    floors: dict[str, float] = field(default_factory=dict)
    full_reference: str = "not simulated"
    seconds: float = 0.0

    @property
    def problems(self) -> tuple[str, ...]:
        """Routes whose answer disagrees with the reference."""
        return tuple(
            f"{n.route} of {n.equation} ({n.settings}) is not timed: it differs by"
            f" L1 = {n.distance:.3g}, stated is {n.allowed:.3g}"
            for n in self.not_timed
            if n.wrong
        )

    def record(self) -> dict[str, Any]:
        """Return the study as ``plain`` takes it, with the cheapest settings and crossings."""
        return {
            **vars(self),
            "scene": self.scene.name,
            "crossings": crossovers(self.routes),
            "prices": price_list(self.routes),
            "promises": price_list(self.routes, promised=True),
            "problems": self.problems,
        }


def study_cost(
    scene: Scene, *, simulate: bool = True, seed: int = 1, progress: Progress = silent
) -> CostStudy:
    """Check and time every route of ``scene``, the sampling routes where ``simulate``.

    Of its first [[passage]] the failure rate is priced, too.
    """
    start, system, study = perf_counter(), scene.system, CostStudy(scene)
    tried: list[Priced | NotTimed] = []
    for name, _, make in EQUATIONS.values():
        with _refusal_in(tried, name):
            equation = make(system)
            study.floors[name] = equation.reference.l1_error
            tried += equation_routes(equation, candidates(equation), progress=progress)
            if simulate and equation.dimension == 1:
                tried.append(averaged_route(system, equation, seed=seed))
    solved, best = solved_routes(system, progress=progress)
    tried += solved
    if best is not None:
        study.full_reference, study.floors[FULL] = best.words, best.density.l1_error
    if simulate:
        with _refusal_in(tried, FULL):
            known = best if best and best.density.l1_error <= JUDGE else None
            reference = known or full_reference(system, seed=seed)
            study.full_reference, study.floors[FULL] = reference.words, reference.density.l1_error
            results, study.laws = full_routes(
                system, reference, seed=seed, unit=scene.units.time, progress=progress
            )
            tried += results
            study.models += _models(system, reference)
    for question in scene.passages[:1]:
        tried += passage_routes(system, question, simulate=simulate, seed=seed, progress=progress)
    study.routes = [r for r in tried if isinstance(r, Priced)]
    study.not_timed = [r for r in tried if isinstance(r, NotTimed)]
    study.seconds = perf_counter() - start
    return study


@contextmanager
def _refusal_in(tried: list[Priced | NotTimed], equation: str) -> Iterator[None]:
    try:
        yield
    except (NotApplicable, NotCertified) as reason:
        tried.append(NotTimed("all", equation, reason=str(reason)))


def candidates(equation: Equation) -> tuple[Discretisation, ...]:
    """Return the coarsest of every route: elements in h, and the routes by tolerance."""
    routes = [equation.to_tolerance(route, STRIDE, STRIDE) for route in equation.by_tolerance]
    return *(equation.elements(degree) for degree in DEGREES), *routes


def equation_routes(
    equation: Equation, offered: Sequence[Discretisation], *, progress: Progress = silent
) -> list[Priced | NotTimed]:
    """Check every level of every route against the reference and time it.

    A route with one answer that disagrees, or with none at all, is named and not timed.
    """
    results = []
    for k, first in enumerate(offered, start=1):
        results.append(_priced(equation, first))
        progress(k, len(offered), f"cost of {equation.name}")
    return results


def _priced(equation: Equation, first: Discretisation) -> Priced | NotTimed:
    names, points = (first.name, equation.name), []
    count = TOLERANCES if first.family == "tol" else H_LEVELS[equation.dimension]
    try:
        _, compiling = timed_first(first.solve)  # the levels themselves are timed warm
        for setting, level in refined_levels(first, equation.reference, count):
            if not (level.honest and np.isfinite(level.stated)):
                words = f"differs from the {equation.reference_words} by more than both state"
                if level.honest:
                    words = "states no finite error of its own: its density does not fall off"
                return NotTimed(*names, level.settings, level.distance, level.estimate, words)
            timed = timing(setting.solve, level.seconds, equation.clock)
            points.append(replace(level, **timed))
            if level.seconds > LONGEST:
                break
    except (NotCertified, NotApplicable, InvalidInput, np.linalg.LinAlgError) as error:
        return NotTimed(*names, reason=str(error))
    points[0] = replace(points[0], first=max(0.0, compiling - points[0].seconds))
    axis = f"numerical: L1 of p({equation.reference.name}), {equation.name}"
    return Priced(*names, axis, tuple(points))


def _models(system: System, reference: Reference) -> list[Model]:
    """Averaging error of each theory in p(q_i), and the time of its fastest route."""
    models: dict[str, Model] = {}
    of = reference.density.observable
    for method in deterministic("averaged"):
        if method.refusal(system, of) is None:
            work = partial(method.solve, system, [of])
            result, first = timed_first(work)
            distance, error, _ = distance_between(result.densities[0], reference.given)
            theory, seconds = method.route.method, timing(work, first)["seconds"]
            model = Model(theory, reference.density.name, distance, error, seconds)
            models[theory] = min(model, models.get(theory, model), key=lambda m: m.seconds)
    return list(models.values())
