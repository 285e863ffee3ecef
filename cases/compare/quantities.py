"""Engineering quantities of the answers: moments, quantiles, what a stop feels; and their judging.

Each follows from one density (an upcrossing rate from that of displacement and momentum, by Rice's
formula), so that it comes in the same way from every route. Two routes are judged as two densities
are, see ``compare``.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import isfinite
from typing import Any

import numpy as np
from scipy.special import stdtrit

from cases.compare.compare import ROUND_OFF, Comparison, discrepancies, measured_between
from cases.compare.quantity import (
    UPCROSSING,
    Definition,
    shown_of,
)
from fpk.answer.density import AnyDensity, Density
from fpk.answer.dynamics import upcrossings
from fpk.answer.method import Result, Route, silent
from fpk.answer.names import Coordinate, Level, observable_name
from fpk.answer.quantities import ErrorKind, Number
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.system.system import System
from sim.sample.diagnostics import FALSE_ALARMS


@dataclass(frozen=True)
class Quantity:
    """A number that follows from the density of ``observable`` by ``route``, with its error.

    ``quantity`` is its name in tables, as ``contact probability, left stop``, and ``name`` the one
    that ``fpk.sweep`` takes, as ``contact_probability(1,left)``. ``reach`` is how far it may be
    from the truth: by numerics its error, by chance what is exceeded in ``FALSE_ALARMS`` by any of
    the quantities of the observable. ::

        for x in fpk.solve(system, ["q2"], methods=["integrable"]).quantities:
            print(x.observable, x.quantity, x.route.label, x.number.value, x.number.error)
    """

    definition: Definition
    quantity: str
    route: Route
    number: Number
    error_kind: ErrorKind
    reach: float

    @property
    def observable(self) -> str:
        """The name of what it is a quantity of, such as ``q2``."""
        return observable_name(self.definition.observable)

    @property
    def label(self) -> str:
        """The name in tables for readers: of impacts, and of levels with their side."""
        if self.definition.kind == "exceedance":
            return self.quantity.replace("probability above", f"probability of {self.observable} >")
        return self.quantity.replace("upcrossing rate", "impact rate")

    @property
    def name(self) -> str:
        """The name that a user writes, such as ``rms(q2)``."""
        return str(self.definition)


def quantities_of(
    system: System, results: Sequence[Result], exceedance: Sequence[Level] = ()
) -> tuple[Quantity, ...]:
    """Return the quantities of every density: those of ``shown_of``, by observable and route.

    Routes are in the order of ``Answers.densities``. The upcrossing rate of the position of a stop
    is that of impacts.
    """
    rows = [row for result in results for row in _rows(system, result, exceedance)]
    observables = list(dict.fromkeys(q.definition.observable for q in rows))
    order = [definition for o in observables for definition in shown_of(system, o, exceedance)]

    def place(q: Quantity) -> tuple[int, bool, bool]:
        return order.index(q.definition), q.route.sampled, q.route.solves != "full"

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
        if a.definition != b.definition:
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


def _rows(system: System, result: Result, exceedance: Sequence[Level]) -> Iterator[Quantity]:
    """The quantities by one route: of each density, then the rates at stops."""
    route = result.method.route
    for density in result.densities:
        definitions = shown_of(system, density.observable, exceedance)
        for definition in definitions:
            if definition.kind != UPCROSSING:
                number, words = definition.of(density, system), definition.words(system)
                reach = _reach(definition, density, number, len(definitions))
                yield Quantity(definition, words, route, number, density.error_kind, reach)
    observed = {d.observable for d in result.densities}
    for row in system.contact_masses:
        q, p = Coordinate("q", row), Coordinate("p", row)
        if {(q,), (q, p)} & observed:
            yield from _rates(system, result, q, p, len(shown_of(system, (q,), exceedance)))


def _rates(
    system: System, result: Result, q: Coordinate, p: Coordinate, count: int
) -> Iterator[Quantity]:
    """The upcrossing rates of all stops of the mass of ``q``, among ``count`` quantities of it."""
    method: Any = result.method
    route = method.route
    definitions = [d for d in shown_of(system, (q,)) if d.kind == UPCROSSING]
    at = np.array([level for d in definitions for level in d.levels(system)])
    known = {d.observable: d for d in (*result.densities, *result.beside)}
    joint = known.get((q, p))
    if joint is not None:
        values, errors = upcrossings(joint, float(system.mass[q.row]), at)
    elif hasattr(method, "crossings") and route.quick and not route.sampled:
        try:
            curve = method.crossings(system, (q,), at, tol=None, progress=silent)
        except (NotApplicable, NotCertified):
            return
        values, errors = curve.values, curve.errors
    else:
        return
    kind = "numerical" if joint is None else joint.error_kind
    for definition, value, error in zip(definitions, values, errors, strict=True):
        rate = Number(float(value), float(error))
        reach = rate.error + ROUND_OFF * abs(rate.value)
        if joint is not None:
            reach = reach_of(joint, rate, 0.0, count)
        yield Quantity(definition, definition.words(system), method.route, rate, kind, reach)


def _reach(definition: Definition, density: AnyDensity, number: Number, count: int) -> float:
    """How far a number of ``density`` may be from the truth, see ``reach_of``."""
    kind, p = definition.kind, definition.at
    sampled = isinstance(density, SampledDensity) and isfinite(number.value)
    if kind == "quantile" and p is not None and sampled:
        # By chance a quantile may be off by that of p plus and minus what its share may be.
        share = density.cdf(number.value) if p <= 0.5 else density.exceedance(number.value)
        reach = reach_of(density, share, 0.0, count)
        ends = [p - reach, p + reach]
        if not 0.0 < ends[0] < ends[1] < 1.0:
            return np.inf
        return max(abs(density.quantile(end).value - number.value) for end in ends)
    size = {"skewness": 1.0, "correlation": 1.0}.get(kind, 0.0)
    if kind == "mean":
        size = density.std().value
    if kind == "covariance":  # what it would be of coordinates in proportion to each other
        correlation = density.correlation().value
        size = abs(number.value / correlation) if correlation else number.error
    return reach_of(density, number, size, count)


def reach_of(density: AnyDensity, number: Number, size: float, count: int) -> float:
    """Return how far ``number``, which follows from ``density``, may be from the truth.

    By chance: Student's t of the batches, and Bernstein's term for a number of about ``size`` that
    rests on few independent samples. ``count`` quantities share the rate ``FALSE_ALARMS``.
    """
    value, error = abs(number.value), number.error
    if isinstance(density, Density):
        return error + ROUND_OFF * value
    if error == 0.0:  # of a stop beyond all samples: nothing was seen, and nothing is known
        return np.inf
    z = -float(stdtrit(density.batch_values.shape[0] - 1, FALSE_ALARMS / (2 * count)))
    return z * error + 2.0 * (z * error) ** 2 / max(value, size, error)
