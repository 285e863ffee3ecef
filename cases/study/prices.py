"""Prices: for every route error against time, and from them the cheapest setting for an error.

Those of the failure rate of a first passage are measured here: solvers answer to falling tolerances
and are held against the best of them; a simulation is run once and its error falls with the root of
the time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isnan, nan
from typing import Any

import numpy as np

from cases.compare.routes import listed_routes
from cases.scene.questions import PassageQuestion
from cases.study.levels import Level, timed_first, timing
from fpk.answer.dynamics import Passage
from fpk.answer.method import Progress, silent
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.system import System

DIGITS = tuple(range(1, 11))
"""Digits that are priced."""


@dataclass(frozen=True)
class Priced:
    """One route for one equation, timed at several settings, from coarse to fine.

    ``axis`` says which error it is.
    """

    route: str
    equation: str
    axis: str
    points: tuple[Level, ...]

    def seconds_for(self, error: Array) -> Array:
        """Return the times for errors of any shape, log-log between points that none beats in both.

        Not a number where an error was not reached.
        """
        points = sorted(self.points, key=lambda p: (p.seconds, p.error))
        e = np.log([max(p.error, 1e-300) for p in points])
        best = e < np.append(inf, np.minimum.accumulate(e)[:-1])
        t = np.log([p.seconds for p in points])
        return np.exp(np.interp(np.log(error), e[best][::-1], t[best][::-1], left=nan))


@dataclass(frozen=True)
class NotTimed:
    """A route that is not timed: its answer disagrees with the reference, or there is none.

    Of a ``baseline`` that is no failure of the study.
    """

    route: str
    equation: str
    settings: str = ""
    distance: float = nan
    allowed: float = nan
    reason: str = ""
    baseline: bool = False

    @property
    def wrong(self) -> bool:
        """Whether an answer disagrees: no answer, or a baseline's, says nothing against others."""
        return not (isnan(self.distance) or self.baseline)


def judged(
    route: str, equation: str, axis: str, points: Sequence[Level], reason: str
) -> Priced | NotTimed:
    """Return the route, not timed for this ``reason`` where a measured point is not honest."""
    for p in points:
        if not (p.modelled or p.honest):
            return NotTimed(route, equation, p.settings, p.distance, p.estimate, reason)
    return Priced(route, equation, axis, tuple(points))


@dataclass(frozen=True)
class Cheapest:
    """For an error 10^−digits the cheapest route and its point, None where none reaches it."""

    equation: str
    digits: int
    route: str
    point: Level | None


def price_list(routes: Sequence[Priced], *, promised: bool = False) -> tuple[Cheapest, ...]:
    """Return the cheapest measured or modelled point of each equation for errors 10^−digits.

    ``promised``: of the points that were given a tolerance, the cheapest by that, not by the error
    that it happened to reach.
    """
    prices = []
    for equation, own in by_equation(routes).items():
        points = [(r.route, p, p.promised if promised else p.error) for r in own for p in r.points]
        for d in DIGITS if min(error for *_, error in points) < inf else ():
            offers = [(route, p) for route, p, error in points if error <= 10.0**-d]
            route, point = min(offers, key=lambda o: o[1].seconds, default=("", None))
            prices.append(Cheapest(equation, d, route, point))
    return tuple(prices)


def crossovers(routes: Sequence[Priced]) -> list[dict[str, Any]]:
    """Return where the cheapest route of each equation changes, from large errors to small.

    Below ``error`` the route ``below`` is cheaper than ``above``, which was until then.
    """
    crossings = []
    errors = np.geomspace(0.3, 1e-13, 1001)
    for equation, own in by_equation(routes).items():
        times = np.nan_to_num([r.seconds_for(errors) for r in own], nan=inf)
        winner = np.where(np.isfinite(times).any(axis=0), times.argmin(axis=0), -1)
        for k in np.flatnonzero(np.diff(winner)) + 1:
            a, b = winner[k - 1], winner[k]
            if min(a, b) >= 0:
                names = {"above": own[a].route, "below": own[b].route}
                crossings.append({"equation": equation, "error": float(errors[k]), **names})
    return crossings


def by_equation(routes: Sequence[Priced]) -> dict[str, list[Priced]]:
    """Return the routes of every equation."""
    equations = dict.fromkeys(route.equation for route in routes)
    return {name: [route for route in routes if route.equation == name] for name in equations}


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
        if not hasattr(method, "passage") or (route.sampled and not simulate):
            continue
        whose = "full system (6)" if route.solves == "full" else f"{route.method} theory"
        equation = f"first passage of {question.name}, {whose}"
        try:
            if route.sampled:
                few = {"paths": PATHS, "seed": seed, "threads": 1}
                method = replace(method, **few)
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
