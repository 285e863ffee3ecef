"""The map: a grid of parameters, each point computed once, finished ones taken from disk.

A grid on the command line is ``contact.stiffness=0.01:1000:log25``.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import nan, prod
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cases.comparison.routes import method_for
from cases.output.claim import claimed
from cases.scene.errors import BadInput, toml_value
from cases.scene.scene import Scene
from cases.scene.vary import VARIED, changed
from cases.studies.regime_map.points import MapPoint, PointStore, map_point
from fpk.arrays import Array
from fpk.cores import usable_cores
from fpk.errors import InvalidInput
from fpk.method import Progress, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.montecarlo import MonteCarlo
from sim.workers import workers_of

KEYS = {"contact.stiffness": "contact stiffness $B$", "contact.clearance": "clearance $δ$"}
"""Keys of a scene that a map may vary, all of them numbers, with the label of their axis."""
MAX_POINTS = 2000
"""Points of a map; each is a simulation of about a second."""
LARGEST = 1e100
"""Largest size of an end of a grid: its square is still a number."""
SIMULATION = MonteCarlo(relaxations=38.0)
"""Simulation of a point: with 38 relaxation times a path the sampling error of the L1 distance of
one displacement is about 0.001."""
REFERENCE_TOL = 2e-4
"""L1 error wanted of a reference that is not sampled: a fifth of what the simulation leaves."""


@dataclass(frozen=True, eq=False)
class Axis:
    """One parameter and the values that it takes; ``symbol`` is its letter, such as B."""

    key: str
    symbol: str
    values: Array
    logarithmic: bool


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
            ", ".join(f"{a.symbol} = {v:g}" for a, v in zip(self.axes, p.values, strict=True))
            + f": {words}"
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
    # Where and by how many threads a simulation is run changes nothing.
    identity = {
        "scene": scene.text,
        "observable": observable_name(observable),
        "keys": [axis.key for axis in axes],
        "reference": reference,
        **{key: getattr(simulation, key) for key in ("paths", "time", "relaxations", "seed")},
    }
    simulated = reference == simulation.route.method
    solver = None if simulated else method_for(reference, tol=REFERENCE_TOL)
    with claimed(folder, identity):
        store = PointStore(folder, identity)
        wanted = list(product(*(axis.values.tolist() for axis in axes)))
        todo = []
        for values in [v for v in wanted if v not in store.points]:
            system = scene.system
            for axis, value in zip(axes, values, strict=True):
                system = changed(system, axis.key, value)
            todo.append(partial(map_point, system, observable, values, solver))
        progress(0, len(todo), "points of the map")
        finished = _finished(todo, simulation, side_by_side=not simulated)
        for done, point in enumerate(finished, start=1):
            store.add(point)
            progress(done, len(todo), "points of the map")
    points, reused = tuple(store.points[values] for values in wanted), len(wanted) - len(todo)
    seconds = perf_counter() - start
    return RegimeMap(scene, observable, tuple(axes), points, reused, seconds)


def _finished(
    todo: Sequence[Callable[..., MapPoint]], method: MonteCarlo, *, side_by_side: bool
) -> Iterator[MapPoint]:
    """Yield the points as they are finished, each a task of a cluster if there is one.

    Else one after the other, as a simulation takes all cores; ``side_by_side``: one on each core.
    """
    alone = replace(method, cluster=None, threads=1)
    if method.cluster is not None:
        with workers_of(method.cluster) as workers:
            yield from workers.as_finished([partial(point, alone) for point in todo])
    elif side_by_side:
        pool = ThreadPoolExecutor(usable_cores())
        try:
            for future in as_completed([pool.submit(point, alone) for point in todo]):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    else:
        yield from (point(method) for point in todo)


def parse_axes(texts: Sequence[str], system: System) -> tuple[Axis, ...]:
    """Return one or two axes; raise ``BadInput`` for what cannot be used of them."""
    if not 1 <= len(texts) <= 2:
        raise BadInput(f"--vary is given {len(texts)} times; give one parameter or two")
    axes = tuple(map(_axis, texts))
    if len({a.key for a in axes}) != len(axes):
        raise BadInput(f'--vary "{texts[1]}": {axes[0].key} is varied already')
    if (count := prod(a.values.size for a in axes)) > MAX_POINTS:
        raise BadInput(f"--vary: the grid has {count} points; at most {MAX_POINTS}")
    if not system.contacts:
        raise BadInput(f"--vary {axes[0].key}: the scene has no [[contact]] to vary")
    for axis, text in zip(axes, texts, strict=True):
        for value in axis.values.tolist():
            try:
                changed(system, axis.key, value)
            except InvalidInput as error:
                raise _wrong(text, f"{value:g} {error.remedy}") from None
    return axes


def _axis(text: str) -> Axis:
    match = re.fullmatch(r"([^=]+?) *= *([^:]+):([^:]+):(log)?([0-9]{1,5})", text.strip())
    if match is None or match[1] not in KEYS:
        grid = "low:high:count, or =low:high:logCOUNT for equal ratios"
        raise _wrong(text, f"write one of {', '.join(KEYS)}, then ={grid}")
    try:
        low, high = float(match[2]), float(match[3])
    except ValueError:
        low = high = nan
    key, logarithmic, count = match[1], match[4] is not None, int(match[5])
    for holds, remedy in (
        (abs(low) <= LARGEST and abs(high) <= LARGEST, "both ends must be finite numbers"),
        (low < high, f"{low:g} is not below {high:g}"),
        (2 <= count <= MAX_POINTS, f"a count of {count} cannot be used; use 2 to {MAX_POINTS}"),
        (low > 0 or not logarithmic, "equal ratios need a low end > 0"),
    ):
        if not holds:
            raise _wrong(text, remedy)
    values = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
    # Twelve digits: the same grid point has the same value on any grid that contains it.
    rounded = np.array([float(f"{v:.12g}") for v in values])
    return Axis(key, VARIED[key], rounded, logarithmic)


def _wrong(text: str, remedy: str) -> BadInput:
    return BadInput(f"--vary {toml_value(text)}: {remedy}")
