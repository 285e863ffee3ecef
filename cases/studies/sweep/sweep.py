"""The sweep: quantities by several routes over a grid of one or two numbers of a system."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cases.comparison.answers import answers_of
from cases.comparison.compare import distance_between
from cases.comparison.rare import passage_answer
from cases.comparison.refusal import REFUSALS
from cases.comparison.routes import methods_of
from cases.output.records import Record
from cases.output.time_fields import Variables
from cases.scene.questions import PassageQuestion
from cases.scene.scene import Scene
from cases.studies.sweep.grid import Axis, computed, parse_axes, place_words
from cases.studies.sweep.quantity import AVERAGING, PASSAGE, Quantity, parse_quantity
from cases.studies.sweep.reference import SIMULATION, reference_of, settings_of, solver_of
from fpk.density import AnyDensity
from fpk.errors import InvalidInput, NotApplicable
from fpk.evolution import Passage, Passages
from fpk.method import Method, Progress, silent
from fpk.number import Number
from fpk.observable import Observable, observable_name
from fpk.start import REST
from fpk.system import System
from sim.montecarlo import MonteCarlo

METHODS = ("exact", "linear", "nonintegrable", "integrable")
"""Methods that are asked where none is named: they take milliseconds a point."""


@dataclass(frozen=True)
class Value:
    """A quantity by one method with its error; no value where ``reason`` says why not.

    ``error_kind`` is "numerical" or "sampling"; ``failures`` say why it is not ``certified``;
    ``failed`` where the method applies and did not succeed.
    """

    quantity: str
    method: str
    value: float | None = None
    error: float | None = None
    error_kind: str = ""
    certified: bool = False
    failures: tuple[str, ...] = ()
    reason: str = ""
    failed: bool = False


@dataclass(frozen=True)
class SweepPoint:
    """The answers at one point of the grid: methods fastest, in the order asked for."""

    values: tuple[float, ...]
    answers: tuple[Value, ...]
    seconds: float

    @classmethod
    def read(cls, record: Record) -> "SweepPoint":
        """Return the point of its record in JSON."""
        own = [Value(**{**r, "failures": tuple(r["failures"])}) for r in record["answers"]]
        return cls(tuple(record["values"]), tuple(own), record["seconds"])


@dataclass(frozen=True, repr=False)
class Sweep:
    """Quantities by methods over a grid, its last axis fastest; ``reused`` are from disk."""

    name: str
    axes: tuple[Axis, ...]
    quantities: tuple[str, ...]
    methods: tuple[str, ...]
    points: tuple[SweepPoint, ...]
    reused: int
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """What failed or is not certified at a point, in words that begin with its place."""
        return tuple(
            f"{place_words(self.axes, p.values)}: {a.quantity} by {a.method} {words}"
            for p in self.points
            for a in p.answers
            for words in (
                *(f"is not certified: {failure}" for failure in a.failures),
                *([f"failed: {a.reason}"] if a.failed else []),
            )
        )

    def record(self) -> Record:
        """Return the record of ``fpk sweep`` as ``plain`` takes it."""
        own = {key: value for key, value in vars(self).items() if key != "name"}
        axes = [{"key": a.key, "values": a.values} for a in self.axes]
        return {"scene": self.name, **own, "axes": axes}

    def field(self, key: str) -> Any:
        """Return ``key`` of all values, (quantity, method, *axes); numbers that are not: NaN."""
        sizes = [axis.values.size for axis in self.axes]
        rows = [[getattr(answer, key) for answer in point.answers] for point in self.points]
        kind = float if key in ("value", "error") else None
        array = np.array(rows, dtype=kind).T
        return array.reshape(len(self.quantities), len(self.methods), *sizes)

    def variables(self) -> Variables:
        """Return ``value``, ``error``, ``error_kind``, ``certified`` (quantity, route, *axes)."""
        dimensions = ("quantity", "route", *(axis.dimension for axis in self.axes))
        words = "an estimate of the numerical error or one standard error, as error_kind says"
        return {
            "quantity": (dimensions[:1], np.array(self.quantities), {}),
            "route": (dimensions[1:2], np.array(self.methods), {}),
            **{a.dimension: ((a.dimension,), a.values, {"long_name": a.symbol}) for a in self.axes},
            "value": (dimensions, self.field("value"), {}),
            "error": (dimensions, self.field("error"), {"long_name": words}),
            "error_kind": (dimensions, self.field("error_kind"), {}),
            "certified": (dimensions, self.field("certified").astype(np.int8), {}),
        }

    def to_xarray(self) -> Any:
        """Return ``variables`` as an ``xarray.Dataset``; needs the package xarray."""
        from xarray import Dataset  # noqa: PLC0415  (optional)

        return Dataset(self.variables(), attrs={"scene": self.name})

    def __repr__(self) -> str:
        """Return what was computed where in one line."""
        where = ", ".join(f"{a.key} ({a.values.size})" for a in self.axes)
        return f"Sweep({', '.join(self.quantities)} by {', '.join(self.methods)} over {where})"


Asked = tuple[str, tuple[Method, ...]]
"""The name of a method and its solvers in the order in which they are tried."""


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
    ``place_of`` reads it; or texts "PATH=GRID". ``quantities`` as ``fpk.quantity.FORMS`` shows;
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
    name, system = (system.name, system.system) if isinstance(system, Scene) else ("", system)
    axes = parse_axes(_texts(vary), system)
    wanted = {str(q): q for q in (parse_quantity(text, system) for text in quantities)}
    if not wanted:
        raise InvalidInput("quantities", quantities, 'must name one or more, as ["rms(q2)"]')
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
            if all(a.value is None and not a.failed for a in own):
                raise NotApplicable(f"{text}: no value anywhere: {own[0].reason}")
    given = [
        m
        for m in names
        if any(a.method == m and (a.value is not None or a.failed) for a in answers)
    ]
    points = tuple(
        SweepPoint(p.values, tuple(a for a in p.answers if a.method in given), p.seconds)
        for p in points
    )
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


def sweep_point(
    system: System,
    values: tuple[float, ...],
    quantities: tuple[Quantity, ...],
    asked: Sequence[Asked],
    solver: Method | None,
    simulation: MonteCarlo,
) -> SweepPoint:
    """Return all quantities of ``system`` by the methods ``asked``; ``solver`` of the reference."""
    start, references = perf_counter(), dict[Observable, Any]()

    def reference(observable: Observable) -> Any:
        if observable not in references:
            problems: list[str] = []
            found = reference_of(system, observable, solver, simulation, problems)
            references[observable] = found, problems
        return references[observable]

    columns = []
    for name, own in asked:
        methods = [simulation if isinstance(m, MonteCarlo) else m for m in own]
        columns.append(list(_values(name, methods, system, quantities, reference)))
    rows = zip(*columns, strict=True)
    answers = tuple(answer for row in rows for answer in row)
    return SweepPoint(values, answers, perf_counter() - start)


def _values(
    name: str,
    methods: Sequence[Method],
    system: System,
    quantities: Sequence[Quantity],
    reference: Callable[[Observable], Any],
) -> Iterator[Value]:
    """Yield the quantities by one method, whose densities are solved for together."""
    averaged = methods[0].route.solves == "averaged"
    wanted = [
        q.observable for q in quantities if q.limit is None and (averaged or q.kind != AVERAGING)
    ]
    densities, refusals = _densities(methods, system, list(dict.fromkeys(wanted)))
    passages: dict[str, Any] = {}
    for quantity in quantities:
        no = partial(Value, str(quantity), name)
        if quantity.limit is not None:
            limit = str(quantity.limit)
            if limit not in passages:
                passages[limit] = _passage(methods, system, quantity)
            answer = passages[limit]
            if not isinstance(answer, Passage):
                yield no(reason=answer[0], failed=answer[1])
                continue
            number = getattr(answer, PASSAGE[quantity.kind])
            yield _value(no, number, answer.error_kind, answer.certificate.failures)
        elif quantity.kind == AVERAGING and not averaged:
            yield no(reason="is no averaged theory")
        elif quantity.observable not in densities:
            reason, failed = refusals[observable_name(quantity.observable)]
            yield no(reason=reason, failed=failed)
        elif quantity.kind == AVERAGING:
            own = densities[quantity.observable]
            found, problems = reference(quantity.observable)
            if found is None:
                yield no(reason="; ".join(problems) or "no reference", failed=True)
                continue
            L1, error, _ = distance_between(own, found[1])
            kinds = {own.error_kind, found[1].error_kind}
            failures = (*own.certificate.failures, *problems)
            kind = "sampling" if "sampling" in kinds else "numerical"
            yield _value(no, Number(L1, error), kind, failures)
        else:
            density = densities[quantity.observable]
            number = quantity.of(density, system)
            yield _value(no, number, density.error_kind, density.certificate.failures)


def _value(
    no: Callable[..., Value], number: Number | None, kind: str, failures: tuple[str, ...]
) -> Value:
    """The value of a number; none where there is no number, or its error has no bound."""
    if number is None or not (isfinite(number.value) and isfinite(number.error)):
        return no(reason="the method gives no such number with an error that has a bound")
    return no(number.value, number.error, kind, not failures, tuple(dict.fromkeys(failures)))


def _densities(
    methods: Sequence[Method], system: System, wanted: Sequence[Observable]
) -> tuple[dict[Observable, AnyDensity], dict[str, tuple[str, bool]]]:
    """The densities by the first of ``methods`` that certifies each; by name why there is none."""
    densities: dict[Observable, AnyDensity] = {}
    refusals: dict[str, tuple[str, bool]] = {}
    for method in methods:
        certified = {o for o, d in densities.items() if d.certificate.certified}
        if missing := [o for o in wanted if o not in certified]:
            answers = answers_of(system, missing, [method])
            for density in (d for r in answers.results for d in r.densities):
                if density.certificate.certified or density.observable not in densities:
                    densities[density.observable] = density
            for refusal in answers.refused:
                for name in refusal.observables:
                    refusals.setdefault(name, (refusal.reason, refusal.failed))
    return densities, refusals


def _passage(
    methods: Sequence[Method], system: System, quantity: Quantity
) -> Passage | tuple[str, bool]:
    """The first passage from rest by the first of ``methods`` that gives it, or why none does."""
    assert quantity.limit is not None
    question, refusals = PassageQuestion(quantity.limit, REST, ()), list[tuple[str, bool]]()
    for method in methods:
        if isinstance(method, Passages):
            try:
                return passage_answer(method, system, question, tol=None, progress=silent)
            except REFUSALS as error:
                refusals.append((str(error), not isinstance(error, NotApplicable)))
    return refusals[0] if refusals else ("gives no first passage", False)
