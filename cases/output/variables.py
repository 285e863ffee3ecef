"""Answers of several routes for several curves, and in time, as labelled arrays of a netCDF."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cases.comparison.in_time import Replies
from cases.comparison.run import Outcome
from cases.comparison.time_distances import failure_of
from cases.scene.questions import TransientQuestion
from cases.scene.units import Units, attribute
from fpk.arrays import Array
from fpk.number import Number

Variables = dict[str, tuple[tuple[str, ...], NDArray[Any], Mapping[str, str]]]
"""Dimensions, values and attributes by name, as ``xarray.Dataset`` takes them."""

Read = Callable[[Any], Any]
"""Takes two things from an answer: a number or an array, and its error."""

NUMBERS: dict[str, tuple[str, int, Read]] = {
    "mean": ("mean first-passage time", 1, lambda p: _parts(p.mean)),
    "variance": ("variance of the first-passage time", 2, lambda p: _parts(p.variance)),
    "rate": ("failure rate", -1, lambda p: _parts(p.rate)),
}
"""Numbers of a first passage by key: what each is, power of time in its unit, how to read it."""

CURVES: dict[str, tuple[str, Read]] = {
    "survival": ("P(T > t)", lambda p: (p.survival, p.survival_error)),
    "failure": ("P(T <= t)", failure_of),
}
"""Probabilities over the times of a question by key: what each is, and how to read it."""


@dataclass(frozen=True)
class ByRoute:
    """The ``answers`` to one question by (number of the curve from 0, label of the route).

    ``name`` ends the names of its variables; ``count`` is the number of curves, ``words`` the
    attributes that all variables of a curve have.
    """

    name: str
    count: int
    answers: Mapping[tuple[int, str], Any]
    words: Mapping[str, str]

    @property
    def routes(self) -> list[str]:
        """The labels of the routes, each once."""
        return list(dict.fromkeys(route for _, route in self.answers))

    @property
    def dimensions(self) -> tuple[str, str]:
        """The names of the dimensions of curve and route."""
        return "curve", f"route_{self.name}"

    def labels(self, words: Mapping[str, str]) -> Variables:
        """Return the coordinate of the routes, and ``error_kind`` of each answer, empty for none.

        ``words`` are attributes of the latter.
        """
        kinds = np.full((self.count, len(self.routes)), "", dtype=object)
        for (curve, route), answer in self.answers.items():
            kinds[curve, self.routes.index(route)] = answer.error_kind
        return {
            self.dimensions[1]: (self.dimensions[1:], np.array(self.routes), {}),
            f"error_kind_{self.name}": (self.dimensions, kinds, words),
        }

    def pair(
        self,
        keys: tuple[str, str],
        of: str,
        unit: str,
        read: Read,
        axes: Mapping[str, int] | None = None,
    ) -> Variables:
        """Return the variable of what ``read`` takes from the answers, and that of its error.

        ``keys`` begin their names, ``of`` says in words what it is, ``axes`` are the names and
        sizes of further dimensions. Where there is no answer both are not numbers.
        """
        axes = axes or {}
        both = np.full((2, self.count, len(self.routes), *axes.values()), np.nan)
        for (curve, route), answer in self.answers.items():
            place = curve, self.routes.index(route)
            both[(0, *place)], both[(1, *place)] = read(answer)
        return {
            f"{key}_{self.name}": (
                (*self.dimensions, *axes),
                values,
                {**self.words, "units": unit, "long_name": long_name},
            )
            for key, values, long_name in zip(keys, both, (of, f"error of {of}"), strict=True)
        }


def time_variables(outcome: Outcome) -> Variables:
    """Return the answers to question k = 1, 2, … of either kind, by curve and route.

    ``mean_passage_1``, ``variance_…`` and ``rate_…`` (curve, route), ``survival_…`` and
    ``failure_…`` (curve, route, time); ``p_transient_1`` (curve, route, time, point) at the
    energies or displacements ``at_transient_1`` (curve, point). Beside each is the error, as
    ``error_mean_passage_1``. What no route answers is not a number.
    """
    variables: Variables = {}
    for kind in ("passage", "transient"):
        columns = zip(*(getattr(curve, f"{kind}s") for curve in outcome.curves), strict=True)
        for k, column in enumerate(columns, start=1):
            variables |= _variables(f"{kind}_{k}", column, outcome.scene.units)
    return variables


def _variables(name: str, column: tuple[Replies, ...], units: Units) -> Variables:
    """The answers to question ``name``, of which ``column`` has the replies of every curve."""
    answers = {(i, g.route.label): g.answer for i, r in enumerate(column) for g in r.given}
    if not answers:
        return {}
    question = column[0].question
    of = ByRoute(name, len(column), answers, {})
    variables = of.labels({"long_name": question.name})
    times: dict[str, int] = {}
    if question.times:
        times = {f"time_{name}": len(question.times)}
        values, words = np.array(question.times), {"units": attribute(units.time)}
        variables[f"time_{name}"] = (f"time_{name}",), values, words

    def add(key: str, words: str, unit: str, read: Read, axes: dict[str, int]) -> None:
        keys = key, f"error_{key}"
        variables.update(of.pair(keys, f"{words}: {question.name}", unit, read, axes))

    if isinstance(question, TransientQuestion):
        points = [r.points if r.given and r.points is not None else np.zeros(0) for r in column]
        size = max(p.size for p in points)
        at = np.array([_padded(p, size) for p in points])
        unit = attribute(units.coordinate(question.of[0]))
        words = {"units": unit, "long_name": f"points of {question.name}, of each curve its own"}
        variables[f"at_{name}"] = ("curve", f"point_{name}"), at, words
        axes, unit = times | {f"point_{name}": size}, attribute(units.density(question.of))
        add(
            "p", "density", unit, lambda p: (_padded(p.values, size), _padded(p.errors, size)), axes
        )
        return variables
    for key, (what, power, read) in NUMBERS.items():
        add(key, what, attribute(units.of((0, 0, power))), read, {})
    for key, (what, read) in CURVES.items() if times else ():
        add(key, what, "1", read, times)
    return variables


def _padded(rows: Array, size: int) -> Array:
    """The rows (…, points) with ``size`` points, those that are missing not numbers."""
    missing = size - rows.shape[-1]
    pads = [*[(0, 0)] * (rows.ndim - 1), (0, missing)]
    return np.pad(rows, pads, constant_values=np.nan)


def _parts(number: Number | None) -> tuple[float, float]:
    return (np.nan, np.nan) if number is None else (number.value, number.error)
