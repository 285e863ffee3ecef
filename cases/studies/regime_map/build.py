"""The whole map: every grid point once, finished ones taken from disk."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

from cases.comparison.routes import Sampling
from cases.output.fields import program_version
from cases.output.summary import plain
from cases.scene.scene import Scene
from cases.studies.regime_map.grid import Axis, grid_points, system_at
from cases.studies.regime_map.points import MAP_RELAXATIONS, MapPoint, map_point
from cases.studies.regime_map.store import PointStore
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from sim.cluster import as_finished, connected


@dataclass(frozen=True)
class RegimeMap:
    """The points of a grid in its order, the last axis fastest; ``reused`` came from disk.

    ``note`` says what was dropped of the file on disk, None where nothing was.
    """

    scene: Scene
    observable: Observable
    axes: tuple[Axis, ...]
    points: tuple[MapPoint, ...]
    reused: int
    seconds: float
    note: str | None = None

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
    # The answer of the simulation does not depend on where and how it is run.
    counted = asdict(replace(sampling, threads=None))
    for key in ("cluster", "checkpoint", "partial"):
        del counted[key]
    identity = {
        "scene": scene.text,
        "observable": observable_name(observable),
        "keys": [axis.key for axis in axes],
        "sampling": counted,
        "version": program_version(),
    }
    store = PointStore(folder, identity)
    wanted = list(grid_points(axes))
    missing = [values for values in wanted if values not in store.points]
    todo = [
        partial(map_point, system_at(scene.system, axes, values), observable, values)
        for values in missing
    ]
    progress(0, len(missing), "points of the map")
    for done, point in enumerate(_found(todo, sampling), start=1):
        store.add(point)
        progress(done, len(missing), "points of the map")
    return RegimeMap(
        scene=scene,
        observable=observable,
        axes=tuple(axes),
        points=tuple(store.points[values] for values in wanted),
        reused=len(wanted) - len(missing),
        seconds=perf_counter() - start,
        note=store.note,
    )


def _found(todo: Sequence[Callable[..., MapPoint]], sampling: Sampling) -> Iterator[MapPoint]:
    """Yield the points as they are finished: one after the other, or each a task of a cluster."""
    if sampling.cluster is None:
        yield from (point(sampling=sampling) for point in todo)
        return
    alone = replace(sampling, cluster=None, threads=1)
    with connected(sampling.cluster) as client:
        yield from as_finished(client, [partial(point, sampling=alone) for point in todo])


def first_displacement(scene: Scene) -> Observable:
    """Return the first single displacement observed, else that of the first contact mass."""
    single = [o for o in scene.observables if len(o) == 1 and o[0].kind == "q"]
    if single:
        return single[0]
    pairs = [c for o in scene.observables for c in o if c.kind == "q"]
    return (pairs[0],) if pairs else scene.observables[0]
