"""The whole map: every grid point once, finished ones taken from disk."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from cases.fields import program_version
from cases.regime_map.grid import Axis, grid_points, system_at
from cases.regime_map.points import MAP_RELAXATIONS, MapPoint, map_point
from cases.regime_map.store import PointStore
from cases.routes import Sampling
from cases.scene import Scene
from cases.summary import plain
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name


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
        """Every failure at a point, in words."""
        return tuple(f"{self.place(p)}: {words}" for p in self.points for words in p.problems)

    @property
    def shape(self) -> tuple[int, ...]:
        """Points along each axis."""
        return tuple(axis.values.size for axis in self.axes)

    def place(self, point: MapPoint) -> str:
        """Return where a point lies, such as ``B = 10, δ = 0.5``."""
        pairs = zip(self.axes, point.values, strict=True)
        return ", ".join(f"{axis.symbol} = {value:g}" for axis, value in pairs)

    def record(self) -> dict[str, Any]:
        """Return the record of ``fpk regime``."""
        record: dict[str, Any] = plain(
            {
                "scene": self.scene.name,
                "observable": observable_name(self.observable),
                "axes": [{"key": a.key, "values": a.values} for a in self.axes],
                "points": [asdict(p) for p in self.points],
                "reused": self.reused,
                "seconds": self.seconds,
            }
        )
        return record


def build_map(
    scene: Scene,
    axes: Sequence[Axis],
    *,
    sampling: Sampling,
    folder: Path | None = None,
    progress: Progress = silent,
) -> RegimeMap:
    """Return the map of the scene's first displacement; kept and continued in ``folder``."""
    start = perf_counter()
    observable = first_displacement(scene)
    if sampling.time is None:
        sampling = replace(sampling, relaxations=sampling.relaxations or MAP_RELAXATIONS)
    # The answer of the simulation does not depend on the number of threads.
    identity = {
        "scene": scene.text,
        "observable": observable_name(observable),
        "keys": [axis.key for axis in axes],
        "sampling": asdict(replace(sampling, threads=None)),
        "version": program_version(),
    }
    store = PointStore(folder, identity)
    wanted = list(grid_points(axes))
    missing = [values for values in wanted if values not in store.points]
    for done, values in enumerate(missing):
        progress(done, len(missing), "points of the map")
        system = system_at(scene.system, axes, values)
        store.add(map_point(system, observable, values, sampling=sampling))
    progress(len(missing), len(missing), "points of the map")
    return RegimeMap(
        scene=scene,
        observable=observable,
        axes=tuple(axes),
        points=tuple(store.points[values] for values in wanted),
        reused=len(wanted) - len(missing),
        seconds=perf_counter() - start,
    )


def first_displacement(scene: Scene) -> Observable:
    """Return the first single displacement observed, else that of the first contact mass."""
    single = [o for o in scene.observables if len(o) == 1 and o[0].kind == "q"]
    if single:
        return single[0]
    pairs = [c for o in scene.observables for c in o if c.kind == "q"]
    return (pairs[0],) if pairs else scene.observables[0]
