"""``fpk.sweep``: quantities by several methods over a grid of one or two numbers of a system."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np

from cases.compare.doubt import averaging_notes
from cases.compare.quantity import AVERAGING, RELAXATION, parse_definition
from cases.compare.routes import method_for, methods_of
from cases.scene.errors import BadInput
from cases.scene.numbers import with_numbers
from cases.scene.scene import Scene
from cases.scene.units import NO_UNITS
from cases.show.claim import claimed
from cases.study.sweep.answering import REFERENCE_TOL, SIMULATION, sweep_point
from cases.study.sweep.grid import parse_axes, place_words
from cases.study.sweep.result import PointStore, Sweep, SweepPoint
from fpk.answer.method import Method, Progress, silent
from fpk.answer.names import observable_name
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.machine import usable_cores
from fpk.numeric.recognition import canonical
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.settings import ANYWHERE
from sim.sample.workers import program_checksum, workers_of

METHODS = ("exact", "linear", "nonintegrable", "integrable")
"""Methods that are asked where none is named: they take milliseconds a point."""


def sweep(
    system: System | Scene,
    vary: Mapping[str, str | Sequence[float]] | Sequence[str],
    quantities: Sequence[str],
    *,
    methods: Sequence[str] = (),
    tol: float | None = None,
    simulation: MonteCarlo = SIMULATION,
    reference: str = SIMULATION.route.method,
    folder: Path | None = None,
    progress: Progress = silent,
) -> Sweep:
    """Return ``quantities`` by ``methods`` where one or two numbers of ``system`` are varied.

    ``vary`` has a list of values, or a grid such as "0.1:10:log5", by the path of the number, as
    ``place_of`` reads it; or texts "PATH=GRID". ``quantities`` are those of ``fpk sweep``;
    ``methods`` are names, "nonintegrable" or "nonintegrable/fem", left out ``METHODS``; where one
    does not apply there is no value. ``tol`` is the L1 tolerance of the solvers. "montecarlo" is
    ``simulation``. Averaging errors are L1 distances to the full system's density by ``reference``,
    "montecarlo" or "phase-space", where it is not exact. Finished points are stored in ``folder``,
    from which a sweep goes on. ::

        result = fpk.sweep(system, {"contact[1].clearance": [0.4, 0.5]}, ["rms(q2)"])
        result.field("value")   # (quantity, method, clearance)

    Raises ``InvalidInput`` or ``BadInput`` for what cannot be used, ``NotApplicable`` where a
    method gives none of the quantities anywhere, or a quantity has no value by any.
    """
    result = every_answer(
        system, vary, quantities, methods=methods, tol=tol, simulation=simulation,
        reference=reference, folder=folder, progress=progress,
    )  # fmt: skip
    answers = [answer for point in result.points for answer in point.answers]
    for key, texts in (("method", methods), ("quantity", result.quantities)):
        for text in texts:
            own = [a for a in answers if getattr(a, key) == text]
            if not any(a.said for a in own):
                raise NotApplicable(f"{text}: no value anywhere: {own[0].reason}")
    given = tuple(m for m in result.methods if any(a.method == m and a.said for a in answers))
    return replace(result, methods=given, points=tuple(p.by(given) for p in result.points))


def every_answer(
    system: System | Scene,
    vary: Mapping[str, str | Sequence[float]] | Sequence[str],
    quantities: Sequence[str],
    *,
    methods: Sequence[str],
    tol: float | None = None,
    simulation: MonteCarlo,
    reference: str,
    folder: Path | None,
    progress: Progress,
) -> Sweep:
    """Return the answers of ``sweep`` with those of methods that say nothing anywhere.

    Raises ``InvalidInput`` or ``BadInput`` for what cannot be used.
    """
    start = perf_counter()
    for key, names in (("quantities", quantities), ("methods", methods)):
        if isinstance(names, str) or (not names and key == "quantities"):
            raise InvalidInput(key, names, "must be a list of one or more names")
    if not isinstance(system, System | Scene):
        raise InvalidInput("system", system, 'must be a System or a scene, as fpk.load("fig6a")')
    name, units = (system.name, system.units) if isinstance(system, Scene) else ("", NO_UNITS)
    system = system.system if isinstance(system, Scene) else system
    texts = [
        f"{path}={grid if isinstance(grid, str) else ','.join(map(str, np.ravel(grid).tolist()))}"
        for path, grid in (vary.items() if isinstance(vary, Mapping) else ())
    ]
    axes = parse_axes(texts if isinstance(vary, Mapping) else list(vary), system, units)
    wanted = {str(q): q for q in (parse_definition(text, system) for text in quantities)}
    methods = tuple(dict.fromkeys(methods)) or METHODS
    asked = tuple((method, _candidates(method, tol, simulation)) for method in methods)
    simulated = reference == SIMULATION.route.method
    solver = None if simulated else method_for(reference, tol=REFERENCE_TOL)
    about = {
        "system": system,
        "keys": [axis.key for axis in axes],
        "quantities": [*wanted.values()],
        "methods": asked,
        "reference": solver,
        "simulation": simulation,
        "program": program_checksum(),
    }
    timed = simulation.seconds is not None or simulation.tol is not None
    identity = {} if folder is None else canonical(about, () if timed else ANYWHERE)
    tasks: dict[tuple[float, ...], Callable[[MonteCarlo], SweepPoint]] = {}
    for values in product(*(axis.values.tolist() for axis in axes)):  # the last axis fastest
        numbers = dict(zip((axis.key for axis in axes), values, strict=True))
        try:
            own = with_numbers(system, numbers)
        except InvalidInput as error:
            raise BadInput(f"--vary: at {place_words(axes, values)}: {error}") from None
        tasks[values] = partial(sweep_point, own, values, tuple(wanted.values()), asked, solver)
    sampled = any(m.route.sampled for _, each in asked for m in each)
    against_samples = solver is None and any(q.kind == AVERAGING for q in wanted.values())
    with claimed(folder, identity):
        store = PointStore(folder, identity)
        todo = [task for values, task in tasks.items() if values not in store.points]
        progress(0, len(todo), "points of the grid")
        finished = _finished(todo, simulation, side_by_side=not (sampled or against_samples))
        for done, point in enumerate(finished, start=1):
            store.add(point)
            progress(done, len(todo), "points of the grid")
    points, reused = tuple(store.points[values] for values in tasks), len(tasks) - len(todo)
    of = tuple(units.number(q.kind, observable_name(q.observable)) for q in wanted.values())
    seconds = perf_counter() - start
    given = {(a.quantity, a.method) for p in points for a in p.answers if a.value is not None}
    notes = averaging_notes(system, [
        (text, [m[0].route for method, m in asked if (text, method) in given],
         q.limit is not None or q.kind == RELAXATION)
        for text, q in wanted.items() if q.kind != AVERAGING
    ])  # fmt: skip
    return Sweep(name, axes, tuple(wanted), methods, points, reused, seconds, of, notes)


def _finished(
    todo: Sequence[Callable[[MonteCarlo], SweepPoint]], method: MonteCarlo, *, side_by_side: bool
) -> Iterator[SweepPoint]:
    """Yield the points as they are finished, each a task of a cluster if there is one.

    Else one after the other, as a simulation takes all cores; ``side_by_side``: one on each core.
    """
    alone = replace(method, cluster=None, threads=1)
    if todo and method.cluster is not None:
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


def _candidates(name: str, tol: float | None, simulation: MonteCarlo) -> tuple[Method, ...]:
    """The method by its solvers, its default first; solvers that sample only where they are named.

    ``simulation`` is "montecarlo".
    """
    method, _, solver = name.partition("/")
    own = methods_of(method, solver or None, tol=tol)
    if isinstance(own[0], MonteCarlo):
        return (simulation,)
    return tuple(m for m in own if m.route.sampled == own[0].route.sampled)
