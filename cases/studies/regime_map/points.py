"""The points of a map: what each theory is worth at one."""

from dataclasses import dataclass
from time import perf_counter

from cases.comparison.compare import distance_between
from cases.output.records import Record
from cases.studies.simulation import best_answer, deterministic
from cases.studies.sweep.reference import reference_of
from fpk.clearance import stop_clearances
from fpk.method import Method
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"
"""Winners where the difference is within the errors, and where no theory applies."""


@dataclass(frozen=True)
class MapPoint:
    """Measured distances of the theories at one grid point.

    ``L1`` and ``error`` by theory; a theory that does not apply is left out. ``reference`` is the
    route that they are held against; ``rms_ratio`` the smallest clearance over the rms displacement
    without contact; ``winner`` the nearer theory, or ``UNDECIDED``, or ``NEITHER``; ``problems``
    what failed or was not certified.
    """

    values: tuple[float, ...]
    L1: dict[str, float]
    error: dict[str, float]
    reference: str
    rms_ratio: float | None
    winner: str
    problems: tuple[str, ...]
    seconds: float

    @classmethod
    def read(cls, record: Record) -> "MapPoint":
        """Return the point of its record in JSON."""
        return cls(**{**record, **{key: tuple(record[key]) for key in ("values", "problems")}})


def map_point(
    system: System,
    observable: Observable,
    values: tuple[float, ...],
    solver: Method | None,
    simulation: MonteCarlo,
) -> MapPoint:
    """Return what each theory is worth for ``observable`` of ``system``.

    ``reference_of`` is the reference.
    """
    start = perf_counter()
    problems: list[str] = []
    reference = reference_of(system, observable, solver, simulation, problems)
    distances = {}
    for theory in THEORIES:
        own = [m for m in deterministic("averaged") if m.route.method == theory]
        answer = best_answer(own, system, observable, problems)
        if answer is not None and reference is not None:
            distances[theory] = distance_between(answer[1], reference[1])[:2]
    ratios = [s.ratio for s in stop_clearances(system) if s.ratio is not None]
    return MapPoint(
        values=values,
        L1={name: d[0] for name, d in distances.items()},
        error={name: d[1] for name, d in distances.items()},
        reference="" if reference is None else reference[0],
        rms_ratio=min(ratios, default=None),
        winner=winner_of(distances),
        problems=tuple(problems),
        seconds=perf_counter() - start,
    )


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory whose distance is smaller beyond the errors of both."""
    if not distances:
        return NEITHER
    nearer, *others = sorted(distances, key=lambda name: distances[name][0])
    slack = sum(error for _, error in distances.values())
    clear = all(distances[other][0] - distances[nearer][0] > slack for other in others)
    return nearer if clear else UNDECIDED
