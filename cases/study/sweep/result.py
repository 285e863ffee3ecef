"""The answers of a sweep: point by point, as labelled arrays, and on disk, a JSON line each."""

import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib import import_module
from os.path import lexists
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cases.scene.errors import BadInput
from cases.scene.scene import read_text
from cases.scene.units import attribute, bracketed
from cases.show.files import write_text
from cases.show.records import Record, plain
from cases.show.variables import Axis, Variables
from cases.study.sweep.grid import place_words
from fpk.numeric.recognition import fingerprint

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Value:
    """A quantity by one method: ``value`` ± ``error``, both None where the method gave none.

    ``error_kind`` is "numerical" (``error`` is an estimate of it) or "sampling" (one standard
    error). ``failures`` has the reasons why a value is not ``certified``, ``reason`` why there is
    no value; ``failed`` is True where the method applies and did not succeed. ``reference`` is the
    route that solved the full system, where the quantity is an averaging error: the distance to it.
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
    reference: str = ""

    @property
    def said(self) -> bool:
        """Whether the method applies: there is a value, or ought to be."""
        return self.value is not None or self.failed


@dataclass(frozen=True)
class SweepPoint:
    """The answers at one point of the grid, for each quantity by every method in turn."""

    values: tuple[float, ...]
    answers: tuple[Value, ...]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Each answer that failed or is not certified, in words."""
        return tuple(
            f"{a.quantity} by {a.method} {words}"
            for a in self.answers
            for words in (
                *(f"is not certified: {failure}" for failure in a.failures),
                *([f"failed: {a.reason}"] if a.failed else []),
            )
        )

    @classmethod
    def read(cls, record: Record) -> "SweepPoint":
        """Return the point of its record in JSON."""
        own = [Value(**{**r, "failures": tuple(r["failures"])}) for r in record["answers"]]
        return cls(tuple(record["values"]), tuple(own), record["seconds"])

    def by(self, methods: Sequence[str]) -> "SweepPoint":
        """Return the point with the answers of ``methods`` alone."""
        return replace(self, answers=tuple(a for a in self.answers if a.method in methods))


@dataclass(frozen=True, repr=False)
class Sweep:
    """Quantities by methods over a grid of one or two parameters.

    ``points`` has the points of the grid, those of the last axis next to each other; ``reused``
    counts those that were read from disk, and ``seconds`` is the time all took. ``units`` has one
    for each of ``quantities``, an empty text where the scene has no ``[units]``.
    ``averaging_notes`` say of the system before anything is varied when to doubt quantities that
    no method gives of the full system.

    An example::

        result = fpk.sweep(system, {"contact[1].clearance": "0.4:0.6:3"}, ["rms(q2)"])
        result.field("value"), result.field("error"), result.problems, result.to_xarray()
        result.plot()
    """

    name: str
    axes: tuple[Axis, ...]
    quantities: tuple[str, ...]
    methods: tuple[str, ...]
    points: tuple[SweepPoint, ...]
    reused: int
    seconds: float
    units: tuple[str, ...]
    averaging_notes: tuple[str, ...] = ()

    @property
    def problems(self) -> tuple[str, ...]:
        """Each answer that failed or is not certified, in words that begin with its grid point."""
        return tuple(
            f"{place_words(self.axes, p.values)}: {words}"
            for p in self.points
            for words in p.problems
        )

    def record(self) -> Record:
        """Return the record of ``fpk sweep`` as ``plain`` takes it."""
        own = {key: value for key, value in vars(self).items() if key != "name"}
        axes = [{"key": a.key, "unit": a.unit or None, "values": a.values} for a in self.axes]
        own["units"] = [unit or None for unit in self.units]
        return {"scene": self.name, **own, "axes": axes}

    def field(self, key: str) -> Any:
        """Return ``key`` of all values, (quantity, method, axes); numbers that are not: NaN."""
        sizes = [axis.values.size for axis in self.axes]
        rows = [[getattr(answer, key) for answer in point.answers] for point in self.points]
        kind = float if key in ("value", "error") else None
        array = np.array(rows, dtype=kind).T
        return array.reshape(len(self.quantities), len(self.methods), *sizes)

    def labels(self) -> list[str]:
        """Return the quantities with their units."""
        return [q + bracketed(unit) for q, unit in zip(self.quantities, self.units, strict=True)]

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
        """Return ``value``, ``error``, ``error_kind``, ``certified`` (quantity, route, axes)."""
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
            "certified": (dimensions, self.field("certified").astype(np.int8), {}),
        }

    def plot(self) -> "Figure":
        """Return a figure of every quantity: lines over one axis, heat pictures over two."""
        study_figure = import_module("cases.show.pictures.draw").study_figure
        figure: Figure = study_figure(_page().sweep_panels(self))
        return figure

    def _repr_html_(self) -> str:
        """Return the values as a table, for a notebook."""
        return str(_page().sweep_table(self).html())

    def to_xarray(self) -> Any:
        """Return ``variables`` as an ``xarray.Dataset``; needs the package xarray."""
        from xarray import Dataset  # noqa: PLC0415  (optional)

        return Dataset(self.variables(), attrs={"scene": self.name})

    def __repr__(self) -> str:
        """Return what was computed where in one line."""
        where = ", ".join(f"{a.key} ({a.values.size})" for a in self.axes)
        return f"Sweep({', '.join(self.quantities)} by {', '.join(self.methods)} over {where})"


def _page() -> Any:
    """Return the module that shows a sweep, which is above this one and heavy: loaded late."""
    return import_module("cases.study.sweep.sweep_page")


NAME = "points.jsonl"
"""Name of the file in a grid's folder."""
CHECK = ', "check": "'
"""Key of the hash that ends each line of the file, as JSON writes it."""
MAX_BYTES = 64 << 20
"""Largest file that is read: some hundred times the points that a grid may have."""


class PointStore:
    """The points of one grid in ``folder``, one JSON line each, or in memory where it is None.

    The file is replaced whole at every point, so that a killed run leaves all points before; its
    first line is a hash of the grid's ``identity``, all that its numbers depend on, and each later
    line ends with a hash of the line before it and of its own point. A file that was changed or is
    another run's is refused and stays as it is; a last line that is not whole, as a power cut may
    leave it, is left out with a warning. Who adds points has ``claimed`` the folder.
    """

    def __init__(self, folder: Path | None, identity: Record) -> None:
        """Read what is there; raise ``BadInput`` for a damaged file, or that of another run."""
        self._path = None if folder is None else folder / NAME
        self._hash = fingerprint(identity)
        self._text = f"{self._hash}\n"
        self.points: dict[tuple[float, ...], SweepPoint] = {}
        if self._path is None or not lexists(self._path):
            return
        what = "the file of a grid's points"
        stored = read_text(self._path, str(self._path), most=MAX_BYTES, what=what)
        own, whole = self._hash, 0
        head, *lines = stored.removesuffix("\n").split("\n")
        for line in lines if head == own else ():
            body = line.rpartition(CHECK)[0] + "}"
            if self._line(body) != line:
                break
            self._append(body)
            point = SweepPoint.read(json.loads(body))
            self.points[point.values] = point
            whole += 1
        rest = lines[whole:] if head == own else [head, *lines]
        if len(rest) > 1 or not own.startswith(head):
            raise BadInput(
                f"{self._path}: is damaged or another run's; give another --out or remove the file"
            )
        if any(rest):
            words = "its last line is torn and left out; what was in it is computed again"
            warnings.warn(f"{self._path}: {words}", stacklevel=2)

    def add(self, point: SweepPoint) -> None:
        """Store a finished point, on disk before anything else is done."""
        self.points[point.values] = point
        self._append(json.dumps(plain(point), allow_nan=False))
        if self._path is not None:
            write_text(self._path, self._text)

    def _line(self, body: str) -> str:
        """The next line of the file: a point, a JSON object, with its hash."""
        own = sha256((self._hash + body).encode()).hexdigest()
        return f'{body[:-1]}{CHECK}{own}"}}'

    def _append(self, body: str) -> None:
        line = self._line(body)
        self._hash, self._text = line[-66:-2], f"{self._text}{line}\n"
