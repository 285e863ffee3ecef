"""The map: what each theory is worth over a grid of parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

from cases.scene.scene import Scene
from cases.studies.regime_map.points import MapPoint, map_point
from cases.studies.sweep.grid import Axis, computed, place_words
from cases.studies.sweep.reference import SIMULATION, settings_of, solver_of
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.montecarlo import MonteCarlo


@dataclass(frozen=True)
class RegimeMap:
    """The points of a grid in its order, the last axis fastest; ``reused`` came from disk."""

    scene: Scene
    observable: Observable
    axes: tuple[Axis, ...]
    points: tuple[MapPoint, ...]
    reused: int
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Every failure at a point, in words that begin with its place: ``B = 10, δ = 0.5``."""
        return tuple(
            f"{place_words(self.axes, p.values)}: {words}"
            for p in self.points
            for words in p.problems
        )

    def record(self) -> dict[str, Any]:
        """Return the record of ``fpk regime`` as ``plain`` takes it."""
        names = {"scene": self.scene.name, "observable": observable_name(self.observable)}
        axes = [{"key": a.key, "values": a.values} for a in self.axes]
        return {**vars(self), **names, "axes": axes}


def build_map(
    scene: Scene,
    axes: Sequence[Axis],
    *,
    simulation: MonteCarlo = SIMULATION,
    reference: str = SIMULATION.route.method,
    folder: Path | None = None,
    progress: Progress = silent,
) -> RegimeMap:
    """Return the map of the scene's first displacement, one in a pair if no other is observed.

    Finished points are stored in ``folder``, and the map goes on from them. ``reference`` is the
    method that the theories are held against where the full system's density is not exact: that of
    ``simulation``, or one that solves (6) to ``REFERENCE_TOL``, or to what its work unasked allows;
    ``simulation`` where it does not apply. The ``cluster`` of ``simulation`` takes whole points.

    Raises ``InvalidInput`` for a reference that is no method.
    """
    start = perf_counter()
    displacements = [c for o in sorted(scene.observables, key=len) for c in o if c.kind == "q"]
    observable = tuple(displacements[:1]) or scene.observables[0]
    identity = {
        "scene": scene.text,
        "observable": observable_name(observable),
        "keys": [axis.key for axis in axes],
        "reference": reference,
        **settings_of(simulation),
    }
    solver = solver_of(reference)

    def task(system: System, values: tuple[float, ...]) -> Callable[[MonteCarlo], MapPoint]:
        return partial(map_point, system, observable, values, solver)

    points, reused = computed(
        scene.system, axes, task, MapPoint.read, identity=identity, simulation=simulation,
        side_by_side=solver is not None, folder=folder, progress=progress,
    )  # fmt: skip
    return RegimeMap(scene, observable, tuple(axes), points, reused, perf_counter() - start)
