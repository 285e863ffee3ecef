"""Cost of a first passage: error of the failure rate against time, by every route.

Solvers answer to falling tolerances and are held against the best of them; a simulation is run
once and its error falls with the root of the time.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cases.comparison.routes import listed_routes
from cases.scene.questions import PassageQuestion
from cases.studies.levels import Level, timed_first, timing
from cases.studies.prices import NotTimed, Priced
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.evolution import Number, Passage, Passages
from fpk.method import Progress, silent
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
    results: list[Priced | NotTimed] = []
    best: dict[str, Number] = {}
    for route in listed_routes():
        method, equation = route.make(), equation_name(question, route.method, route.solves)
        if not isinstance(method, Passages) or (route.sampled and not simulate):
            continue
        try:
            if route.sampled:
                results.append(_sampled(method, system, question, equation, best, seed, progress))
            else:
                results.append(_solved(method, system, question, equation, best, progress))
        except (NotApplicable, NotCertified, InvalidInput) as reason:
            results.append(NotTimed(route.label, equation, reason=str(reason)))
    return results


def equation_name(question: PassageQuestion, method: str, solves: str) -> str:
    """Return the name of the equation whose first passage it is."""
    whose = "full system (6)" if solves == "full" else f"{method} theory"
    return f"first passage of {question.name}, {whose}"


def _passage(
    method: Any, system: System, question: PassageQuestion, tol: float | None, progress: Progress
) -> Passage:
    """First passage without the reliability: the failure rate is what is paid for."""
    asked = system, question.limit, question.start, np.zeros(0)
    answer: Passage = method.passage(*asked, tol=tol, progress=progress)
    return answer


def _rate(answer: Passage) -> Number:
    if answer.rate is None or not answer.rate.value > 0.0:
        raise NotApplicable("the route gives no failure rate")
    return answer.rate


def _solved(
    method: Any,
    system: System,
    question: PassageQuestion,
    equation: str,
    best: dict[str, Number],
    progress: Progress,
) -> Priced | NotTimed:
    """A solver at every tolerance; its finest answer is the reference where it is the first."""
    points, rates = [], []
    for tol in TOLERANCES:

        def work(tol: float = tol) -> Passage:
            return _passage(method, system, question, tol, progress)

        answer, first = timed_first(work)
        rates.append(_rate(answer))
        stated = rates[-1].error / rates[-1].value
        words = f"tol = {tol:.0e}"
        points.append(Level(words, stated, stated, promised=tol, **timing(work, first)))
    reference = min([*rates, *([best[equation]] if equation in best else [])], key=_relative)
    best[equation] = reference
    return _priced(method, equation, points, rates, reference)


def _sampled(
    method: Any,
    system: System,
    question: PassageQuestion,
    equation: str,
    best: dict[str, Number],
    seed: int,
    progress: Progress,
) -> Priced | NotTimed:
    """A simulation of ``PATHS``, and what others would cost: error² falls with the time."""
    few = replace(method, paths=PATHS, seed=seed, threads=1)
    answer, seconds = timed_first(lambda: _passage(few, system, question, None, progress))
    if not answer.certificate.certified:
        raise NotCertified("; ".join(answer.certificate.failures))
    rate = _rate(answer)
    error = _relative(rate)
    level = Level(f"{PATHS} paths", error, error, seconds)
    result = _priced(method, equation, [level], [rate], best.get(equation, rate))
    if isinstance(result, NotTimed):
        return result
    law = [
        Level(
            f"{PATHS * (error / e) ** 2:.2g} paths", e, e, seconds * (error / e) ** 2,
            modelled=True, repeats=0,
        )
        for e in ERRORS
    ]  # fmt: skip
    return replace(result, points=(*result.points, *law))


def _relative(rate: Number) -> float:
    return rate.error / rate.value


def _priced(
    method: Any, equation: str, points: Sequence[Level], rates: Sequence[Number], best: Number
) -> Priced | NotTimed:
    """The route, unless an answer is off by more than it, or four times it, and the best allow."""
    names, measured = (method.route.label, equation), []
    for level, rate in zip(points, rates, strict=True):
        sure = 4.0 if method.route.sampled else 1.0
        allowed = sure * rate.error + best.error
        distance, allowed = (x / best.value for x in (abs(rate.value - best.value), allowed))
        if not distance <= allowed:
            words = "differs from the best answer by more than both state"
            return NotTimed(*names, level.settings, distance, allowed, words)
        error = level.error if method.route.sampled else max(distance, best.error / best.value)
        measured.append(replace(level, error=error, distance=distance, estimate=allowed))
    kind = "sampling" if method.route.sampled else "numerical"
    return Priced(*names, f"{kind}: relative error of the failure rate", tuple(measured))
