"""The whole map: every grid point once, finished ones taken from disk."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

from cases.output.records import program_version
from cases.scene.scene import Scene
from cases.studies.regime_map.grid import Axis, system_at
from cases.studies.regime_map.points import MapPoint, PointStore, map_point
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from sim.cluster import as_finished, connected
from sim.montecarlo import MonteCarlo

SIMULATION = MonteCarlo(relaxations=38.0)
"""So many relaxation times a path: chance moves L1 of one displacement by about 0.001."""


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
        """Every failure at a point, in words that begin with its place: ``B = 10, δ = 0.5``."""
        return tuple(
            ", ".join(f"{a.symbol} = {v:g}" for a, v in zip(self.axes, p.values, strict=True))
            + f": {words}"
            for p in self.points
            for words in p.problems
        )

    def record(self) -> dict[str, Any]:
        """Return the record of ``fpk regime`` as ``plain`` takes it."""
        return {
            "scene": self.scene.name,
            "observable": observable_name(self.observable),
            "axes": [{"key": a.key, "values": a.values} for a in self.axes],
            **{key: getattr(self, key) for key in ("points", "reused", "seconds")},
        }


def build_map(
    scene: Scene,
    axes: Sequence[Axis],
    *,
    simulation: MonteCarlo = SIMULATION,
    folder: Path | None = None,
    progress: Progress = silent,
) -> RegimeMap:
    """Return the map of the scene's first displacement; stored and continued in ``folder``.

    ``simulation`` is the reference where nothing solves the full system; its ``cluster`` takes
    whole points.
    """
    start, observable = perf_counter(), first_displacement(scene)
    # Where and by how many threads a simulation is run changes nothing.
    identity = {
        "scene": scene.text,
        "observable": observable_name(observable),
        "keys": [axis.key for axis in axes],
        **{key: getattr(simulation, key) for key in ("paths", "time", "relaxations", "seed")},
        "version": program_version(),
    }
    store = PointStore(folder, identity)
    wanted = list(product(*(axis.values.tolist() for axis in axes)))
    todo = [
        partial(map_point, system_at(scene.system, axes, values), observable, values)
        for values in wanted
        if values not in store.points
    ]
    progress(0, len(todo), "points of the map")
    for done, point in enumerate(_finished(todo, simulation), start=1):
        store.add(point)
        progress(done, len(todo), "points of the map")
    points, reused = tuple(store.points[values] for values in wanted), len(wanted) - len(todo)
    seconds = perf_counter() - start
    return RegimeMap(scene, observable, tuple(axes), points, reused, seconds, store.note)


def _finished(todo: Sequence[Callable[..., MapPoint]], method: MonteCarlo) -> Iterator[MapPoint]:
    """Yield the points as they are finished: one after the other, or each a task of a cluster."""
    if method.cluster is None:
        yield from (point(method) for point in todo)
        return
    alone = replace(method, cluster=None, threads=1)
    with connected(method.cluster) as client:
        yield from as_finished(client, [partial(point, alone) for point in todo])


def first_displacement(scene: Scene) -> Observable:
    """Return the first single displacement observed, else the first in a pair."""
    single = [o for o in scene.observables if len(o) == 1 and o[0].kind == "q"]
    pairs = [(c,) for o in scene.observables for c in o if c.kind == "q"]
    return [*single, *pairs, scene.observables[0]][0]
