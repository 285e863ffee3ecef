"""Points of the work-precision diagram: error, time and settings of one route, or why not timed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from cases.studies.timing import Timing


@dataclass(frozen=True)
class Point:
    """One setting of a route: its true ``error`` on the route's axis and what it costs.

    ``stated`` is the route's own estimate; ``modelled`` marks a point of the law of sampling that
    was not run. ``promised`` is the tolerance of a route that is steered by one: it holds for every
    scene, where a number of elements is right for this one.
    """

    settings: str
    error: float
    stated: float
    timing: Timing
    unknowns: int = 0
    modelled: bool = False
    promised: float = inf

    @property
    def seconds(self) -> float:
        """Median processor time."""
        return self.timing.seconds


@dataclass(frozen=True)
class Priced:
    """One route for one equation, timed at several settings, from coarse to fine."""

    route: str
    equation: str
    axis: str
    points: tuple[Point, ...]

    def frontier(self) -> list[Point]:
        """Return the points that no other of the route beats in both error and time."""
        found: list[Point] = []
        for point in sorted(self.points, key=lambda p: (p.seconds, p.error)):
            if not found or point.error < found[-1].error:
                found.append(point)
        return found

    def seconds_for(self, error: float) -> float:
        """Return the time for ``error`` by log-log interpolation; NaN where it was not reached."""
        front = self.frontier()
        e = np.log([max(p.error, 1e-300) for p in front])[::-1]
        t = np.log([p.seconds for p in front])[::-1]
        if not front or np.log(error) < e[0]:
            return float("nan")
        return float(np.exp(np.interp(np.log(error), e, t)))

    def cheapest(self, error: float) -> Point | None:
        """Return the cheapest measured or modelled point with at most this error."""
        enough = [p for p in self.points if p.error <= error]
        return min(enough, key=lambda p: p.seconds, default=None)


@dataclass(frozen=True)
class NotTimed:
    """A route that is not timed: its answer disagrees with the reference, or there is none.

    Of a ``baseline`` that is no failure of the study.
    """

    route: str
    equation: str
    settings: str
    distance: float
    allowed: float
    reason: str
    baseline: bool = False


@dataclass(frozen=True)
class Cheapest:
    """For an error: the route, its settings, time and memory; ``reached`` False where none does."""

    equation: str
    digits: int
    route: str
    point: Point | None


def price_list(routes: Sequence[Priced], digits: Sequence[int]) -> tuple[Cheapest, ...]:
    """Return the cheapest route of each equation for errors 10^−digits."""
    found = []
    for equation in dict.fromkeys(r.equation for r in routes):
        own = [r for r in routes if r.equation == equation]
        for d in digits:
            offers = [(r.route, p) for r in own if (p := r.cheapest(10.0**-d)) is not None]
            route, point = min(offers, key=lambda o: o[1].seconds, default=("", None))
            found.append(Cheapest(equation, d, route, point))
    return tuple(found)


def promised_list(routes: Sequence[Priced], digits: Sequence[int]) -> tuple[Cheapest, ...]:
    """Return the cheapest tolerance within 10^−digits, which the routes keep for any scene.

    Here a tolerance is chosen for what it promises, not for what it happened to reach.
    """
    by_tol = []
    for route in routes:
        points = tuple(replace(p, error=p.promised) for p in route.points if p.promised < inf)
        if points:
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
    found = []
    for equation in dict.fromkeys(r.equation for r in routes):
        own = [r for r in routes if r.equation == equation]
        errors = np.geomspace(0.3, 1e-13, 1001)
        times = np.array([[r.seconds_for(float(e)) for e in errors] for r in own])
        known = np.isfinite(times).any(axis=0)
        winners = np.where(known, np.nanargmin(np.where(known, times, 1.0), axis=0), -1)
        for k in range(1, errors.size):
            a, b = int(winners[k - 1]), int(winners[k])
            if a != b and min(a, b) >= 0:
                found.append(Crossover(equation, float(errors[k]), own[a].route, own[b].route))
    return tuple(found)
