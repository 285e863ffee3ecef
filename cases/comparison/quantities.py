"""Engineering quantities of the answers: moments, quantiles, what a stop feels; and their judging.

Each follows from one density (an upcrossing rate from the closed form of the motion), so that it
comes in the same way from every route. Two routes are judged as two densities are, see ``compare``.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import isfinite

import numpy as np
from scipy.special import stdtrit

from cases.comparison.compare import (
    FALSE_ALARMS,
    ROUND_OFF,
    Comparison,
    discrepancies,
    measured_between,
)
from fpk.contact import Contact
from fpk.contact_quantities import contact_quantities
from fpk.density import AnyDensity, Density
from fpk.dynamics import Crossings, upcrossings
from fpk.errors import NotApplicable
from fpk.method import Result, silent
from fpk.number import Number
from fpk.observable import Coordinate
from fpk.route import Route
from fpk.sampled_density import ErrorKind, SampledDensity
from fpk.system import System

QUANTILES = {"quantile 1 %": 0.01, "median": 0.5, "quantile 99 %": 0.99}
FELT = ("contact probability", "mean overlap", "mean force", "force in contact")
MOST = len(QUANTILES) + 5 + 2 * len(FELT)
"""Quantities of one observable between two stops, which share the rate of false alarms."""


@dataclass(frozen=True)
class Quantity:
    """A number that follows from the density of ``observable`` by ``route``, with its error.

    ``reach`` is how far it may be from the truth: by numerics its error, by chance what is exceeded
    in ``FALSE_ALARMS`` by any of the quantities of the observable. ::

        for x in fpk.solve(system, ["q2"], methods=["integrable"]).quantities:
            print(x.observable, x.quantity, x.route.label, x.number.value, x.number.error)
    """

    observable: str
    quantity: str
    route: Route
    number: Number
    error_kind: ErrorKind
    reach: float


def quantities_of(system: System, results: Sequence[Result]) -> tuple[Quantity, ...]:
    """Return the quantities of every density: by observable, quantity, route.

    Routes are in the order of ``Answers.densities``. Of a coordinate: mean, rms, std, skewness,
    kurtosis and ``QUANTILES``. Of a displacement besides, for every stop of its mass: ``FELT`` of
    ``contact_quantities``, and the rate of upcrossings of its position by ``exact``; that rate also
    of a joint density of displacement and momentum that is no histogram. By other routes it takes
    another solution, see ``fpk crossings``.
    """
    rows = [
        row
        for result in results
        for density in result.densities
        for row in (_quantities if len(density.observable) == 1 else _rates)(
            system, result, density
        )
    ]
    observables = list(dict.fromkeys(q.observable for q in rows))
    names = list(dict.fromkeys(q.quantity for q in rows))

    def place(q: Quantity) -> tuple[int, int, bool, bool]:
        averaged = q.route.solves != "full"
        return observables.index(q.observable), names.index(q.quantity), q.route.sampled, averaged

    return tuple(sorted(rows, key=place))


def compared_quantities(
    results: Sequence[Result], quantities: Sequence[Quantity], *, averaging_is_exact: bool
) -> tuple[Comparison, ...]:
    """Return the comparisons of all pairs of routes in every quantity both give.

    A ``band`` is the sum of what either may be off; None where averaging makes the difference, or
    where a sample is too small to say how far chance may reach.
    """
    by_route = {r.method.route: r for r in results}
    comparisons = []
    for a, b in combinations(quantities, 2):
        if (a.observable, a.quantity) != (b.observable, b.quantity):
            continue
        difference = abs(a.number.value - b.number.value)
        if not isfinite(difference):
            continue
        of = by_route[a.route], by_route[b.route]
        measures = measured_between(*of, averaging_is_exact=averaging_is_exact)
        band = a.reach + b.reach
        comparisons.append(
            Comparison(
                f"{a.observable}: {a.quantity}",
                a.route,
                b.route,
                measures,
                difference,
                band if measures != "averaging" and isfinite(band) else None,
                a.number.error + b.number.error,
                tuple(r.method.route for r in of if not _certified(r, a.observable)),
                norm="absolute",
            )
        )
    return tuple(comparisons)


def quantity_discrepancies(
    quantities: Sequence[Comparison], densities: Iterable[Comparison]
) -> tuple[str, ...]:
    """Return in words the worst difference of each two routes in the quantities of an observable.

    Where the comparison of the ``densities`` themselves fails, that has been said.
    """
    said = {(c.observable, c.a, c.b) for c in densities if not c.holds}
    worst: dict[tuple[str, Route, Route], Comparison] = {}
    for c in sorted(quantities, key=lambda c: -c.L1 / (c.band or np.inf)):
        key = c.observable.partition(":")[0], c.a, c.b
        if not c.holds and key not in said:
            worst.setdefault(key, c)
    return discrepancies(quantities, list(worst.values()))


def _certified(result: Result, name: str) -> bool:
    return all(d.certificate.certified for d in result.densities if d.name == name)


def _quantities(system: System, result: Result, density: AnyDensity) -> Iterator[Quantity]:
    route, kind = result.method.route, density.error_kind

    def row(name: str, number: Number, reach: float) -> Quantity:
        return Quantity(density.name, name, route, number, kind, reach)

    std = density.std()
    for name, number, size in (
        ("mean", density.mean(), std.value),
        ("rms", density.rms(), 0.0),
        ("std", std, 0.0),
        ("skewness", density.skewness(), 1.0),
        ("kurtosis", density.kurtosis(), 0.0),
    ):
        yield row(name, number, reach_of(density, number, size))
    for name, p in QUANTILES.items():
        number = density.quantile(p)
        yield row(name, number, _reach_of_quantile(density, p, number))
    for stop, where in _stops_at(system, density.observable[0]):
        felt = contact_quantities(stop, density)
        for name in FELT:
            yield row(f"{name}, {where}", felt[name], reach_of(density, felt[name], 0.0))
        if rate := _upcrossings(system, result, stop):
            yield row(f"upcrossing rate, {where}", rate, rate.error)


def _rates(system: System, result: Result, density: AnyDensity) -> Iterator[Quantity]:
    """The upcrossing rates of the stops of a mass, of the joint density of its q and p, (Rice)."""
    q, p = density.observable
    if (q.kind, p.kind) != ("q", "p") or q.row != p.row or not isinstance(density, Density):
        return
    for stop, where in _stops_at(system, q):
        at = np.array([stop.sign * stop.clearance])
        (value,), (error,) = upcrossings(density, float(system.mass[q.row]), at)
        rate = Number(float(value), float(error))
        name, reach = f"upcrossing rate, {where}", reach_of(density, rate, 0.0)
        yield Quantity(density.name, name, result.method.route, rate, density.error_kind, reach)


def _stops_at(system: System, coordinate: Coordinate) -> Iterator[tuple[Contact, str]]:
    """The stops of a displacement and how they are called: by their side, or where they are."""
    own = [s for s in system.stops if (coordinate.kind, coordinate.index) == ("q", s.mass - 1)]
    for stop in own:
        alone = [s.side for s in own].count(stop.side) == 1
        where = "" if alone else f" at {stop.sign * stop.clearance:g}"
        yield stop, f"{stop.side} stop{where}"


def _upcrossings(system: System, result: Result, stop: Contact) -> Number | None:
    """Upcrossings of the stop per unit time, in closed form alone."""
    method = result.method
    if method.name != "exact" or not isinstance(method, Crossings):
        return None
    at = np.array([stop.sign * stop.clearance])
    try:
        curve = method.crossings(system, stop.mass - 1, at, tol=None, progress=silent)
    except NotApplicable:
        return None
    return Number(float(curve.values[0]), float(curve.errors[0]))


def reach_of(density: AnyDensity, number: Number, size: float) -> float:
    """Return how far ``number``, which follows from ``density``, may be from the truth.

    By chance: Student's t of the batches, and Bernstein's term for a number of about ``size`` that
    rests on few independent samples.
    """
    value, error = abs(number.value), number.error
    if isinstance(density, Density):
        return error + ROUND_OFF * value
    if error == 0.0:  # of a stop beyond all samples: nothing was seen, and nothing is known
        return np.inf
    z = deviations(density)
    return z * error + 2.0 * (z * error) ** 2 / max(value, size, error)


def deviations(density: SampledDensity) -> float:
    """Return the standard errors that chance exceeds in ``FALSE_ALARMS`` of an observable."""
    return -float(stdtrit(density.batch_values.shape[0] - 1, FALSE_ALARMS / (2 * MOST)))


def _reach_of_quantile(density: AnyDensity, p: float, number: Number) -> float:
    """How far a quantile may be off: by chance that of p plus and minus what its share may be."""
    if isinstance(density, Density) or not isfinite(number.value):
        return reach_of(density, number, 0.0)
    share = density.cdf(number.value) if p <= 0.5 else density.exceedance(number.value)
    reach = reach_of(density, share, 0.0)
    ends = [p - reach, p + reach]
    if not 0.0 < ends[0] < ends[1] < 1.0:
        return np.inf
    return max(abs(density.quantile(end).value - number.value) for end in ends)
