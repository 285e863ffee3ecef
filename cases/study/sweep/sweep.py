"""Sweeps: quantities by several methods over a grid of one or two numbers of a system."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from cases.compare.doubt import averaging_notes
from cases.compare.quantity import AVERAGING, RELAXATION, parse_definition
from cases.compare.routes import method_for, methods_of
from cases.scene.errors import BadInput
from cases.scene.numbers import with_numbers
from cases.scene.scene import Scene
from cases.scene.units import NO_UNITS, attribute, in_brackets
from cases.show.claim import claim_folder
from cases.show.pictures.draw import study_figure
from cases.show.pictures.panel import Field, Panel, curves_over, spans_decades
from cases.show.records import Record
from cases.show.study_page import Page, Table
from cases.show.variables import Axis, Variables
from cases.show.words import reader_words, stationary_note
from cases.study.sweep.answering import REFERENCE_TOL, SIMULATION, sweep_point
from cases.study.sweep.grid import parse_axes, place_words
from cases.study.sweep.points import PointStore, SweepPoint
from fpk.answer.method import Method, Progress, silent
from fpk.answer.names import observable_name
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.machine import usable_cores
from fpk.numeric.recognition import canonical
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.settings import ANYWHERE
from sim.sample.workers import program_checksum, workers_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHODS = ("exact", "linear", "nonintegrable", "integrable")
"""Methods of a sweep that names none: they take milliseconds a point."""


@dataclass(frozen=True, repr=False)
class Sweep:
    """Quantities by methods over a grid of one or two parameters.

    ``scene`` is None for a system that was given without one. ``points`` has the points of the
    grid, the last axis varying fastest; ``reused`` counts the points read from disk,
    and ``seconds`` is the wall time of all. ``units`` has a text for each of ``quantities``, empty
    if the scene has no ``[units]``; ``solves`` one for each of ``methods``: "full" for the full
    system, "averaged" for an averaged equation, whose averaging error is in no ``error``.
    ``averaging_notes`` name the quantities that no method gives of the full system, and say of the
    system before anything is varied when to doubt them.

    An example::

        result = fpk.sweep(system, {"contact[1].clearance": "0.4:0.6:3"}, ["rms(q2)"])
        result.field("value"), result.field("error"), result.problems, result.to_xarray()
        result.plot()
    """

    scene: Scene | None
    axes: tuple[Axis, ...]
    quantities: tuple[str, ...]
    methods: tuple[str, ...]
    points: tuple[SweepPoint, ...]
    reused: int
    seconds: float
    units: tuple[str, ...]
    solves: tuple[str, ...]
    averaging_notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of the scene, empty without one."""
        return self.scene.name if self.scene else ""

    @property
    def problems(self) -> tuple[str, ...]:
        """Each answer that failed or is not certified, in words that begin with its grid point."""
        return tuple(
            f"{place_words(self.axes, p.values)}: {words}"
            for p in self.points
            for words in p.problems
        )

    def record(self) -> Record:
        """Return the fields for JSON by ``plain``: "scene" is its name, an empty unit None."""
        own = {key: value for key, value in vars(self).items() if key != "scene"}
        axes = [{"key": a.key, "unit": a.unit or None, "values": a.values} for a in self.axes]
        own["units"] = [unit or None for unit in self.units]
        return {"scene": self.name, **own, "axes": axes}

    def field(self, key: str) -> Any:
        """Return field ``key`` of every ``Value``, (quantity, method, axes); NaN for no number."""
        sizes = [axis.values.size for axis in self.axes]
        rows = [[getattr(answer, key) for answer in point.answers] for point in self.points]
        kind = float if key in ("value", "error") else None
        array = np.array(rows, dtype=kind).T
        return array.reshape(len(self.quantities), len(self.methods), *sizes)

    def heads(self) -> list[str]:
        """Return the paths of the parameters with their units."""
        return [axis.key + in_brackets(axis.unit) for axis in self.axes]

    def labels(self) -> list[str]:
        """Return the quantities with their units."""
        return [q + in_brackets(unit) for q, unit in zip(self.quantities, self.units, strict=True)]

    def coordinates(self) -> Variables:
        """Return the parameters as variables of their own dimensions."""
        return {
            a.dimension: (
                (a.dimension,),
                a.values,
                {"units": attribute(a.unit), "symbol": a.symbol},
            )
            for a in self.axes
        }

    def variables(self) -> Variables:
        """Return ``value``, ``error``, ``error_kind``, ``certified`` (quantity, route, axes).

        Also ``unit`` (quantity), ``solves`` (route), the names ``quantity`` and ``route``, and the
        coordinates; all by name, as (dimensions, array, attributes).
        """
        dimensions = ("quantity", "route", *(axis.dimension for axis in self.axes))
        words = "an estimate of the numerical error or one standard error, as error_kind says"
        return {
            "quantity": (dimensions[:1], np.array(self.quantities), {}),
            "route": (dimensions[1:2], np.array(self.methods), {}),
            **self.coordinates(),
            "unit": (dimensions[:1], np.array([attribute(u) for u in self.units]), {}),
            "value": (dimensions, self.field("value"), {"long_name": "in units as unit says"}),
            "error": (dimensions, self.field("error"), {"long_name": words}),
            "error_kind": (dimensions, self.field("error_kind"), {}),
            "solves": (dimensions[1:2], np.array(self.solves), {}),
            "certified": (dimensions, self.field("certified").astype(np.int8), {}),
        }

    def table(self, remarks: tuple[str, ...] = ()) -> Table:
        """Return every value with its error, in the order of the grid."""
        labels = dict(zip(self.quantities, self.labels(), strict=True))
        solves = dict(zip(self.methods, self.solves, strict=True))
        rows = [
            {
                **dict(zip(self.heads(), p.values, strict=True)),
                "quantity": labels[a.quantity],
                "method": a.method,
                "solves": solves[a.method],
                "value": a.value,
                "error": a.error,
                "kind": a.error_kind,
                "certified": ("no", "yes")[a.certified] if a.value is not None else "",
            }
            for p in self.points
            for a in p.answers
        ]
        return Table("points", "Values", rows, remarks, parameters=len(self.axes))

    def page(self) -> Page:
        """Return what ``fpk sweep`` shows and writes: every value, as a table and as a picture.

        Needs a ``scene``.
        """
        assert self.scene is not None
        reasons = dict.fromkeys(
            f"{a.quantity} by {a.method}: {a.reason}"
            for p in self.points
            for a in p.answers
            if a.reason
        )
        summary = (
            f"{', '.join(self.quantities)} by {'; '.join(map(reader_words, self.methods))}:"
            f" {len(self.points)} points ({self.reused} from disk)"
        )
        system = self.scene.system
        both = [q for q in self.quantities if len(parse_definition(q, system).stops(system)) > 1]
        remarks = [
            summary,
            "An error is an estimate of the numerical error, or one standard error of sampling.",
            f"{', '.join(both)}: of both sides of the contact, added up; one side is"
            f" {both[0].replace(')', ',left)')}."
            if both
            else "",
            stationary_note(system),
            *map(reader_words, self.averaging_notes),
            "averaging error not measured: add --method montecarlo, or --method phase-space, which"
            " may take minutes a point."
            if self.averaging_notes
            else "",
            *reasons,
        ]
        return Page(
            "result",
            self.scene,
            f"Sweep of {', '.join(a.key for a in self.axes)}: {self.scene.title}",
            [self.table(tuple(filter(None, remarks)))],
            self.panels(),
            summary=summary,
            gridded=self.variables(),
        )

    def panels(self) -> list[Panel] | list[Field]:
        """Return a panel for each quantity, over two axes one for each method with a value."""
        values, errors = self.field("value"), self.field("error")
        names = list(map(reader_words, self.methods))
        each = zip(self.labels(), values, errors, strict=True)
        if len(self.axes) == 1:
            (axis,) = self.axes
            return [
                Panel(
                    quantity.partition(" [")[0],
                    axis.label,
                    quantity,
                    curves_over(axis, names, own, bars),
                    logarithmic=axis.logarithmic,
                    y_logarithmic=spans_decades(own),
                    by_x=True,
                )
                for quantity, own, bars in each
            ]
        return [
            Field(
                f"{quantity} by {name}",
                self.axes[0],
                self.axes[1],
                one,
                bar,
                logarithmic=spans_decades(own),
                limits=(float(np.nanmin(own)), float(np.nanmax(own))),
            )
            for quantity, own, bars in each
            for name, one, bar in zip(names, own, bars, strict=True)
            if np.isfinite(one).any()
        ]

    def plot(self) -> "Figure":
        """Return a figure of every quantity: lines over one axis, heat pictures over two."""
        return study_figure(self.panels())

    def _repr_html_(self) -> str:
        """Return the values as a table, for a notebook."""
        return str(self.table().html())

    def to_xarray(self) -> Any:
        """Return ``variables`` as an ``xarray.Dataset``; raise ``ImportError`` without xarray."""
        from xarray import Dataset  # noqa: PLC0415  (optional)

        return Dataset(self.variables(), attrs={"scene": self.name})

    def __repr__(self) -> str:
        """Return quantities, methods and the sizes of the axes in one line."""
        where = ", ".join(f"{a.key} ({a.values.size})" for a in self.axes)
        return f"Sweep({', '.join(self.quantities)} by {', '.join(self.methods)} over {where})"


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
    silent_methods: bool = False,
) -> Sweep:
    """Return ``quantities`` by ``methods`` where one or two numbers of ``system`` are varied.

    ``vary`` has a list of values, or a grid such as "0.1:10:log5", by the path of the number, as
    ``place_of`` reads it; or texts "PATH=GRID". ``quantities`` are named as in ``fpk sweep``;
    ``methods`` are names, "nonintegrable" or "nonintegrable/fem", left out: all of ``METHODS`` that
    apply at some point; where one does not apply there is no value. ``tol`` is the L1 tolerance of
    the solvers. "montecarlo" is ``simulation``. Averaging errors are L1 distances to the full
    system's density by ``reference``, "montecarlo" or "phase-space", where it is not exact.
    Finished points are stored in ``folder``, from which a sweep goes on. ::

        result = fpk.sweep(system, {"contact[1].clearance": [0.4, 0.5]}, ["rms(q2)"])
        result.field("value")   # (quantity, method, clearance)

    Raises ``InvalidInput`` or ``BadInput`` for arguments that cannot be used; unless
    ``silent_methods`` are allowed ``NotApplicable``, if a named method gives none of the quantities
    at any point, or if a quantity has no value by any method.
    """
    start = perf_counter()
    for key, given in (("quantities", quantities), ("methods", methods)):
        if isinstance(given, str) or (not given and key == "quantities"):
            raise InvalidInput(key, given, "must be a list of one or more names")
    if not isinstance(system, System | Scene):
        raise InvalidInput("system", system, 'must be a System or a scene, as fpk.load("fig6a")')
    scene = system if isinstance(system, Scene) else None
    units = scene.units if scene else NO_UNITS
    system = system.system if isinstance(system, Scene) else system
    texts = [
        f"{path}={grid if isinstance(grid, str) else ','.join(map(str, np.ravel(grid).tolist()))}"
        for path, grid in (vary.items() if isinstance(vary, Mapping) else ())
    ]
    axes = parse_axes(texts if isinstance(vary, Mapping) else list(vary), system, units)
    wanted = {str(q): q for q in (parse_definition(text, system) for text in quantities)}
    names = tuple(dict.fromkeys(methods)) or METHODS
    asked = tuple((method, _solvers_of(method, tol, simulation)) for method in names)
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
    with claim_folder(folder, identity):
        store = PointStore(folder, identity)
        todo = [task for values, task in tasks.items() if values not in store.points]
        progress(0, len(todo), "points of the grid")
        finished = _finish_points(todo, simulation, side_by_side=not (sampled or against_samples))
        for done, point in enumerate(finished, start=1):
            store.add(point)
            progress(done, len(todo), "points of the grid")
    points = tuple(store.points[values] for values in tasks)
    answers = [answer for point in points for answer in point.answers]
    if not silent_methods:
        asked_for = [("method", m) for m in methods] + [("quantity", q) for q in wanted]
        for key, text in asked_for:
            of_it = [a for a in answers if getattr(a, key) == text]
            if not any(a.applies for a in of_it):
                raise NotApplicable(f"{text}: no value anywhere: {of_it[0].reason}")
        names = tuple(m for m in names if any(a.method == m and a.applies for a in answers))
    valued = {(a.quantity, a.method) for a in answers if a.value is not None}
    routes = {method: each[0].route for method, each in asked}
    by_quantity = [
        (
            text,
            [route for method, route in routes.items() if (text, method) in valued],
            q.limit is not None or q.kind == RELAXATION,
        )
        for text, q in wanted.items()
        if q.kind != AVERAGING
    ]
    return Sweep(
        scene=scene,
        axes=axes,
        quantities=tuple(wanted),
        methods=names,
        points=tuple(p.by(names) for p in points),
        reused=len(tasks) - len(todo),
        seconds=perf_counter() - start,
        units=tuple(units.number(q.kind, observable_name(q.observable)) for q in wanted.values()),
        solves=tuple(routes[method].solves for method in names),
        averaging_notes=averaging_notes(system, by_quantity),
    )


def _finish_points(
    todo: Sequence[Callable[[MonteCarlo], SweepPoint]], method: MonteCarlo, *, side_by_side: bool
) -> Iterator[SweepPoint]:
    """Yield the points as they are finished, each a task of a cluster if there is one.

    Else one after the other, as a simulation takes all cores; ``side_by_side``: one on each core.
    """
    alone = replace(method, cluster=None, threads=1)
    if todo and (side_by_side or method.cluster is not None):
        with workers_of(method.cluster, usable_cores()) as workers:
            yield from workers.as_finished([partial(point, alone) for point in todo])
    else:
        yield from (point(method) for point in todo)


def _solvers_of(name: str, tol: float | None, simulation: MonteCarlo) -> tuple[Method, ...]:
    """Return the method ``name`` by each of its solvers, the default first, to the L1 ``tol``.

    Solvers that sample are left out unless named. ``simulation`` is the method "montecarlo".
    """
    method, _, solver = name.partition("/")
    own = methods_of(method, solver or None, tol=tol)
    if isinstance(own[0], MonteCarlo):
        return (simulation,)
    return tuple(m for m in own if m.route.sampled == own[0].route.sampled)
