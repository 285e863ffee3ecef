"""The map: a sweep of the averaging errors, and which theory is nearer at each of its points."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cases.comparison.quantity import AVERAGING
from cases.scene.numbers import with_numbers
from cases.scene.scene import Scene
from cases.studies.sweep.reference import SIMULATION
from cases.studies.sweep.result import Sweep
from cases.studies.sweep.sweep import every_answer
from fpk.clearance import stop_clearances
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from sim.montecarlo import MonteCarlo

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


@dataclass(frozen=True)
class RegimeMap:
    """The points of a map in the order of the ``sweep`` of averaging errors that it is made of."""

    scene: Scene
    observable: Observable
    sweep: Sweep
    points: tuple[MapPoint, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """Every failure at a point, in words that begin with its place: ``B = 10, δ = 0.5``."""
        return self.sweep.problems

    def record(self) -> dict[str, Any]:
        """Return the record of ``fpk regime`` as ``plain`` takes it."""
        swept = self.sweep.record()
        return {
            "scene": self.scene.name,
            "observable": observable_name(self.observable),
            "axes": swept["axes"],
            "points": self.points,
            "reused": swept["reused"],
            "seconds": swept["seconds"],
        }


def build_map(
    scene: Scene,
    vary: Sequence[str],
    *,
    simulation: MonteCarlo = SIMULATION,
    reference: str = SIMULATION.route.method,
    folder: Path | None = None,
    progress: Progress = silent,
) -> RegimeMap:
    """Return the map of the scene's first displacement, one in a pair if no other is observed.

    ``vary`` and what it raises are as of ``sweep``. Finished points are stored in ``folder``, and
    the map goes on from them. ``reference`` is the method that the theories are held against where
    the full system's density is not exact: that of ``simulation``, or one that solves (6) to
    ``REFERENCE_TOL``, or to what its work unasked allows; ``simulation`` where it does not apply.
    The ``cluster`` of ``simulation`` takes whole points.
    """
    displacements = [c for o in sorted(scene.observables, key=len) for c in o if c.kind == "q"]
    observable = tuple(displacements[:1]) or scene.observables[0]
    swept = every_answer(
        scene, vary, [f"{AVERAGING}({observable_name(observable)})"], methods=THEORIES,
        simulation=simulation, reference=reference, folder=folder, progress=progress,
    )  # fmt: skip
    keys = [axis.key for axis in swept.axes]
    points = []
    for point in swept.points:
        system = with_numbers(scene.system, dict(zip(keys, point.values, strict=True)))
        ratios = [s.ratio for s in stop_clearances(system) if s.ratio is not None]
        distances = {
            a.method: (a.value, a.error)
            for a in point.answers
            if a.value is not None and a.error is not None
        }
        points.append(
            MapPoint(
                values=point.values,
                L1={name: value for name, (value, _) in distances.items()},
                error={name: error for name, (_, error) in distances.items()},
                reference=max(a.reference for a in point.answers),
                rms_ratio=min(ratios, default=None),
                winner=winner_of(distances),
                problems=point.problems,
                seconds=point.seconds,
            )
        )
    return RegimeMap(scene, observable, swept, tuple(points))


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory whose distance is smaller beyond the errors of both."""
    if not distances:
        return NEITHER
    nearer, *others = sorted(distances, key=lambda name: distances[name][0])
    slack = sum(error for _, error in distances.values())
    clear = all(distances[other][0] - distances[nearer][0] > slack for other in others)
    return nearer if clear else UNDECIDED
