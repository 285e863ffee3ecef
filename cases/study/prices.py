"""Prices: for every route error against time, and from them the cheapest setting for an error.

The prices of the failure rate of a first passage are measured here: solvers answer to falling
tolerances and are compared with the best of them; a simulation is run once, and its error falls
with the root of the time.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isnan, nan
from typing import Any

import numpy as np

from cases.compare.routes import all_routes
from cases.scene.questions import PassageQuestion
from cases.study.levels import Level, T, time_call, timing
from fpk.answer.dynamics import Passage
from fpk.answer.method import Progress, silent
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.system import System
from sim.sample.settings import LEAST_PATHS

PRICED_DIGITS = tuple(range(1, 11))
"""Digits d of the errors 10^−d that are priced."""


@dataclass(frozen=True)
class Priced:
    """A route for one equation, timed at several settings, from coarse to fine.

    ``axis`` says which error the points have.
    """

    route: str
    equation: str
    axis: str
    points: tuple[Level, ...]

    def seconds_for(self, error: Array) -> Array:
        """Return the processor times for errors of any shape, NaN for an error not reached.

        They are interpolated log-log between the points that no other beats in time and error;
        an error above all points has the least time.
        """
        points = sorted(self.points, key=lambda p: (p.seconds, p.error))
        e = np.log([max(p.error, 1e-300) for p in points])
        best = e < np.append(inf, np.minimum.accumulate(e)[:-1])
        t = np.log([p.seconds for p in points])
        return np.exp(np.interp(np.log(error), e[best][::-1], t[best][::-1], left=nan))


@dataclass(frozen=True)
class NotTimed:
    """A route that is not timed: its answer disagrees with the reference, or there is none.

    ``distance`` to the reference and the largest ``allowed`` one are NaN without an answer. A
    ``baseline`` that disagrees is no failure of the study.
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
        """Whether an answer disagrees and the route is no baseline."""
        return not (isnan(self.distance) or self.baseline)


def price_route(
    route: str, equation: str, axis: str, points: Iterable[Level], reason: str
) -> Priced | NotTimed:
    """Return the priced route; not timed from its first measured point that is not sound.

    ``reason`` says why, unless the point states no finite error. Takes no further ``points``.
    """
    priced = []
    for p in points:
        if not (p.modelled or p.sound):
            if p.honest:
                reason = "states no finite error of its own: its density does not fall off"
            return NotTimed(route, equation, p.settings, p.distance, p.estimate, reason)
        priced.append(p)
    return Priced(route, equation, axis, tuple(priced))


def answers_by_tolerance(
    solve: Callable[[float], T], error_of: Callable[[T], float], tolerances: Iterable[float]
) -> list[tuple[Level, T]]:
    """Return the timed answers of ``solve`` to falling tolerances, the first not met the last.

    ``error_of`` returns the error that an answer states, of the same kind as the tolerances.
    """
    rows: list[tuple[Level, T]] = []
    for tol in tolerances:
        work = partial(solve, tol)
        answer, first = time_call(work)
        error = error_of(answer)
        level = Level(
            settings=f"tol = {tol:.0e}" + ", not met" * (not error <= tol),
            error=error,
            stated=error,
            promised=max(tol, error),
            **timing(work, first),
        )
        rows.append((level, answer))
        if not error <= tol:
            break
    return rows


def price_list(routes: Sequence[Priced], *, promised: bool = False) -> list[dict[str, Any]]:
    """Return the cheapest measured or modelled point of each equation for errors 10^−digits.

    Each row has ``equation``, ``digits``, ``route`` and ``point``, a ``Level``; an empty route and
    None for an error that no route reaches.

    ``promised``: among the points that were given a tolerance, by the tolerance instead of the
    error that the point happened to reach.
    """
    prices = []
    for equation, own in by_equation(routes).items():
        points = [(r.route, p, p.promised if promised else p.error) for r in own for p in r.points]
        for d in PRICED_DIGITS if min(error for *_, error in points) < inf else ():
            offers = [(route, p) for route, p, error in points if error <= 10.0**-d]
            route, point = min(offers, key=lambda o: o[1].seconds, default=("", None))
            prices.append({"equation": equation, "digits": d, "route": route, "point": point})
    return prices


def crossovers(routes: Sequence[Priced]) -> list[dict[str, Any]]:
    """Return where the cheapest route of each equation changes, from large errors to small.

    Each row has ``equation``, ``error`` and the routes: under ``error`` ``below`` is cheaper than
    ``above``, the cheapest until then. A change to or from no route at all has no row.
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
    """Return the routes by the name of their equation."""
    equations = dict.fromkeys(route.equation for route in routes)
    return {name: [route for route in routes if route.equation == name] for name in equations}


def passage_routes(
    system: System,
    question: PassageQuestion,
    *,
    simulate: bool,
    seed: int,
    progress: Progress = silent,
) -> list[Priced | NotTimed]:
    """Return the price of the failure rate by every route that gives it.

    The equations are the averaged equation of each theory and the equation of the full system.
    ``seed`` is for the simulations, which are left out unless ``simulate``.
    """
    routes: list[Priced | NotTimed] = []
    answers = []
    for route in all_routes():
        method: Any = route.make()
        if not hasattr(method, "passage") or (route.sampled and not simulate):
            continue
        whose = "full system (6)" if route.solves == "full" else f"{route.method} theory"
        equation = f"first passage of {question.name}, {whose}"
        try:
            if route.sampled:
                method = replace(method, paths=LEAST_PATHS, seed=seed, threads=1)
            ask = partial(_rate, method, system, question, progress)
            tolerances = (10.0**-d for d in PRICED_DIGITS[1::2])
            measured = (
                _price_sampling(ask)
                if route.sampled
                else answers_by_tolerance(ask, _relative, tolerances)
            )
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
        routes.append(price_route(route.label, equation, axis, points, words))
    return routes


def _rate(
    method: Any, system: System, question: PassageQuestion, progress: Progress, tol: float | None
) -> Number:
    """Return the failure rate to ``tol`` alone: no times of the reliability, which would cost more.

    Raises ``NotCertified`` for a simulation that is not certified, ``NotApplicable`` for no rate.
    """
    asked = system, question.limit, question.start, np.zeros(0)
    answer: Passage = method.passage(*asked, tol=tol, progress=progress)
    if method.route.sampled and not answer.certificate.certified:
        raise NotCertified("; ".join(answer.certificate.failures))
    if answer.rate is None or not answer.rate.value > 0.0:
        raise NotApplicable("the route gives no failure rate")
    return answer.rate


def _price_sampling(rate_at: Callable[[None], Number]) -> list[tuple[Level, Number]]:
    """Return the level of ``LEAST_PATHS``, and modelled levels of relative errors 0.1 to 1e-4.

    Error² falls as 1/time. Each is beside the same rate, ``rate_at(None)``.
    """
    rate, seconds = time_call(partial(rate_at, None))
    error = _relative(rate)
    levels = [Level(f"{LEAST_PATHS} paths", error, error, seconds)]
    for e in (10.0**-d for d in PRICED_DIGITS[:4]):
        more = (error / e) ** 2
        words = f"{LEAST_PATHS * more:.2g} paths"
        levels.append(Level(words, e, e, seconds * more, modelled=True, repeats=0))
    return [(level, rate) for level in levels]


def _relative(rate: Number) -> float:
    return rate.error / rate.value
