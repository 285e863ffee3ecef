"""``fpk.sweep``: quantities by several methods over a grid of one or two numbers of a system."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from cases.comparison.routes import methods_of
from cases.scene.scene import Scene
from cases.studies.sweep.answering import sweep_point
from cases.studies.sweep.grid import computed, parse_axes
from cases.studies.sweep.quantity import AVERAGING, parse_quantity
from cases.studies.sweep.reference import SIMULATION, settings_of, solver_of
from cases.studies.sweep.result import Sweep, SweepPoint
from fpk.errors import InvalidInput, NotApplicable
from fpk.method import Method, Progress, silent
from fpk.system import System
from sim.montecarlo import MonteCarlo

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
    start = perf_counter()
    for key, given in (("quantities", quantities), ("methods", methods)):
        if isinstance(given, str) or (not given and key == "quantities"):
            raise InvalidInput(key, given, "must be a list of one or more names")
    if not isinstance(system, System | Scene):
        raise InvalidInput("system", system, 'must be a System or a scene, as fpk.load("fig6a")')
    name, system = (system.name, system.system) if isinstance(system, Scene) else ("", system)
    axes = parse_axes(_texts(vary), system)
    wanted = {str(q): q for q in (parse_quantity(text, system) for text in quantities)}
    names = tuple(dict.fromkeys(methods)) or METHODS
    asked = tuple((method, _candidates(method, tol, simulation)) for method in names)
    solver = solver_of(reference)
    identity = {
        "system": {f.name: getattr(system, f.name) for f in fields(system) if f.init},
        "keys": [axis.key for axis in axes],
        "quantities": list(wanted),
        "methods": names,
        "tol": tol,
        "reference": reference,
        **settings_of(simulation),
    }

    def task(system: System, values: tuple[float, ...]) -> Callable[[MonteCarlo], SweepPoint]:
        return partial(sweep_point, system, values, tuple(wanted.values()), asked, solver)

    sampled = any(m.route.sampled for _, own in asked for m in own)
    against_samples = solver is None and any(q.kind == AVERAGING for q in wanted.values())
    points, reused = computed(
        system, axes, task, SweepPoint.read, identity=identity, simulation=simulation,
        side_by_side=not (sampled or against_samples), folder=folder, progress=progress,
    )  # fmt: skip
    answers = [answer for point in points for answer in point.answers]
    for key, texts in (("method", methods), ("quantity", wanted)):
        for text in texts:
            own = [a for a in answers if getattr(a, key) == text]
            if not any(a.said for a in own):
                raise NotApplicable(f"{text}: no value anywhere: {own[0].reason}")
    given = [m for m in names if any(a.method == m and a.said for a in answers)]
    points = tuple(point.by(given) for point in points)
    seconds = perf_counter() - start
    return Sweep(name, axes, tuple(wanted), tuple(given), points, reused, seconds)


def _texts(vary: Mapping[str, str | Sequence[float]] | Sequence[str]) -> list[str]:
    if not isinstance(vary, Mapping):
        return list(vary)
    return [
        f"{path}={grid if isinstance(grid, str) else ','.join(map(str, np.ravel(grid).tolist()))}"
        for path, grid in vary.items()
    ]


def _candidates(name: str, tol: float | None, simulation: MonteCarlo) -> tuple[Method, ...]:
    """The method by its solvers, its default first; solvers that sample only where they are named.

    ``simulation`` is "montecarlo".
    """
    method, _, solver = name.partition("/")
    own = methods_of(method, solver or None, tol=tol)
    if isinstance(own[0], MonteCarlo):
        return (simulation,)
    return tuple(m for m in own if m.route.sampled == own[0].route.sampled)
