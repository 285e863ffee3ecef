"""The full system (6) solved without sampling, at falling tolerances: priced, and the reference."""

from dataclasses import replace
from functools import partial

from cases.comparison.compare import distance_between
from cases.comparison.routes import listed_routes
from cases.studies.levels import Level, timed_first, timing
from cases.studies.prices import NotTimed, Priced, judged
from cases.studies.simulation import Reference, observed
from fpk.density import Density
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Method, Progress, silent
from fpk.observable import observable_name
from fpk.system import System

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
"""L1 errors that are asked for, until one is out of reach of the work that ``fpk run`` allows."""


def solved_routes(
    system: System, equation: str, *, progress: Progress = silent
) -> tuple[list[Priced | NotTimed], Reference | None]:
    """Return the slow routes that solve (6), and the density with the least error of all of them.

    The errors are those that the answers state. An answer that differs from the best one by more
    than both state is not timed, nor is a route that ``fpk run`` leaves out.
    """
    results: list[Priced | NotTimed] = []
    best: Reference | None = None
    for route in listed_routes():
        if route.solves != "full" or route.sampled or route.quick:
            continue
        try:
            answers = _answers(route.make().unasked(system), system, progress)
        except (NotApplicable, NotCertified) as reason:
            results.append(NotTimed(route.label, equation, reason=str(reason)))
            continue
        finest = min((p for _, p in answers), key=lambda p: p.l1_error)
        if best is None or finest.l1_error < best.density.l1_error:
            best = Reference(route.label, finest, finest)
        points = []
        for level, p in answers:
            distance, allowed, _ = distance_between(p, finest)
            points.append(replace(level, distance=distance, estimate=allowed))
        axis = f"numerical, as stated: L1 of p({observable_name(observed(system))})"
        words = "differs from its own finest answer by more than both state"
        results.append(judged(route.label, equation, axis, points, words))
    return results, best


def _answers(method: Method, system: System, progress: Progress) -> list[tuple[Level, Density]]:
    """The answer to each tolerance and its price; the last one met, or as near as work allows."""
    answers: list[tuple[Level, Density]] = []
    for tol in TOLERANCES:
        asked: Method = replace(method, tol=tol)  # type: ignore[type-var]
        work = partial(asked.solve, system, [observed(system)], progress=progress)
        result, first = timed_first(work)
        (p,) = result.densities
        assert isinstance(p, Density)
        met = p.l1_error <= tol
        level = Level(
            settings=f"tol = {tol:.0e}" if met else f"tol = {tol:.0e}, not met",
            error=p.l1_error,
            stated=p.l1_error,
            promised=tol if met else p.l1_error,
            **timing(work, first),
        )
        answers.append((level, p))
        if not met:
            break
    return answers
