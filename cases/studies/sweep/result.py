"""The answers of a sweep: values with their errors, point by point and as labelled arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from cases.output.records import Record
from cases.output.variables import Variables
from cases.scene.units import attribute, bracketed
from cases.studies.sweep.grid import Axis, place_words

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
        figure: Figure = _page().sweep_figure(self)
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
    return import_module("cases.studies.sweep.sweep_page")
