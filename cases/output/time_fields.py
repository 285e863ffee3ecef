"""Answers in time as labelled arrays of a netCDF file."""

import numpy as np

from cases.comparison.in_time import Replies
from cases.comparison.run import Outcome
from cases.comparison.time_distances import failure_of
from cases.output.variables import ByRoute, Read, Variables
from cases.scene.questions import TransientQuestion
from cases.scene.units import Units, attribute
from fpk.arrays import Array
from fpk.number import Number

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
