"""What of an outcome is told to a reader, each thing once; files and ``--json`` have everything."""

from collections.abc import Sequence

from cases.compare import Comparison
from cases.run import Refusal


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
