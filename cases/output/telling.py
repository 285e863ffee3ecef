"""What of an outcome is told to a reader, each thing once; files and ``--json`` have everything."""

from collections.abc import Sequence
from dataclasses import dataclass

from cases.comparison.compare import Comparison, route_name
from cases.comparison.run import CurveOutcome, Refusal
from sim.report import Report

STATISTICS = {
    "autocorrelation_time": "autocorrelation time",
    "time in autocorrelation times": "times per trajectory",
    "effective_samples": "effective samples",
    "relative error of effective_samples": "relative error of these",
    "slowest quantity": "slowest quantity",
    "r_hat": "split R-hat",
    "burn_in_check": "burn-in",
}
"""Settings of a simulation that say whether its sample can be trusted, and what a table calls them.
"""


@dataclass(frozen=True)
class ErrorsApart:
    """The three errors of one density of the simulated full system, never mixed.

    ``sampling`` is its expected L1 error by chance; ``step_bias`` the L1 distance from the density
    of half the step and what chance makes of that, None where it was not measured; ``averaging``
    has each averaged theory's L1 distance and what chance and solvers make of that.
    """

    route: str
    observable: str
    sampling: float
    step_bias: tuple[float, float] | None
    averaging: tuple[tuple[str, float, float], ...]


def errors_apart(curve: CurveOutcome) -> tuple[ErrorsApart, ...]:
    """Return the three errors of every density that was sampled from the full system."""
    found = []
    for r in curve.results:
        errors = r.report.errors if isinstance(r.report, Report) else ()
        for d in errors:
            route = route_name(r.method)
            told = [c for c in told_comparisons(curve.comparisons) if c.observable == d.name]
            averaging = tuple(
                (_theory(c.b if c.a == route else c.a), c.L1, c.error)
                for c in told
                if c.measures == "averaging" and route in (c.a, c.b)
            )
            pair = d.step_bias and (d.step_bias.difference, d.step_bias.chance)
            found.append(ErrorsApart(route, d.name, d.sampling, pair, averaging))
    return tuple(found)


def statistics_of(curve: CurveOutcome) -> tuple[tuple[str, tuple[str | float | int, ...]], ...]:
    """Return each simulation's route with its diagnosis, in the order of ``STATISTICS``."""
    return tuple(
        (route_name(r.method), tuple(r.report.diagnosis.settings().values()))
        for r in curve.results
        if isinstance(r.report, Report) and r.report.diagnosis is not None
    )


def told_comparisons(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """Return the comparisons without the repeats among a theory's solvers.

    What separates two theories is the same by every solver, as the numerical rows above show: of
    the rows that measure averaging, the first of each pair of theories is kept.
    """
    seen: set[tuple[str, ...]] = set()
    kept = []
    for c in comparisons:
        pair = (c.observable, _theory(c.a), _theory(c.b))
        if c.measures != "averaging" or pair not in seen:
            kept.append(c)
        if c.measures == "averaging":
            seen.add(pair)
    return tuple(kept)


def told_refusals(refusals: Sequence[Refusal]) -> tuple[Refusal, ...]:
    """Return the refusals with the same reason joined: routes, and observables, in one entry."""
    reasons: dict[tuple[str, bool], tuple[dict[str, None], dict[str, None]]] = {}
    for r in refusals:
        reason = r.reason
        for name in r.observables:
            reason = reason.removeprefix(f"{name}: ")
        routes, names = reasons.setdefault((reason, r.failed), ({}, {}))
        routes.setdefault(r.route)
        for name in r.observables:
            names.setdefault(name)
    return tuple(
        Refusal(_joined_routes(list(routes)), tuple(names), reason, failed)
        for (reason, failed), (routes, names) in reasons.items()
    )


def _theory(route: str) -> str:
    """The theory of a route; its simulation is told apart from what solves it."""
    theory, _, solver = route.partition("/")
    return route if solver == "simulation" else theory


def _joined_routes(routes: list[str]) -> str:
    solvers: dict[str, list[str]] = {}
    for route in routes:
        theory, _, solver = route.partition("/")
        solvers.setdefault(theory, []).append(solver)
    return ", ".join(
        f"{theory}/{'|'.join(found)}" if all(found) else theory for theory, found in solvers.items()
    )
