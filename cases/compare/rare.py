"""Rare failure of the full system by splitting, as an answer to a question of first passage."""

from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np

from cases.scene.questions import PassageQuestion
from cases.scene.written import bound
from fpk.answer.certificate import Measured, certify, tolerance
from fpk.answer.dynamics import Passage
from fpk.answer.method import Progress, Route
from fpk.answer.quantities import Number
from fpk.numeric.errors import NotApplicable
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.passage import LEAST_TAIL_FAILURES, horizon
from sim.questions.splitting.run import Splitting, rare_failure

SPLITTING = Route(
    "splitting", "splitting", "splitting", "(6)", "full", True, "#b50c01", make=MonteCarlo
)
"""The route that replaces a plain simulation; it gives no densities."""

ALIVE = 0.1
"""Largest share of surviving paths at the last time for which a simulation up to there is the
answer; its moments are continued by the failure rate."""

REPLICAS, REPETITIONS = 256, 8
"""Replicas of a run of splitting, and independent runs: P = 1e-9 to 20 % in some seconds."""

MORE_REPLICAS = 512
"""Replicas of a run of splitting to a given relative error; with fewer, the error of a probability
below 1e-10 cannot be estimated from the independent runs."""

AIM, MOST_ERROR = 0.2, 0.5
"""Relative errors of P(T <= t): the aim of splitting in place of a simulation, and the largest that
is certified."""


def passage_answer(
    method: Any, system: System, question: PassageQuestion, *, tol: float | None, progress: Progress
) -> Passage:
    """Return the first passage by ``method``, or by splitting if a simulation sees few failures.

    A plain simulation of the full system first runs to the last time of ``question``. By the share
    of failed paths at that time,

    - splitting answers if fewer than ``LEAST_TAIL_FAILURES`` paths are expected to fail within the
      longest time of ``method``;
    - this first run is the answer if a share below ``ALIVE`` survives, it is certified, and ``tol``
      is None;
    - else ``method`` itself is run, from the start.

    Other methods run at once, and so does a simulation without times > 0, under modulated noise, or
    with ``method.seconds``, to which splitting does not keep. ``tol``: relative error wanted of the
    mean, for splitting of P(T <= t).
    """
    times = np.array(question.times)
    asked = system, question.limit, question.start, times
    last = float(np.max(times, initial=0.0))
    plain = isinstance(method, MonteCarlo) and method.seconds is None
    if plain and last > 0.0 and system.modulation is None:
        until = replace(method, time=min(last, method.time or last), tol=None)
        first: Passage = until.passage(*asked, tol=None, progress=progress)
        failed = (1.0 - float(first.survival[-1])) * method.paths
        longest = horizon(method, float(first.settings["coarse dt"]), last)
        if failed * longest / last < LEAST_TAIL_FAILURES:
            settings = splitting_of(method, replicas=MORE_REPLICAS, tol=tolerance(tol, AIM))
            answer = split_passage(system, question, settings, tol=tol, progress=progress)
            words = f"splitting: of {method.paths} plain paths {failed:.0f} pass by t = {last:g}"
            return replace(answer, settings={"sampled_by": words, **answer.settings})
        known = first.certificate.certified and first.mean.error < inf
        if first.survival[-1] < ALIVE and tol is None and known:
            return first
    return method.passage(*asked, tol=tol, progress=progress)  # type: ignore[no-any-return]


def splitting_of(method: MonteCarlo, **settings: Any) -> Splitting:
    """Return splitting with step, seed, threads, cluster and seconds of ``method``.

    ``settings`` are further fields and take precedence, also over ``REPLICAS``, ``REPETITIONS``.
    """
    own = {name: getattr(method, name) for name in ("dt", "seed", "threads", "cluster")}
    own |= {"seconds": method.seconds} if method.seconds else {}
    return Splitting(**{"replicas": REPLICAS, "repetitions": REPETITIONS, **own, **settings})


def split_passage(
    system: System,
    question: PassageQuestion,
    settings: Splitting,
    *,
    tol: float | None = None,
    progress: Progress,
) -> Passage:
    """Return P(T <= t) at the times > 0 of ``question``, each by an independent splitting.

    A relative error of P(T <= t) above ``MOST_ERROR`` or above ``tol`` is not certified;
    ``settings.tol`` is the error aimed at; the error of a probability of 0 is its upper bound.
    Moments are NaN and the failure rate, which is defined for t → ∞, is None.

    Raises ``NotApplicable`` if no time is > 0.
    """
    times = np.array(question.times)
    failure, errors = np.zeros((2, times.size))
    if not np.any(times > 0.0):
        raise NotApplicable("splitting needs a time after the start")
    words, shares, steps = list[str](), list[float](), list[float]()
    for k in np.flatnonzero(times > 0.0):
        asked = system, question.limit, question.start, float(times[k])
        row = rare_failure(*asked, settings=settings, progress=progress)
        failure[k] = row.probability
        errors[k] = row.error if failure[k] > 0.0 else row.upper_bound
        shares.append(errors[k] / (failure[k] if failure[k] > 0.0 else errors[k]))
        steps.append(row.dt)
        if not row.error <= MOST_ERROR * row.probability:
            least = f"{bound(row.error)} only, and {bound(row.upper_bound)} at most (95 %)"
            words.append(f"P(T ≤ {times[k]:g}) = {row.probability:.2g} is known to {least}")
    measured = Measured(
        l1_error=float(np.max(shares)), mass_defect=None, minimum=float(failure.min()),
        residual=None, tail_mass=None, failures=tuple(words),
    )  # fmt: skip
    how = {name: getattr(settings, name) for name in ("replicas", "repetitions", "seed")}
    how["dt"] = min(steps)
    return Passage(
        Number(nan, inf), Number(nan, inf), None, times, 1.0 - failure, errors, "sampling",
        certify(measured, tol=inf if tol is None else tol, sampled=True), None, how,
        failure, errors,
    )  # fmt: skip
