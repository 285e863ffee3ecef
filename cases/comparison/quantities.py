"""Engineering quantities of the answers: moments, quantiles, what a stop feels; and their judging.

Each follows from one density (an upcrossing rate from that of displacement and momentum, by Rice's
formula), so that it comes in the same way from every route. Two routes are judged as two densities
are, see ``compare``.
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
from fpk.dynamics import Crossings
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Result, silent
from fpk.number import Number
from fpk.observable import Coordinate
from fpk.route import Route
from fpk.sampled_density import ErrorKind, SampledDensity
from fpk.system import System
from fpk.upcrossings import upcrossings

QUANTILES = {"quantile 1 %": 0.01, "median": 0.5, "quantile 99 %": 0.99}
FELT = (
    "contact probability", "mean overlap", "overlap in contact", "mean force", "force in contact",
)  # fmt: skip
RATE = "upcrossing rate"
MOST = len(QUANTILES) + 5 + 2 * (len(FELT) + 1)
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
    ``contact_quantities``, and the upcrossing rate of its position, which is that of impacts. Of a
    pair: covariance and correlation.
    """
    rows: list[Quantity] = []
    for result in results:
        rates = list(_rates(system, result))
        for density in result.densities:
            one = len(density.observable) == 1
            rows += _quantities(system, result, density) if one else _of_pair(result, density)
        rows += rates
    observables = list(dict.fromkeys(q.observable for q in rows))
    names = list(dict.fromkeys(q.quantity for q in rows))
    # Beside the share of time in contact.
    for rate in [name for name in names if name.startswith(RATE)]:
        share = FELT[0] + rate.removeprefix(RATE)
        if share in names:
            names.remove(rate)
            names.insert(names.index(share) + 1, rate)

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


def _of_pair(result: Result, density: AnyDensity) -> Iterator[Quantity]:
    route, kind = result.method.route, density.error_kind
    covariance, correlation = density.covariance(), density.correlation()
    # What both would be of coordinates in proportion to each other.
    size = abs(covariance.value / correlation.value) if correlation.value else covariance.error
    for name, number, most in (
        ("covariance", covariance, size),
        ("correlation", correlation, 1.0),
    ):
        yield Quantity(density.name, name, route, number, kind, reach_of(density, number, most))


def _rates(system: System, result: Result) -> Iterator[Quantity]:
    """The upcrossing rates of all stops of masses whose displacement is observed."""
    method, known = result.method, {d.observable: d for d in (*result.densities, *result.beside)}
    for row in system.contact_masses:
        q, p = Coordinate("q", row), Coordinate("p", row)
        if not {(q,), (q, p)} & {d.observable for d in result.densities}:
            continue
        stops = list(_stops_at(system, q))
        at = np.array([stop.sign * stop.clearance for stop, _ in stops])
        joint = known.get((q, p))
        if joint is not None:
            values, errors = upcrossings(joint, float(system.mass[row]), at)
        elif isinstance(method, Crossings) and method.route.quick and not method.route.sampled:
            try:
                curve = method.crossings(system, (q,), at, tol=None, progress=silent)
            except (NotApplicable, NotCertified):
                continue
            values, errors = curve.values, curve.errors
        else:
            continue
        kind = "numerical" if joint is None else joint.error_kind
        for (_, where), value, error in zip(stops, values, errors, strict=True):
            rate = Number(float(value), float(error))
            reach = rate.error + ROUND_OFF * abs(rate.value)
            if joint is not None:
                reach = reach_of(joint, rate, 0.0)
            yield Quantity(str(q), f"{RATE}, {where}", method.route, rate, kind, reach)


def _stops_at(system: System, coordinate: Coordinate) -> Iterator[tuple[Contact, str]]:
    """The stops of a displacement and how they are called: by their side, or where they are."""
    own = [s for s in system.stops if (coordinate.kind, coordinate.index) == ("q", s.mass - 1)]
    for stop in own:
        alone = [s.side for s in own].count(stop.side) == 1
        where = "" if alone else f" at {stop.sign * stop.clearance:g}"
        yield stop, f"{stop.side} stop{where}"


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
