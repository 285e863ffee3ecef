"""Answers about motion after a start by every route that gives them, and what separates them.

The three errors are those of ``compare``. An averaged equation is never exact in time, whatever
its stationary density: what is left between it and the full system is its averaging error.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from functools import partial as partial_of
from itertools import combinations
from time import perf_counter
from typing import Any, TypeGuard

import numpy as np
from scipy.special import stdtrit

from cases.comparison.compare import (
    FALSE_ALARMS,
    ROUND_OFF,
    Comparison,
    Norm,
    discrepancies,
    what_is_measured,
)
from cases.comparison.rare import SPLITTING, split_passage
from cases.comparison.refusal import INTERRUPTED, Refusal
from cases.comparison.window import window_of
from cases.scene.questions import PassageQuestion, Question, TransientQuestion
from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.evolution import Passage, Passages, Transient, Transients
from fpk.method import Method, Progress
from fpk.route import Route
from fpk.system import System

LOOSER = (1e-7, 1e-4)
"""Tolerances that are tried where the default one, which nobody asked for, is missed."""

FEW = 400.0
"""Expected failures below which a plain simulation is left to splitting: 5 % of its paths must
fail, or its failure rate and all that is continued by it is hardly known."""

BATCHES = 32
"""Independent parts of a sample, at least, from which its standard errors come."""

INDEPENDENT = 16
"""Parts of a window of a density that are sampled independently, at least: bins are smoothed over
a fiftieth of an axis, of which a window is a third or more."""

SHARE = 0.3
"""Largest relative error of a number that is compared."""


Distance = tuple[str, Norm, float, float, float]
"""Of one number or density: its name, the norm, the distance, its own error, and its band."""


@dataclass(frozen=True, eq=False)
class Given:
    """The answer of a route to a question and the seconds that it took."""

    route: Route
    answer: Passage | Transient
    seconds: float


@dataclass(frozen=True, eq=False)
class Replies:
    """What all routes say to one question, and who does not.

    Of a transient, ``points`` (points,) are those of all its densities, and ``windows`` those, by
    index, where the density of each time is seen.
    """

    question: Question
    given: tuple[Given, ...] = ()
    refused: tuple[Refusal, ...] = ()
    points: Array | None = None
    windows: tuple[Any, ...] = ()
    interrupted: bool = False

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """What separates all pairs of routes, but of two theories: that says nothing."""
        rows: list[Comparison] = []
        solved = {g.route.method for g in self.given if not g.route.sampled}
        for a, b in combinations(self.given, 2):
            kind = what_is_measured(a.route, b.route, averaging_is_exact=False)
            if kind == "averaging" and "full" not in (a.route.solves, b.route.solves):
                continue
            if b.route.solves == "averaged":  # the full system is what others are held against
                a, b = b, a
            if kind == "averaging" and a.route.sampled and a.route.method in solved:
                continue  # a solution of the same equation says it better
            uncertified = tuple(g.route for g in (a, b) if not g.answer.certificate.certified)
            judged = kind != "averaging"
            for name, norm, distance, error, band in self._distances(a, b, judged):
                if judged and not np.isfinite(band):
                    continue  # nothing is stated: the answer is not certified
                allowed = band if judged else None
                words = f"{self.question.name}: {name}"
                rows.append(
                    Comparison(
                        words, a.route, b.route, kind, distance, allowed, error, uncertified, norm
                    )
                )
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
        return (*discrepancies(self.comparisons), *uncertified, *failed, *none)

    def _distances(self, a: Given, b: Given, judged: bool) -> Iterator[Distance]:
        if isinstance(a.answer, Passage) and isinstance(b.answer, Passage):
            return _passage_distances(a.answer, b.answer, judged)
        assert isinstance(a.answer, Transient) and isinstance(b.answer, Transient)
        assert self.points is not None
        return _density_distances(a.answer, b.answer, self.points, self.windows, judged)


def replies_of(
    system: System,
    question: Question,
    methods: Sequence[Method],
    *,
    progress: Progress,
    partial: bool,
) -> Replies:
    """Return the answers of those of ``methods`` that are able to answer ``question``.

    ``partial``: Ctrl-C ends the work with the answers that there are by then. Simulations follow
    their paths until the last time. Where they would see few failures, as an averaged equation or
    they themselves say, splitting takes the place of the full system's.
    """
    given: list[Given] = []
    refused: list[Refusal] = []
    interrupted, points = False, None
    windows: tuple[Any, ...] = ()
    able = [m for m in methods if _is_able(m, question)]

    def tried(route: Route, work: Any) -> None:
        nonlocal interrupted
        start = perf_counter()
        try:
            if interrupted:
                raise KeyboardInterrupt
            given.append(Given(route, work(), perf_counter() - start))
        except KeyboardInterrupt:
            if not partial:
                raise
            refused.append(Refusal(route, (question.name,), INTERRUPTED, not interrupted))
            interrupted = True
        except (NotApplicable, NotCertified, InvalidInput) as error:
            failed = not isinstance(error, NotApplicable)
            refused.append(Refusal(route, (question.name,), str(error), failed))

    if isinstance(question, TransientQuestion):
        try:
            points, windows = window_of(system, question, able)
        except KeyboardInterrupt:
            if not partial:
                raise
            interrupted = True
    for method in able:
        if (reason := _too_rare(question, method, given)) is not None:
            refused.append(Refusal(method.route, (question.name,), reason))
            continue
        tried(method.route, partial_of(_answer, method, system, question, points, progress))
    simulation = next((m for m in able if m.route.solves == "full" and m.route.sampled), None)
    known = any(g.answer.certificate.certified for g in given if g.route.solves == "full")
    seen = known or interrupted or system.modulation is not None
    if isinstance(question, PassageQuestion) and question.times and simulation and not seen:
        before = len(given)
        tried(SPLITTING, partial_of(split_passage, system, question, simulation, progress))
        if len(given) > before:  # it takes the place of what saw too little
            plain = [g for g in given if g.route == simulation.route]
            given = [g for g in given if g not in plain]
            reasons = [words for g in plain for words in g.answer.certificate.failures]
            refused += [Refusal(simulation.route, (question.name,), r) for r in reasons]
    return Replies(question, tuple(given), tuple(refused), points, windows, interrupted)


def _is_able(method: Method, question: Question) -> TypeGuard[Any]:
    kind = Passages if isinstance(question, PassageQuestion) else Transients
    return isinstance(method, kind)


def _too_rare(question: Question, method: Method, given: Sequence[Given]) -> str | None:
    """Why a simulation of so many paths would see too few failures, by the answers there are."""
    if not (method.route.sampled and isinstance(question, PassageQuestion) and question.times):
        return None
    paths = float(getattr(method, "paths", 0))
    known = [
        (float(failure_of(g.answer)[0][-1]), g.route.label)
        for g in given
        if isinstance(g.answer, Passage) and np.isfinite(g.answer.survival[-1])
    ]
    if not known or paths * max(known)[0] >= FEW:
        return None
    expected, label = max(known)
    return (
        f"too rare for plain simulation: {label} expects {paths * expected:.2g} failures of"
        f" {paths:.0f} paths by t = {question.times[-1]:g}"
    )


def _answer(
    method: Any, system: System, question: Question, points: Array | None, progress: Progress
) -> Passage | Transient:
    """The answer of one method, at the least tolerance that it meets where none was asked for."""
    bounds: dict[str, Any] = {"checkpoint": None, "partial": False}
    if isinstance(question, PassageQuestion) and question.times:
        bounds["time"] = question.times[-1]
    known = {f.name for f in fields(method)}
    method = replace(method, **{k: v for k, v in bounds.items() if k in known})
    own = getattr(method, "tol", None)
    unasked = not method.route.sampled and own == getattr(method.route.make(), "tol", None)
    answer: Passage | Transient
    for tol in (None, *(LOOSER if unasked else ())):
        times = np.array(question.times)
        if isinstance(question, PassageQuestion):
            asked = system, question.limit, question.start, times
            answer = method.passage(*asked, tol=tol, progress=progress)
        else:
            asked_of = system, question.of, question.start, times, (points,)
            answer = method.transient(*asked_of, tol=tol, progress=progress)
        if answer.certificate.certified:
            break
    return answer


def failure_of(p: Passage) -> tuple[Array, Array]:
    """Return P(T <= t) and its error."""
    if p.failure is not None and p.failure_error is not None:
        return p.failure, p.failure_error
    return 1.0 - p.survival, p.survival_error


def _passage_distances(a: Passage, b: Passage, judged: bool) -> Iterator[Distance]:
    """Yield the distances of every number that both know."""
    sampled = [p.error_kind == "sampling" for p in (a, b)]
    both = [("mean time", a.mean, b.mean)]
    if a.rate is not None and b.rate is not None:
        both.append(("failure rate", a.rate, b.rate))
    for name, x, y in both:
        values, errors = np.array([x.value, y.value]), np.array([x.error, y.error])
        # Not a number fails the comparison, too.
        if np.all(errors <= SHARE * np.abs(values)) and np.all(np.isfinite(values)):
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
    """P(T > t) of both with errors; of a sample at least those by what a solution expects.

    Of few failures the sample itself does not know how many might have been.
    """
    pairs = [(p.survival, p.survival_error) for p in (a, b)]
    if (a.error_kind == "sampling") != (b.error_kind == "sampling"):
        own = int(b.error_kind == "sampling")
        S, error = pairs[own]
        expected = np.clip(pairs[1 - own][0], 0.0, 1.0)
        # Its error is at least that of binomial numbers of its paths, or one of them.
        paths = np.max(np.where((S > 0.0) & (S < 1.0), S * (1.0 - S) / error**2, 1.0 / error))
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
    """Yield the largest of the distances at the times, in units of their bands where judged."""
    a, b = pair
    unit = np.abs(b[0]) if norm == "relative" else np.ones(times.size)
    known = (unit > 0.0) & np.isfinite(a[1]) & np.isfinite(b[1])
    if norm == "relative":
        known &= (a[1] <= SHARE * np.abs(a[0])) & (b[1] <= SHARE * unit)
    if not known.any():
        return
    band, error = _band(np.array([a[1], b[1]])[:, known], sampled, int(np.count_nonzero(known)))
    off, unit = np.abs(a[0] - b[0])[known], unit[known]
    k = int(np.argmax(off / ((band + ROUND_OFF) if judged else unit)))
    distance, error, band = (float(v[k] / unit[k]) for v in (off, error, band))
    yield name.format(times[known][k]), norm, distance, error, band + ROUND_OFF


def _band(errors: Any, sampled: Sequence[bool], count: int) -> tuple[Any, Any]:
    """The band of a difference, ``count`` of which are judged together, and its own error.

    Stated errors add up; standard errors add in squares, and Student's t by ``BATCHES`` says how
    many of them a false alarm takes (Bonferroni).
    """
    chance = np.sqrt(sum(e**2 for e, s in zip(errors, sampled, strict=True) if s) + 0.0)
    stated = sum(e for e, s in zip(errors, sampled, strict=True) if not s) + 0.0
    z = -float(stdtrit(BATCHES - 1, 0.5 * FALSE_ALARMS / count))
    return z * chance + stated, chance + stated


def _density_distances(
    a: Transient, b: Transient, points: Array, windows: Sequence[Any], judged: bool
) -> Iterator[Distance]:
    """Yield the largest L1 distance over its window of all times, as ``_worst`` does.

    By the trapezoidal rule, of distance and band alike. By chance each |deviation| has the mean
    √(2/π) of its standard error and the variance 1 − 2/π of its square.
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
        z = -float(stdtrit(BATCHES - 1, FALSE_ALARMS / len(windows)))
        mean = np.sqrt(2.0 / np.pi) * float(w @ chance)
        dependent = max(1.0, x.size / INDEPENDENT)
        spread = np.sqrt((1.0 - 2.0 / np.pi) * dependent * float(np.sum((w * chance) ** 2)))
        distance = float(w @ np.abs(a.values[k, inside] - b.values[k, inside]))
        rows.append((distance, mean + stated, mean + z * spread + stated + ROUND_OFF, k))
    distance, error, band, k = max(rows, key=lambda row: row[0] / (row[2] if judged else 1.0))
    yield f"density at t = {a.times[k]:g}", "L1", distance, error, band
