"""One point of a map: the distance of each theory to the full system, and which is nearer."""

from dataclasses import dataclass
from time import perf_counter

from cases.comparison.claims import reference_of, theory_of
from cases.comparison.compare import distance_between, route_name
from cases.comparison.routes import ROUTES, Request, Sampling, method_for
from fpk.clearance import stop_clearances
from fpk.density import AnyDensity
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import Progress, silent
from fpk.observable import Observable
from fpk.system import System

THEORIES = ("nonintegrable", "integrable")
UNDECIDED, NEITHER = "undecided", "neither"

MAP_RELAXATIONS = 38.0
"""Relaxation times sampled on a path: chance moves L1 of one displacement by about 0.001."""


@dataclass(frozen=True)
class MapPoint:
    """What was found at one grid point.

    ``L1`` and ``error`` by theory; a theory that does not apply is left out. ``reference`` is what
    they are held against. ``rms_ratio``: the smallest clearance over the rms displacement without
    contact. ``winner``: the nearer theory, "undecided" where the difference is within ``error``,
    "neither" where no theory applies. ``problems``: what failed or was not certified.
    """

    values: tuple[float, ...]
    L1: dict[str, float]
    error: dict[str, float]
    reference: str
    rms_ratio: float | None
    winner: str
    problems: tuple[str, ...]
    seconds: float


def map_point(
    system: System,
    observable: Observable,
    values: tuple[float, ...],
    *,
    sampling: Sampling,
    progress: Progress = silent,
) -> MapPoint:
    """Return what each theory is worth for ``observable`` of ``system``."""
    start = perf_counter()
    found: dict[str, AnyDensity] = {}
    problems: list[str] = []
    for name in ("exact", *(n for n in THEORIES if ROUTES[n].make), "montecarlo"):
        if name == "montecarlo" and "exact" in found:
            continue
        solver = "closed-form" if "closed-form" in ROUTES[name].solvers else None
        method = method_for(Request(name, solver, sampling=sampling))
        if method.refusal(system, observable) is not None:
            continue
        try:
            density = method.solve(system, [observable], progress=progress).densities[0]
        except (NotApplicable, NotCertified, InvalidInput) as error:
            problems.append(f"{name}: {error}")
            continue
        problems += [f"{name}: {failure}" for failure in density.certificate.failures]
        found[route_name(method)] = density
    reference = reference_of(found)
    distances = {
        name: distance_between(theory, reference)
        for name in THEORIES
        if (theory := theory_of(found, name)) is not None and reference is not None
    }
    ratios = [s.ratio for s in stop_clearances(system) if s.ratio is not None]
    return MapPoint(
        values=values,
        L1={name: d[0] for name, d in distances.items()},
        error={name: d[1] for name, d in distances.items()},
        reference="" if reference is None else next(r for r, d in found.items() if d is reference),
        rms_ratio=min(ratios, default=None),
        winner=winner_of(distances),
        problems=tuple(problems),
        seconds=perf_counter() - start,
    )


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory whose distance is smaller beyond the errors of both."""
    if not distances:
        return NEITHER
    if len(distances) == 1:
        return next(iter(distances))
    nearer, farther = sorted(distances, key=lambda name: distances[name][0])
    (a, slack_a), (b, slack_b) = distances[nearer], distances[farther]
    return nearer if b - a > slack_a + slack_b else UNDECIDED
