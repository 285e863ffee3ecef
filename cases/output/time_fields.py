"""Answers in time as labelled arrays of a netCDF file."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cases.comparison.in_time import Replies
from cases.comparison.run import Outcome
from cases.comparison.time_distances import failure_of
from cases.scene.questions import TransientQuestion
from cases.scene.units import Units, attribute
from fpk.arrays import Array
from fpk.evolution import Passage
from fpk.number import Number

Variables = dict[str, tuple[tuple[str, ...], NDArray[Any], Mapping[str, str]]]
"""Dimensions, values and attributes by name, as ``xarray.Dataset`` takes them."""

NONE = np.zeros(0)

Read = Callable[[Any], tuple[Any, Any]]
"""Takes a number or an array and its error from an answer."""

NUMBERS: dict[str, tuple[str, int, Read]] = {
    "mean": ("mean first-passage time", 1, lambda p: _parts(p.mean)),
    "variance": ("variance of the first-passage time", 2, lambda p: _parts(p.variance)),
    "rate": ("failure rate", -1, lambda p: _parts(p.rate)),
}
"""Words, power of time, and how to read them."""
CURVES: dict[str, tuple[str, Read]] = {
    "survival": ("P(T > t)", lambda p: (p.survival, p.survival_error)),
    "failure": ("P(T <= t)", failure_of),
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
    routes = list(dict.fromkeys(g.route.label for replies in column for g in replies.given))
    if not routes:
        return {}
    question = column[0].question
    kinds = np.full((len(column), len(routes)), "", dtype=object)
    places = [
        (i, routes.index(g.route.label), replies, g.answer)
        for i, replies in enumerate(column)
        for g in replies.given
    ]
    for i, j, _, answer in places:
        kinds[i, j] = answer.error_kind
    time, route = f"time_{name}", f"route_{name}"
    variables: Variables = {
        route: ((route,), np.array(routes), {}),
        f"error_kind_{name}": (("curve", route), kinds, {"long_name": question.name}),
    }
    if question.times:
        variables[time] = ((time,), np.array(question.times), {"units": attribute(units.time)})

    def add(
        key: str, words: str, unit: str, last: tuple[str, ...], shape: tuple[int, ...], read: Read
    ) -> None:
        values = np.full((2, *kinds.shape, *shape), np.nan)
        for i, j, _, answer in places:
            values[0, i, j], values[1, i, j] = read(answer)
        dimensions = ("curve", route, *last)
        words = f"{words}: {question.name}"
        attributes = {"units": unit, "long_name": words}
        variables[f"{key}_{name}"] = dimensions, values[0], attributes
        attributes = {"units": unit, "long_name": f"error of {words}"}
        variables[f"error_{key}_{name}"] = dimensions, values[1], attributes

    count = len(question.times)
    if isinstance(places[0][3], Passage):
        for key, (words, power, read) in NUMBERS.items():
            add(key, words, attribute(units.of((0, 0, power))), (), (), read)
        for key, (words, read) in CURVES.items() if count else ():
            add(key, words, "1", (time,), (count,), read)
        return variables
    assert isinstance(question, TransientQuestion)
    size = max(r.points.size for _, _, r, _ in places if r.points is not None)

    def padded(rows: Array) -> Array:
        filled = np.full((*rows.shape[:-1], size), np.nan)
        filled[..., : rows.shape[-1]] = rows
        return filled

    points = np.array([padded(r.points if r.points is not None else NONE) for r in column])
    words = f"points of {question.name}, of each curve its own"
    variables[f"at_{name}"] = (
        ("curve", f"point_{name}"),
        points,
        {"units": attribute(units.coordinate(question.of[0])), "long_name": words},
    )
    shape = (time, f"point_{name}"), (count, size)
    density = attribute(units.density(question.of))
    add("p", "density", density, *shape, lambda p: (padded(p.values), padded(p.errors)))
    return variables


def _parts(number: Number | None) -> tuple[float, float]:
    return (np.nan, np.nan) if number is None else (number.value, number.error)
