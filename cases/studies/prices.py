"""Prices: for every route error against time, and from them the cheapest setting for an error."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from typing import Any

import numpy as np

from cases.studies.levels import Level


@dataclass(frozen=True)
class Priced:
    """One route for one equation, timed at several settings, from coarse to fine.

    ``axis`` says which error it is; ``sampled`` that it is one of sampling.
    """

    route: str
    equation: str
    axis: str
    points: tuple[Level, ...]
    sampled: bool = False

    def frontier(self) -> list[Level]:
        """Return the points that no other of the route beats in both error and time."""
        best: list[Level] = []
        for point in sorted(self.points, key=lambda p: (p.seconds, p.error)):
            if not best or point.error < best[-1].error:
                best.append(point)
        return best

    def seconds_for(self, error: float) -> float:
        """Return the time for ``error`` by log-log interpolation; NaN where it was not reached."""
        front = self.frontier()
        e = np.log([max(p.error, 1e-300) for p in front])[::-1]
        t = np.log([p.seconds for p in front])[::-1]
        if not front or np.log(error) < e[0]:
            return nan
        return float(np.exp(np.interp(np.log(error), e, t)))

    def cheapest(self, error: float) -> Level | None:
        """Return the cheapest measured or modelled point with at most this error."""
        enough = [p for p in self.points if p.error <= error]
        return min(enough, key=lambda p: p.seconds, default=None)

    def record(self) -> dict[str, Any]:
        """Return the route as plain data."""
        return {**vars(self), "points": [p.cost_record() for p in self.points]}


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
        return self.distance == self.distance and not self.baseline


@dataclass(frozen=True)
class Cheapest:
    """For an error 10^−digits the cheapest route and its point, None where none reaches it."""

    equation: str
    digits: int
    route: str
    point: Level | None

    def record(self) -> dict[str, Any]:
        """Return the price as plain data."""
        return {**vars(self), "point": None if self.point is None else self.point.cost_record()}


def price_list(routes: Sequence[Priced], digits: Sequence[int]) -> tuple[Cheapest, ...]:
    """Return the cheapest route of each equation for errors 10^−digits."""
    prices = []
    for equation in dict.fromkeys(r.equation for r in routes):
        own = [r for r in routes if r.equation == equation]
        for d in digits:
            offers = [(r.route, p) for r in own if (p := r.cheapest(10.0**-d)) is not None]
            route, point = min(offers, key=lambda o: o[1].seconds, default=("", None))
            prices.append(Cheapest(equation, d, route, point))
    return tuple(prices)


def promised_list(routes: Sequence[Priced], digits: Sequence[int]) -> tuple[Cheapest, ...]:
    """Return the cheapest tolerance within 10^−digits, which the routes keep for any scene.

    Here a tolerance is chosen for what it promises, not for what it happened to reach.
    """
    by_tol = []
    for route in routes:
        steered = [p for p in route.points if p.promised < inf]
        if steered:
            points = tuple(replace(p, errors={**p.errors, "L1": p.promised}) for p in steered)
            by_tol.append(replace(route, points=points))
    return price_list(by_tol, digits)


@dataclass(frozen=True)
class Crossover:
    """Below ``error`` the route ``below`` is cheaper than ``above``, which was until then."""

    equation: str
    error: float
    above: str
    below: str


def crossovers(routes: Sequence[Priced]) -> tuple[Crossover, ...]:
    """Return where the cheapest route of each equation changes, from large errors to small."""
    crossings = []
    for equation in dict.fromkeys(r.equation for r in routes):
        own = [r for r in routes if r.equation == equation]
        errors = np.geomspace(0.3, 1e-13, 1001)
        times = np.array([[r.seconds_for(float(e)) for e in errors] for r in own])
        known = np.isfinite(times).any(axis=0)
        winners = np.where(known, np.nanargmin(np.where(known, times, 1.0), axis=0), -1)
        for k in range(1, errors.size):
            a, b = int(winners[k - 1]), int(winners[k])
            if a != b and min(a, b) >= 0:
                crossings.append(Crossover(equation, float(errors[k]), own[a].route, own[b].route))
    return tuple(crossings)
