"""Answers about motion after a start by every route, and the differences between them.

The three errors are named as in ``compare``. An averaged equation is never exact in time, whatever
its stationary density: its difference to the full system is its averaging error. A band is the sum
of the errors that solvers state, and of the quantile of the sampling errors at ``FALSE_ALARMS``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import inf
from typing import Any

import numpy as np

from cases.compare.attempts import Refusal
from cases.compare.compare import ROUND_OFF, Comparison, Norm, discrepancies, what_is_measured
from cases.scene.questions import Question
from fpk.answer.dynamics import LARGEST_ERROR, Passage, Transient
from fpk.answer.method import Route
from fpk.numeric.arrays import Array
from sim.sample.diagnostics import largest_by_chance

BATCHES = 32
"""Smallest number of independent batches from which a standard error is estimated."""

INDEPENDENT = 6
"""Smallest number of independent coefficients of a sampled density in a window: a fit to the axis
has 2 · 9, and a window is at least a third of the axis."""

COMPARABLE = 0.3
"""Largest relative error of a number that is compared."""

Distance = tuple[str, Norm, float, float, float]
"""Name of the number or density, norm, distance, its uncertainty, and the allowed distance."""


@dataclass(frozen=True, eq=False)
class Given:
    """The answer of a route to a question, and its computing time in ``seconds``."""

    route: Route
    answer: Passage | Transient
    seconds: float

    @property
    def words(self) -> str:
        """The theory and the solver of this answer; densities may come from another solver."""
        solved_by = self.answer.settings.get("solved_by")
        return f"{self.route.name}, {solved_by}" if solved_by else self.route.words


@dataclass(frozen=True, eq=False)
class Replies:
    """The answers of all routes to one question, and the routes that give none.

    ``points`` (points,) ascend; all densities of a transient are given there. ``windows`` holds for
    each time the indices of the points at which the density is compared and drawn; it is empty if
    no route says where the density is large. ``notes`` name missed default tolerances.
    """

    question: Question
    given: tuple[Given, ...] = ()
    refused: tuple[Refusal, ...] = ()
    points: Array | None = None
    windows: tuple[Any, ...] = ()
    interrupted: bool = False
    notes: tuple[str, ...] = ()

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The differences of all pairs of routes, relative to the full system if one is averaged.

        Left out are two different averaged theories, a simulation of a theory against the full
        system if the theory is also solved, and judged differences without a finite band.
        """
        rows: list[Comparison] = []
        solved = {g.route.method for g in self.given if not g.route.sampled}
        for a, b in combinations(self.given, 2):
            kind = what_is_measured(a.route, b.route, averaging_is_exact=False)
            if kind == "averaging" and "full" not in (a.route.solves, b.route.solves):
                continue
            if b.route.solves == "averaged":  # differences are relative to the full system
                a, b = b, a
            if kind == "averaging" and a.route.sampled and a.route.method in solved:
                continue  # a solution of the same equation is more accurate
            uncertified = tuple(g.route for g in (a, b) if not g.answer.certificate.certified)
            judged = kind != "averaging"
            if isinstance(a.answer, Passage) and isinstance(b.answer, Passage):
                distances = passage_distances(a.answer, b.answer, judged)
            else:
                assert isinstance(a.answer, Transient) and isinstance(b.answer, Transient)
                of = a.answer, b.answer, np.asarray(self.points), self.windows
                distances = density_distances(*of, judged)
            for name, norm, distance, error, band in distances:
                if judged and not np.isfinite(band):
                    continue  # no error is stated: the answer is not certified
                words, allowed = f"{self.question.name}: {name}", band if judged else None
                own = words, a.route, b.route, kind, distance, allowed, error, uncertified, norm
                rows.append(Comparison(*own))
        return tuple(rows)

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words."""
        name = self.question.name
        uncertified = [
            f"{name}: {g.route.label} is not certified: {failure}"
            for g in self.given
            for failure in g.answer.certificate.failures
        ]
        failed = [f"{name}: {r.route.label} failed: {r.reason}" for r in self.refused if r.failed]
        reason = "not run: the program was interrupted" if self.interrupted else "no route answers"
        none = [] if self.given or failed else [f"{name}: {reason}"]
        if self.points is not None and not self.windows:
            none.append(f"{name}: not compared: no route says where the densities are")
        return (*discrepancies(self.comparisons), *uncertified, *failed, *none)


def failure_of(p: Passage) -> tuple[Array, Array]:
    """Return P(T <= t) and its error (times,), by the method itself or else as 1 − P(T > t)."""
    if p.failure is not None and p.failure_error is not None:
        return p.failure, p.failure_error
    return 1.0 - p.survival, p.survival_error


def passage_distances(a: Passage, b: Passage, judged: bool) -> Iterator[Distance]:
    """Yield the differences of mean time, failure rate, P(T <= t) and P(T > t), if both give them.

    They are relative to ``b``, of P(T > t) absolute; a number with a relative error above
    ``COMPARABLE`` is left out. ``judged``: of all times the difference that is largest in units of
    its band is given, else the largest difference.
    """
    sampled = [p.error_kind == "sampling" for p in (a, b)]
    both = [("mean time", a.mean, b.mean)]
    if a.rate is not None and b.rate is not None:
        both.append(("failure rate", a.rate, b.rate))
    for name, x, y in both:
        values, errors = np.array([x.value, y.value]), np.array([x.error, y.error])
        # False for NaN, too.
        if np.all(errors <= COMPARABLE * np.abs(values)) and np.all(np.isfinite(values)):
            band, error = (v / abs(y.value) for v in _band(errors, sampled, 1))
            yield name, "relative", abs(x.value - y.value) / abs(y.value), error, band + ROUND_OFF
    if not a.times.size:
        return
    if a.failure is not None and b.failure is not None:
        both_fail = failure_of(a), failure_of(b)
        yield from _worst("P(T ≤ {:g})", a.times, both_fail, sampled, "relative", judged)
    pairs = _survivals(a, b)
    yield from _worst("P(T > {:g})", a.times, pairs, sampled, "absolute", judged)


def _survivals(a: Passage, b: Passage) -> list[tuple[Array, Array]]:
    """Return P(T > t) and its error, (times,) each, of ``a`` and of ``b``.

    If only one is sampled, its error is raised to √(S(1 − S)/paths) with P(T > t) = S of the other:
    a sample with few failures underestimates its own standard error.
    """
    pairs = [(p.survival, p.survival_error) for p in (a, b)]
    if (a.error_kind == "sampling") != (b.error_kind == "sampling"):
        own = int(b.error_kind == "sampling")
        S, error = pairs[own]
        expected = np.clip(pairs[1 - own][0], 0.0, 1.0)
        # error² = S(1 − S)/paths; if no path or every path failed, error = 1/paths.
        sure = (error > 0.0) & (error < inf)  # not at the start, nor unknown
        square = np.where((S > 0.0) & (S < 1.0), S * (1.0 - S), error)
        paths = np.max(square[sure] / error[sure] ** 2, initial=1.0)
        pairs[own] = S, np.maximum(error, np.sqrt(expected * (1.0 - expected) / paths))
    return pairs


def _worst(
    name: str,
    times: Array,
    pair: Sequence[tuple[Array, Array]],
    sampled: Sequence[bool],
    norm: Norm,
    judged: bool,
) -> Iterator[Distance]:
    """Yield the largest of the differences at ``times``, in units of their bands if ``judged``.

    ``name`` is a format of the time. ``pair`` has the values and errors (times,) of both answers,
    ``sampled`` says whose errors are standard errors; "relative" is to the second. Times at which
    an error exceeds ``LARGEST_ERROR`` or, if relative, ``COMPARABLE`` are left out; if all are,
    nothing is yielded.
    """
    a, b = pair
    unit = np.abs(b[0]) if norm == "relative" else np.ones(times.size)
    known = (unit > 0.0) & (a[1] <= LARGEST_ERROR) & (b[1] <= LARGEST_ERROR)
    if norm == "relative":
        known &= (a[1] <= COMPARABLE * np.abs(a[0])) & (b[1] <= COMPARABLE * unit)
    if not known.any():
        return
    band, error = _band(np.array([a[1], b[1]])[:, known], sampled, int(np.count_nonzero(known)))
    off, unit = np.abs(a[0] - b[0])[known], unit[known]
    k = int(np.argmax(off / ((band + ROUND_OFF) if judged else unit)))
    distance, error, band = (float(v[k] / unit[k]) for v in (off, error, band))
    yield name.format(times[known][k]), norm, distance, error, band + ROUND_OFF


def _band(errors: Any, sampled: Sequence[bool], count: int) -> tuple[Any, Any]:
    """Return the allowed size of each of ``count`` differences, and their uncertainty.

    ``errors`` (2, …) are of both answers: standard errors if ``sampled``, which add in squares to
    s, else of solvers, which add up to e. The uncertainty is s + e, the allowed size z s + e: z is
    Student's t for ``BATCHES`` at the two-sided level ``FALSE_ALARMS/count`` (Bonferroni).
    """
    chance = np.sqrt(sum(e**2 for e, s in zip(errors, sampled, strict=True) if s) + 0.0)
    stated = sum(e for e, s in zip(errors, sampled, strict=True) if not s) + 0.0
    return largest_by_chance(BATCHES, count) * chance + stated, chance + stated


def density_distances(
    a: Transient, b: Transient, points: Array, windows: Sequence[Any], judged: bool
) -> Iterator[Distance]:
    """Yield the L1 distance of ``a`` and ``b`` at the time at which it is largest.

    It is largest in units of its band if ``judged``. Each is over its window by the trapezoidal
    rule; ``points`` and ``windows`` are these fields of ``Replies``; nothing is yielded without
    windows. A normal deviation has the mean modulus √(2/π) σ with the variance (1 − 2/π) σ².
    """
    if not windows:
        return
    rows = []
    for k, inside in enumerate(windows):
        x = points[inside]
        w = np.gradient(x)
        w[[0, -1]] *= 0.5
        chance, stated = np.zeros(x.size), 0.0
        for t in (a, b):
            error = t.errors[k, inside]
            if t.error_kind == "sampling":
                chance = np.hypot(chance, error)
            else:
                stated += float(w @ error)
        z = largest_by_chance(BATCHES, len(windows), sides=1)
        mean = np.sqrt(2.0 / np.pi) * float(w @ chance)
        dependent = max(1.0, x.size / INDEPENDENT)
        spread = np.sqrt((1.0 - 2.0 / np.pi) * dependent * float(np.sum((w * chance) ** 2)))
        distance = float(w @ np.abs(a.values[k, inside] - b.values[k, inside]))
        rows.append((distance, mean + stated, mean + z * spread + stated + ROUND_OFF, k))
    distance, error, band, k = max(rows, key=lambda row: row[0] / (row[2] if judged else 1.0))
    yield f"density at t = {a.times[k]:g}", "L1", distance, error, band
