"""Engineering quantities of the answers and their comparison: moments, quantiles, impacts, forces.

Each follows from one density (an impact rate from the joint density of displacement and momentum,
by Rice's formula), in the same way for every route. Two routes are judged like two densities, see
``compare``.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import isfinite
from typing import Any

import numpy as np

from cases.compare.compare import ROUND_OFF, Comparison, discrepancies, what_is_measured
from cases.compare.quantity import UPCROSSING, Definition, definitions_of
from fpk.answer.density import AnyDensity
from fpk.answer.dynamics import upcrossings
from fpk.answer.method import Result, Route, silent
from fpk.answer.names import Coordinate, Level, observable_name
from fpk.answer.quantities import ErrorKind, Number
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.system.system import System
from sim.sample.diagnostics import largest_by_chance


@dataclass(frozen=True)
class Quantity:
    """A number that follows from the density of ``observable`` by ``route``, with its error.

    ``quantity`` is its name in tables, as ``contact probability, left stop``, and ``name`` the name
    that ``fpk.sweep`` takes, as ``contact_probability(1,left)``. ``reach`` bounds the distance to
    the truth: by numerics the stated error, by chance the quantile that any quantity of the
    observable exceeds at the rate ``FALSE_ALARMS``. ::

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
        """The name of the observable, such as ``q2``."""
        return observable_name(self.definition.observable)

    @property
    def label(self) -> str:
        """The name for readers: "impact rate, …", "probability of q2 > 1.2", else ``quantity``."""
        if self.definition.kind == "exceedance":
            return self.quantity.replace("probability above", f"probability of {self.observable} >")
        return self.quantity.replace("upcrossing rate", "impact rate")

    @property
    def name(self) -> str:
        """The name that ``fpk sweep`` takes, such as ``rms(q2)``."""
        return str(self.definition)


def quantities_of(
    system: System, results: Sequence[Result], exceedance: Sequence[Level] = ()
) -> tuple[Quantity, ...]:
    """Return the quantities of all densities of ``results``, sorted by observable and quantity.

    ``definitions_of`` lists them; routes are in the order of ``Answers.densities``.
    ``exceedance``: levels a of P(X > a).
    """
    rows = [row for result in results for row in _rows(system, result, exceedance)]
    observables = dict.fromkeys(q.definition.observable for q in rows)
    order = [d for o in observables for d in definitions_of(system, o, exceedance)]
    rows.sort(key=lambda q: (order.index(q.definition), q.route.sampled, q.route.solves != "full"))
    return tuple(rows)


def compare_quantities(
    results: Sequence[Result], quantities: Sequence[Quantity], *, averaging_is_exact: bool
) -> tuple[Comparison, ...]:
    """Return the comparisons of all pairs of routes in every quantity that both give.

    Differences are absolute; a number that is not finite is left out. The ``band`` is the sum of
    both ``reach``; None for averaging errors, and if a sample is too small to bound its error.
    """
    neglected = {r.method.route for r in results if r.neglected}
    failed = [
        (r.method.route, d.name)
        for r in results
        for d in r.densities
        if not d.certificate.certified
    ]
    comparisons = []
    for a, b in combinations(quantities, 2):
        difference, routes = abs(a.number.value - b.number.value), (a.route, b.route)
        if a.definition != b.definition or not isfinite(difference):
            continue
        exact = averaging_is_exact and neglected.isdisjoint(routes)
        measures = what_is_measured(*routes, averaging_is_exact=exact)
        band = a.reach + b.reach
        allowed = band if measures != "averaging" and isfinite(band) else None
        uncertified = tuple(route for route in routes if (route, a.observable) in failed)
        names, error = f"{a.observable}: {a.quantity}", a.number.error + b.number.error
        own = names, *routes, measures, difference, allowed, error, uncertified
        comparisons.append(Comparison(*own, norm="absolute"))
    return tuple(comparisons)


def quantity_discrepancies(
    quantities: Sequence[Comparison], densities: Iterable[Comparison]
) -> tuple[str, ...]:
    """Return in words the worst difference of each two routes in the quantities of an observable.

    Pairs of routes whose ``densities`` already fail their comparison are left out.
    """
    said = {(c.observable, c.a, c.b) for c in densities if not c.holds}
    worst: dict[tuple[str, Route, Route], Comparison] = {}
    for c in sorted(quantities, key=lambda c: -c.L1 / (c.band or np.inf)):
        key = c.observable.partition(":")[0], c.a, c.b
        if not c.holds and key not in said:
            worst.setdefault(key, c)
    return discrepancies(quantities, list(worst.values()))


def _rows(system: System, result: Result, exceedance: Sequence[Level]) -> Iterator[Quantity]:
    """Yield the quantities of one ``result``: first of each density, then the impact rates."""
    route = result.method.route
    for density in result.densities:
        definitions = definitions_of(system, density.observable, exceedance)
        for definition in definitions:
            if definition.kind != UPCROSSING:
                number, words = definition.of(density, system), definition.words(system)
                reach = _reach(definition, density, number, len(definitions))
                yield Quantity(definition, words, route, number, density.error_kind, reach)
    observed = {d.observable for d in result.densities}
    for row in system.contact_masses:
        q, p = Coordinate("q", row), Coordinate("p", row)
        if {(q,), (q, p)} & observed:
            yield from _rates(system, result, q, p, len(definitions_of(system, (q,), exceedance)))


def _rates(
    system: System, result: Result, q: Coordinate, p: Coordinate, count: int
) -> Iterator[Quantity]:
    """Yield the impact rates of all stops of the mass of ``q``, of ``count`` quantities judged.

    From the joint density of ``q`` and ``p`` if ``result`` has it, else by ``crossings`` of a quick
    solver; else none.
    """
    method: Any = result.method
    route = method.route
    definitions = [d for d in definitions_of(system, (q,)) if d.kind == UPCROSSING]
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
        reach = reach_of(joint, rate, 0.0, count)
        yield Quantity(definition, definition.words(system), route, rate, kind, reach)


def _reach(definition: Definition, density: AnyDensity, number: Number, count: int) -> float:
    """Return ``reach_of`` the quantity ``definition``, inf if a sample cannot bound its error."""
    kind, p = definition.kind, definition.at
    sampled = isinstance(density, SampledDensity) and isfinite(number.value)
    if kind == "quantile" and p is not None and sampled:
        # The quantile lies between the quantiles of p − reach and p + reach of the probability.
        share = density.cdf(number.value) if p <= 0.5 else density.exceedance(number.value)
        reach = reach_of(density, share, 0.0, count)
        ends = [p - reach, p + reach]
        if not 0.0 < ends[0] < ends[1] < 1.0:
            return np.inf
        return max(abs(density.quantile(end).value - number.value) for end in ends)
    size = {"skewness": 1.0, "correlation": 1.0}.get(kind, 0.0)
    if kind == "mean":
        size = density.std().value
    if kind == "covariance":  # its value at correlation 1
        correlation = density.correlation().value
        size = abs(number.value / correlation) if correlation else number.error
    return reach_of(density, number, size, count)


def reach_of(density: AnyDensity | None, number: Number, size: float, count: int) -> float:
    """Return a bound of the error of ``number``, which follows from ``density``, None: from none.

    It is the error and round-off; for a sample Student's t of the batches, and Bernstein's term for
    a number of the order of ``size`` from few independent samples, or inf if the error is 0.
    ``count`` quantities share the rate ``FALSE_ALARMS``.
    """
    value, error = abs(number.value), number.error
    if not isinstance(density, SampledDensity):
        return error + ROUND_OFF * value
    if error == 0.0:  # a stop beyond all samples: nothing is known
        return np.inf
    z = largest_by_chance(density.batch_values.shape[0], count)
    return z * error + 2.0 * (z * error) ** 2 / max(value, size, error)
