"""The work-precision study of a scene: what each digit costs, by every route."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from cases.compare.compare import distance_between
from cases.scene.scene import Scene
from cases.scene.written import duration
from cases.show.pictures.panel import Curve, Panel
from cases.show.study_page import Page, Table
from cases.show.words import theory_of_route
from cases.study.equations import ELEMENTS, EQUATIONS, TOLERANCE_DIGITS, Equation
from cases.study.law import FULL, Law, price_averaged_simulation, price_schemes, price_solutions
from cases.study.levels import Discretisation, Level, time_call, timing
from cases.study.prices import (
    NotTimed,
    Priced,
    by_equation,
    crossovers,
    passage_routes,
    price_list,
    price_route,
)
from cases.study.simulation import Reference, deterministic, full_reference
from fpk.answer.method import Progress, silent
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.system import System

STRIDE = 2
"""Digits from one timed tolerance to the next."""
JUDGE = 5e-4
"""Largest L1 error of a solution of (6) that serves as reference, about a long simulation's."""
SLOW_SOLVE = 0.4
"""Seconds of one solve beyond which a route is not refined further: the next takes up to ten times
as long in two dimensions."""
COLUMNS = {
    "error": "L1 error",
    "spread": "quartiles ±",
    "first": "first call more",
    "step": "seconds a step",
}
"""Names of columns of tables by the fields of ``Level`` and ``Law``, where these differ."""
DRAWN_ERROR, DRAWN_SECONDS = 1e-4, 3600.0
"""Error and seconds to which the law of sampling is drawn: an hour."""
MEANING = (
    "Processor times on one thread after a warm-up, the median of 3 to 21 runs where one takes"
    " less than a second; simulations are run once. What a process remembers (integrals of two or"
    " more contact masses, of damping that depends on the state) is in the first call only. Every"
    " error is that of the route's own equation: numerical for the averaged equations and for the"
    " full system where it is solved, sampling and step where it is simulated."
)


@dataclass(frozen=True)
class Model:
    """An averaged theory as an answer to the full system: averaging error, never numerical.

    ``distance`` is the L1 distance of p(q_i) to the full system, known to ``error``; ``seconds``
    the processor time of the theory's fastest route.
    """

    theory: str
    observable: str
    distance: float
    error: float
    seconds: float


@dataclass
class CostStudy:
    """Priced routes, routes not timed with the reason, laws of sampling, and averaging errors.

    ``floors`` are the errors of the references by equation; ``full_reference`` names the reference
    of the full system.
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
        """In words the routes, except baselines, whose answer disagrees with the reference."""
        return tuple(
            f"{n.route} of {n.equation} ({n.settings}) is not timed: it differs by"
            f" L1 = {n.distance:.3g}, stated is {n.allowed:.3g}"
            for n in self.not_timed
            if n.wrong
        )

    def record(self) -> dict[str, Any]:
        """Return fields, "crossings", "prices", "promises", "problems" for JSON by ``plain``."""
        return {
            **vars(self),
            "scene": self.scene.name,
            "crossings": crossovers(self.routes),
            "prices": price_list(self.routes),
            "promises": price_list(self.routes, promised=True),
            "problems": self.problems,
        }

    def page(self) -> Page:
        """Return what ``fpk cost`` shows and writes."""
        errors, times = ("error", "stated", "unknowns"), ("seconds", "spread", "first")
        columns = "settings", *errors, *times, "coefficients", "memory"
        measured = [
            {"equation": route.equation, "route": route.route}
            | {COLUMNS.get(key, key): getattr(point, key) for key in columns}
            for route in self.routes
            for point in route.points
            if not point.modelled
        ]
        models = []
        for m in self.models:  # beside each the fastest simulation to its error, if one reaches it
            error = np.array(max(m.distance, m.error))
            seconds = [r.seconds_for(error) for r in self.routes if r.equation == FULL]
            fastest = float(np.fmin.reduce(seconds, initial=np.nan))
            models.append({**asdict(m), "simulation to this": fastest})
        averaging = (
            f"Averaging error: L1 to the full system ({self.full_reference}); no solver lowers it."
        )
        axes = tuple(dict.fromkeys(f"{r.equation}: {r.axis}" for r in self.routes))
        lost = [{k: v for k, v in asdict(n).items() if k != "baseline"} for n in self.not_timed]
        prices = [_price(c) for c in price_list(self.routes)]
        promised = [_price(c) for c in price_list(self.routes, promised=True) if c["point"]]
        promise = (
            "Numbers of elements above are right for this scene. A tolerance is met on every scene,"
            " or the answer is not certified: --tol of fpk run and fpk density is this setting."
        )
        laws = [{COLUMNS.get(k, k): v for k, v in asdict(law).items()} for law in self.laws]
        law = (
            "L1 = noise/√(paths x time) + bias dt^order, the bias an upper bound where it is not"
            " resolved; (dt, N) is the cheapest path under it, one thread."
        )
        units, time = self.scene.units, self.scene.units.time
        law += f" The bias is in {time}^(-order)." if time else ""
        of_laws = {"noise": units.of((0, 0, 0.5)), "largest": time, "relaxation": time}
        tables = [
            Table("prices", "To get so many digits (L1)", prices),
            Table("promises", "Settings that hold for other scenes", promised, (promise,)),
            Table("crossings", "Where another route becomes the cheapest", crossovers(self.routes)),
            Table(
                "models", "What the theories are worth for the full system", models, (averaging,)
            ),
            Table("not_timed", "Routes that are not timed", lost),
            Table("laws", f"{FULL}: law of sampling", laws, (law,), of_laws),
            Table("measurements", "Measurements", measured, (*axes, MEANING)),
        ]
        title = f"What accuracy costs: {self.scene.title}"
        return Page("cost", self.scene, title, tables, _cost_panels(self))


def study_cost(
    scene: Scene, *, simulate: bool = True, seed: int = 1, progress: Progress = silent
) -> CostStudy:
    """Check and time every route of ``scene``, the sampling routes only if ``simulate``.

    The failure rate of its first [[passage]] is priced, too. ``seed`` is for the simulations.
    """
    start, system, study = perf_counter(), scene.system, CostStudy(scene)
    tried: list[Priced | NotTimed] = []
    for name, _, make in EQUATIONS.values():
        with _refusal_in(tried, name):
            equation = make(system)
            study.floors[name] = equation.reference.l1_error
            tried += equation_routes(equation, coarsest_routes(equation), progress=progress)
            if simulate and equation.dimension == 1:
                tried.append(price_averaged_simulation(system, equation, seed=seed))
    solved, best = price_solutions(system, progress=progress)
    tried += solved
    if best is not None:
        study.full_reference, study.floors[FULL] = best.words, best.density.l1_error
    if simulate:
        with _refusal_in(tried, FULL):
            known = best if best and best.density.l1_error <= JUDGE else None
            reference = known or full_reference(system, seed=seed)
            study.full_reference, study.floors[FULL] = reference.words, reference.density.l1_error
            results, study.laws = price_schemes(
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


def coarsest_routes(equation: Equation) -> tuple[Discretisation, ...]:
    """Return the coarsest level of every route: elements in h, and the routes by tolerance."""
    routes = [equation.to_tolerance(route, STRIDE, STRIDE) for route in equation.by_tolerance]
    return *(equation.elements(degree) for degree in ELEMENTS[1]), *routes


def equation_routes(
    equation: Equation, offered: Iterable[Discretisation], *, progress: Progress = silent
) -> list[Priced | NotTimed]:
    """Return the price of each route, ``offered`` by its coarsest level, refined and timed.

    Every level is compared with the reference of ``equation``. A route with an answer that
    disagrees, or without any, is returned as not timed.
    """
    results, offered = list[Priced | NotTimed](), list(offered)
    axis = f"numerical: L1 of p({equation.reference.name}), {equation.name}"
    words = f"differs from the {equation.reference_words} by more than both state"
    for k, first in enumerate(offered, start=1):
        names = first.name, equation.name
        try:
            results.append(price_route(*names, axis, _time_levels(equation, first), words))
        except (NotCertified, NotApplicable, InvalidInput, np.linalg.LinAlgError) as error:
            results.append(NotTimed(*names, reason=str(error)))
        progress(k, len(offered), f"cost of {equation.name}")
    return results


def _time_levels(equation: Equation, first: Discretisation) -> Iterator[Level]:
    """Yield the levels of a route with their times, at most those of ``Equation.study``.

    The last is the first whose solution takes more than ``SLOW_SOLVE`` of processor time. Levels
    that are not ``sound`` have the time of their one solution. Raises as ``Study.levels``.
    """
    _, compiling = time_call(first.solve)  # the levels themselves are timed warm
    for setting, level in equation.study(first, TOLERANCE_DIGITS // STRIDE).levels():
        timed = timing(setting.solve, level.seconds, equation.clock) if level.sound else {}
        if timed and setting is first:
            timed["first"] = max(0.0, compiling - timed["seconds"])
        yield replace(level, **timed)
        if level.seconds > SLOW_SOLVE:
            break


def _models(system: System, reference: Reference) -> list[Model]:
    """Return for each theory the averaging error in p(q_i), and the time, of its fastest route."""
    models: dict[str, Model] = {}
    of = reference.density.observable
    for method in deterministic("averaged"):
        if method.refusal(system, of) is None:
            work = partial(method.solve, system, [of])
            result, first = time_call(work)
            distance, error, _ = distance_between(result.densities[0], reference.given)
            theory, seconds = method.route.method, timing(work, first)["seconds"]
            model = Model(theory, reference.density.name, distance, error, seconds)
            models[theory] = min(model, models.get(theory, model), key=lambda m: m.seconds)
    return list(models.values())


def _price(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row of ``price_list`` as the table shows it, its point spread over columns."""
    point = row["point"]
    return {
        **{key: row[key] for key in ("equation", "digits")},
        "route": row["route"] or "reached by none here",
        **{key: getattr(point, key, None) for key in ("settings", "seconds", "memory")},
        "priced by": point and ("law of sampling" if point.modelled else "measurement"),
    }


def _point_note(point: Level) -> str:
    """Return the setting of a point, and how well its error and time are known."""
    if point.modelled:
        return f"{point.settings}, by the law of sampling"
    spread = f", time ± {duration(point.spread)}" if point.spread > 0.0 else ""
    return f"{point.settings}, states {point.stated:.1e}{spread}"


def _cost_panels(study: CostStudy) -> list[Panel]:
    """Return a panel for each equation: error against time of every route.

    Open markers and dotted lines are prices by the law of sampling; dashed levels are the averaging
    error, which no solver lowers.
    """
    panels = []
    models = [(m.distance, f"error of {theory_of_route(m.theory)}") for m in study.models]
    for equation, routes in by_equation(study.routes).items():
        curves = []
        for route in routes:
            drawn = [
                p
                for p in sorted(route.points, key=lambda p: -p.error)
                if p.error >= (0.99 * DRAWN_ERROR if p.modelled else 1e-300)
                and not (p.modelled and p.seconds > DRAWN_SECONDS)
            ]
            if drawn:
                style = ":" if drawn[-1].modelled else "-"
                times, errors = [p.seconds for p in drawn], [p.error for p in drawn]
                curves.append(
                    Curve(
                        route.route, times, errors, style=style, notes=list(map(_point_note, drawn))
                    )
                )
        x, floor = "processor time in seconds, one thread", study.floors.get(equation, 0.0)
        lowest = 0.4 * min([DRAWN_ERROR, *(min(curve.y) for curve in curves)])
        marks, limits = (models, (lowest, 1.0)) if equation == FULL else ((), (2e-16, 2.0))
        y = "L₁ error" if equation in study.floors else "relative error"
        panel = Panel(equation, x, y, curves, max(floor, 2e-15), marks, limits=limits)
        panels.append(panel)
    return panels
