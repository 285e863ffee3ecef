"""The map: a sweep of the averaging errors, and which theory is nearer at each of its points."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cases.comparison.quantity import AVERAGING
from cases.scene.numbers import with_numbers
from cases.scene.scene import Scene
from cases.studies.regime_map.points import THEORIES, MapPoint, map_point
from cases.studies.sweep.reference import SIMULATION
from cases.studies.sweep.result import Sweep
from cases.studies.sweep.sweep import every_answer
from fpk.clearance import stop_clearances
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from sim.montecarlo import MonteCarlo


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
        points.append(map_point(point, min(ratios, default=None)))
    return RegimeMap(scene, observable, swept, tuple(points))
