"""Answers of several routes for several curves, and in time, as labelled arrays of a netCDF."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cases.compare.in_time import Replies, failure_of
from cases.scene.questions import TransientQuestion
from cases.scene.units import Units, attribute, in_brackets
from fpk.answer.dynamics import Transient
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array

if TYPE_CHECKING:
    from cases.compare.stationary import Outcome

LABELS = {"contact.stiffness": "contact stiffness B", "contact.clearance": "clearance δ"}
"""Labels of axes by parameter; other axes are labelled by their symbol."""

Variables = dict[str, tuple[tuple[str, ...], NDArray[Any], Mapping[str, str]]]
"""Dimensions, values and attributes by name, as ``xarray.Dataset`` takes them."""

Read = Callable[[Any], Any]
"""Function of an answer that returns a pair: a number or an array, and its error."""

Part = tuple[tuple[str, str], str, str, Read, Mapping[str, int]]
"""A quantity of every answer: the beginnings of its name and of its error's name, its description,
its unit, its reader, and the names and sizes of its dimensions beyond curve and route."""


@dataclass(frozen=True, eq=False)
class Axis:
    """One parameter and the values (points,) that it takes; ``symbol`` is its letter, such as B.

    ``key`` is its path in a scene, as ``contact[1].clearance``. ``logarithmic`` is the scale of the
    axis. ``unit`` is empty without ``[units]``, and if the numbers of the parameter have several.
    """

    key: str
    symbol: str
    values: Array
    logarithmic: bool
    unit: str = ""

    @property
    def label(self) -> str:
        """The words of the axis in a picture, with its unit."""
        name = re.sub(r"\[(\d+)\]", "", self.key)
        words = LABELS.get(name, self.symbol)
        number = re.search(r"\[(\d+)\]", self.key)
        of = f" of contact {number[1]}" if number and name in LABELS else ""
        return words + of + in_brackets(self.unit)

    @property
    def dimension(self) -> str:
        """The name in netCDF: the key with dots for brackets, as ``contact.1.clearance``."""
        return re.sub(r"[\[\],]+\.?", ".", self.key).strip(".")


PASSAGE_NUMBERS: dict[str, tuple[str, int, Read]] = {
    "mean": ("mean first-passage time", 1, lambda p: _value_and_error(p.mean)),
    "variance": ("variance of the first-passage time", 2, lambda p: _value_and_error(p.variance)),
    "rate": ("failure rate", -1, lambda p: _value_and_error(p.rate)),
}
"""Numbers of a first passage by key: name, power of time in the unit, function that reads it."""

PASSAGE_CURVES: dict[str, tuple[str, Read]] = {
    "survival": ("P(T > t)", lambda p: (p.survival, p.survival_error)),
    "failure": ("P(T <= t)", failure_of),
}
"""Probabilities over the times of a question by key: name, function that reads it."""


def by_route(
    name: str,
    count: int,
    answers: Mapping[tuple[int, str], Any],
    parts: Iterable[Part],
    *,
    coordinates: Variables | None = None,
    of_curves: Mapping[str, str] | None = None,
    kinds: Mapping[str, str] | None = None,
) -> Variables:
    """Return the ``answers`` to one question by (number of the curve from 0, label of the route).

    First the coordinate of the routes and ``error_kind`` of each answer, empty for none, then other
    ``coordinates``, then for each of ``parts`` a variable and its error, NaN if there is no answer.
    ``name`` ends all names; ``count`` is the number of curves, ``of_curves`` has the attributes of
    the variables of ``parts``, ``kinds`` the attributes of ``error_kind``.
    """
    routes = list(dict.fromkeys(route for _, route in answers))
    places = [(curve, routes.index(route)) for curve, route in answers]
    dimensions = ("curve", f"route_{name}")
    error_kinds = np.full((count, len(routes)), "", dtype=object)
    for place, answer in zip(places, answers.values(), strict=True):
        error_kinds[place] = answer.error_kind
    variables: Variables = {
        dimensions[1]: (dimensions[1:], np.array(routes), {}),
        f"error_kind_{name}": (dimensions, error_kinds, kinds or {}),
        **(coordinates or {}),
    }
    for keys, of, unit, read, axes in parts:
        both = np.full((2, count, len(routes), *axes.values()), np.nan)
        for place, answer in zip(places, answers.values(), strict=True):
            both[(0, *place)], both[(1, *place)] = read(answer)
        for key, values, long_name in zip(keys, both, (of, f"error of {of}"), strict=True):
            words = {**(of_curves or {}), "units": unit, "long_name": long_name}
            variables[f"{key}_{name}"] = (*dimensions, *axes), values, words
    return variables


def time_variables(outcome: "Outcome") -> Variables:
    """Return the answers to question k = 1, 2, … of either kind, by curve and route.

    ``mean_passage_1``, ``variance_…`` and ``rate_…`` (curve, route), ``survival_…`` and
    ``failure_…`` (curve, route, time); ``p_transient_1`` (curve, route, time, point) at the
    energies or displacements ``at_transient_1`` (curve, point). Beside each is the error, as
    ``error_mean_passage_1``. All dimensions but ``curve`` end in the question, as
    ``time_passage_1``. NaN stands for a missing answer; a question without any answer has no
    variables, and a question without times neither ``survival_…`` nor ``failure_…``.
    """
    variables: Variables = {}
    for kind in ("passage", "transient"):
        columns = zip(*(getattr(curve, f"{kind}s") for curve in outcome.curves), strict=True)
        for k, column in enumerate(columns, start=1):
            variables |= _variables(f"{kind}_{k}", column, outcome.scene.units)
    return variables


def _variables(name: str, column: tuple[Replies, ...], units: Units) -> Variables:
    """The ``time_variables`` of the question ``name``; ``column`` has the replies of each curve."""
    answers = {(i, g.route.label): g.answer for i, r in enumerate(column) for g in r.given}
    if not answers:
        return {}
    question = column[0].question
    coordinates: Variables = {}
    times: dict[str, int] = {}
    if question.times:
        times = {f"time_{name}": len(question.times)}
        values, words = np.array(question.times), {"units": attribute(units.time)}
        coordinates[f"time_{name}"] = (f"time_{name}",), values, words
    about, parts = f": {question.name}", list[Part]()
    if isinstance(question, TransientQuestion):
        points = [r.points if r.given and r.points is not None else np.zeros(0) for r in column]
        size = max(p.size for p in points)
        at = np.array([_pad(p, size) for p in points])
        unit = attribute(units.coordinate(question.of[0]))
        words = {"units": unit, "long_name": f"points of {question.name}, of each curve its own"}
        coordinates[f"at_{name}"] = ("curve", f"point_{name}"), at, words
        axes, unit = times | {f"point_{name}": size}, attribute(units.density(question.of))

        def read_density(p: Transient) -> list[Array]:
            return [_pad(rows, size) for rows in (p.values, p.errors)]

        parts.append((("p", "error_p"), f"density{about}", unit, read_density, axes))
    else:
        for key, (what, power, read) in PASSAGE_NUMBERS.items():
            unit = attribute(units.of((0, 0, power)))
            parts.append(((key, f"error_{key}"), f"{what}{about}", unit, read, {}))
        for key, (what, read) in PASSAGE_CURVES.items() if times else ():
            parts.append(((key, f"error_{key}"), f"{what}{about}", "1", read, times))
    kinds = {"long_name": question.name}
    return by_route(name, len(column), answers, parts, coordinates=coordinates, kinds=kinds)


def _pad(rows: Array, size: int) -> Array:
    """The ``rows`` (…, points), filled up with NaN to (…, ``size``)."""
    missing = size - rows.shape[-1]
    pads = [*[(0, 0)] * (rows.ndim - 1), (0, missing)]
    return np.pad(rows, pads, constant_values=np.nan)


def _value_and_error(number: Number | None) -> tuple[float, float]:
    return (np.nan, np.nan) if number is None else (number.value, number.error)
