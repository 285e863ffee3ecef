"""Cost of a first passage: error of the failure rate against time, by every route.

Solvers answer to falling tolerances and are held against the best of them; a simulation is run
once and its error falls with the root of the time.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from cases.comparison.routes import listed_routes
from cases.scene.questions import PassageQuestion
from cases.studies.levels import Level, timed_first, timing
from cases.studies.prices import NotTimed, Priced, judged
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.evolution import Passage, Passages
from fpk.method import Progress, silent
from fpk.number import Number
from fpk.system import System

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
"""Relative errors that a solver is asked for."""

ERRORS = (0.1, 1e-2, 1e-3, 1e-4)
"""Errors of a simulation for which a price is given by its law."""

PATHS = 4096
"""Paths of the simulation that is run."""


def passage_routes(
    system: System,
    question: PassageQuestion,
    *,
    simulate: bool,
    seed: int,
    progress: Progress = silent,
) -> list[Priced | NotTimed]:
    """Return the price of the failure rate by every route that gives it.

    The equations are the averaged one of each theory, and that of the full system.
    """
    routes: list[Priced | NotTimed] = []
    answers = []
    for route in listed_routes():
        method: Any = route.make()
        if not isinstance(method, Passages) or (route.sampled and not simulate):
            continue
        whose = "full system (6)" if route.solves == "full" else f"{route.method} theory"
        equation = f"first passage of {question.name}, {whose}"
        try:
            if route.sampled:
                few = {"paths": PATHS, "seed": seed, "threads": 1}
                method = replace(method, **few)  # type: ignore[type-var]
            ask = partial(_rate, method, system, question, progress)
            measured = _sampled(ask) if route.sampled else _solved(ask)
        except (NotApplicable, NotCertified, InvalidInput) as reason:
            routes.append(NotTimed(route.label, equation, reason=str(reason)))
        else:
            answers.append((route, equation, measured))
    best: dict[str, Number] = {}
    for _, equation, measured in answers:
        for _, rate in measured:
            best[equation] = min(best.get(equation, rate), rate, key=_relative)
    for route, equation, measured in answers:
        # An answer may be off by what it states, four times that where it is sampled, and the best.
        finest, sure, points = best[equation], 4.0 if route.sampled else 1.0, []
        for level, rate in measured:
            distance = abs(rate.value - finest.value) / finest.value
            if not route.sampled:
                level = replace(level, error=max(distance, _relative(finest)))
            if not level.modelled:
                allowed = (sure * rate.error + finest.error) / finest.value
                level = replace(level, distance=distance, estimate=allowed)
            points.append(level)
        kind = "sampling" if route.sampled else "numerical"
        axis = f"{kind}: relative error of the failure rate"
        words = "differs from the best answer by more than both state"
        routes.append(judged(route.label, equation, axis, points, words))
    return routes


def _rate(
    method: Any, system: System, question: PassageQuestion, progress: Progress, tol: float | None
) -> Number:
    """The failure rate alone: the reliability is not asked for, so that it costs nothing."""
    asked = system, question.limit, question.start, np.zeros(0)
    answer: Passage = method.passage(*asked, tol=tol, progress=progress)
    if method.route.sampled and not answer.certificate.certified:
        raise NotCertified("; ".join(answer.certificate.failures))
    if answer.rate is None or not answer.rate.value > 0.0:
        raise NotApplicable("the route gives no failure rate")
    return answer.rate


def _solved(rate_at: Callable[[float], Number]) -> list[tuple[Level, Number]]:
    """The rate at every tolerance and its price."""
    rows = []
    for tol in TOLERANCES:
        work = partial(rate_at, tol)
        rate, first = timed_first(work)
        stated = _relative(rate)
        words = f"tol = {tol:.0e}"
        rows.append((Level(words, stated, stated, promised=tol, **timing(work, first)), rate))
    return rows


def _sampled(rate_at: Callable[[None], Number]) -> list[tuple[Level, Number]]:
    """The rate by ``PATHS``, and the price of other errors: error² falls with the time."""
    rate, seconds = timed_first(partial(rate_at, None))
    error = _relative(rate)
    levels = [Level(f"{PATHS} paths", error, error, seconds)]
    for e in ERRORS:
        more = (error / e) ** 2
        words = f"{PATHS * more:.2g} paths"
        levels.append(Level(words, e, e, seconds * more, modelled=True, repeats=0))
    return [(level, rate) for level in levels]


def _relative(rate: Number) -> float:
    return rate.error / rate.value
