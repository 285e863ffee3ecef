"""Prices: for every route error against time, and from them the cheapest setting for an error."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan, nan
from typing import Any

import numpy as np

from cases.studies.levels import Level
from fpk.arrays import Array

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
