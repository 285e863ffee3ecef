"""The points of a map: what each theory is worth at one."""

from dataclasses import dataclass

from cases.studies.sweep.result import SweepPoint

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"
"""Winners where the difference is within the errors, and where no theory applies."""


@dataclass(frozen=True)
class MapPoint:
    """Measured distances of the theories at one grid point.

    ``L1`` and ``error`` by theory; a theory that does not apply is left out. ``reference`` is the
    route that they are held against, empty where no theory applies; ``rms_ratio`` the smallest
    clearance over the rms displacement without contact; ``winner`` the nearer theory, or
    ``UNDECIDED``, or ``NEITHER``; ``problems`` what failed or was not certified.
    """

    values: tuple[float, ...]
    L1: dict[str, float]
    error: dict[str, float]
    reference: str
    rms_ratio: float | None
    winner: str
    problems: tuple[str, ...]
    seconds: float


def map_point(point: SweepPoint, rms_ratio: float | None) -> MapPoint:
    """Return what the averaging errors that are the answers of ``point`` say."""
    distances = {
        a.method: (a.value, a.error)
        for a in point.answers
        if a.value is not None and a.error is not None
    }
    return MapPoint(
        values=point.values,
        L1={name: value for name, (value, _) in distances.items()},
        error={name: error for name, (_, error) in distances.items()},
        reference=max(a.reference for a in point.answers),
        rms_ratio=rms_ratio,
        winner=winner_of(distances),
        problems=point.problems,
        seconds=point.seconds,
    )


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory whose distance is smaller beyond the errors of both."""
    if not distances:
        return NEITHER
    nearer, *others = sorted(distances, key=lambda name: distances[name][0])
    slack = sum(error for _, error in distances.values())
    clear = all(distances[other][0] - distances[nearer][0] > slack for other in others)
    return nearer if clear else UNDECIDED
