"""One point of a map: the distance of each theory to the full system, and which is nearer."""

from dataclasses import dataclass
from time import perf_counter

from cases.comparison.compare import distance_between
from cases.studies.full_system import deterministic
from fpk.clearance import stop_clearances
from fpk.density import AnyDensity
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import Method
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"


@dataclass(frozen=True)
class MapPoint:
    """What was measured at one grid point.

    ``L1`` and ``error`` by theory; a theory that does not apply is left out. ``reference`` is the
    route that they are held against. ``rms_ratio``: the smallest clearance over the rms
    displacement without contact. ``winner``: the nearer theory, "undecided" where the difference is
    within ``error``, "neither" where no theory applies. ``problems``: what failed or was not
    certified.
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
    system: System, observable: Observable, values: tuple[float, ...], simulation: MonteCarlo
) -> MapPoint:
    """Return what each theory is worth for ``observable`` of ``system``.

    The reference is the first route that solves the full system, ``simulation`` where none does; a
    theory's answer is that of its first solver that gives the observable.
    """
    start = perf_counter()
    theories: dict[str, Method] = {}
    for method in deterministic(system, observable, "averaged"):
        theories.setdefault(method.route.method, method)
    exact = deterministic(system, observable, "full")
    problems: list[str] = []

    def solved(method: Method) -> AnyDensity | None:
        name = method.route.method
        try:
            (density,) = method.solve(system, [observable]).densities
        except (NotApplicable, NotCertified, InvalidInput) as error:
            problems.append(f"{name}: {error}")
            return None
        problems.extend(f"{name}: {failure}" for failure in density.certificate.failures)
        return density

    full = exact[0] if exact else simulation
    reference = solved(full)
    answers = {name: solved(theories[name]) for name in THEORIES if name in theories}
    distances = {
        name: distance_between(density, reference)
        for name, density in answers.items()
        if density is not None and reference is not None
    }
    ratios = [s.ratio for s in stop_clearances(system) if s.ratio is not None]
    return MapPoint(
        values=values,
        L1={name: d[0] for name, d in distances.items()},
        error={name: d[1] for name, d in distances.items()},
        reference="" if reference is None else full.route.label,
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
