"""Rare failure of the full system by splitting, as an answer to a question of first passage."""

from math import inf, nan
from typing import Any

import numpy as np

from averaging.energy_process import energy_process
from cases.scene.questions import PassageQuestion
from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.errors import InvalidInput, NotApplicable
from fpk.evolution import Passage
from fpk.line.time.passage import first_passage
from fpk.method import Progress
from fpk.number import Number
from fpk.route import Route
from fpk.system import System
from sim.montecarlo import MonteCarlo
from sim.splitting.run import rare_failure
from sim.splitting.score import ScoreFunction
from sim.splitting.settings import Splitting

SPLITTING = Route(
    "splitting", "splitting", "splitting", "(6)", "full", True, "#5b8def", make=MonteCarlo
)
"""The route that takes the place of the plain simulation; it gives no densities."""

REPLICAS, REPETITIONS = 256, 8
"""Replicas of a run of splitting, and independent runs: in some seconds they give a probability of
1e-9 to 20 %."""

MOST_ERROR = 0.5
"""Relative error of a probability above which it is not certified."""

TOL, LEAST = 1e-4, 1e-12
"""Tolerance of the averaged reliability as a score, and the least probability of failure from rest
for which it is used: as the difference of numbers about one, it has no digits far below."""


def split_passage(
    system: System, question: PassageQuestion, method: Any, progress: Progress
) -> Passage:
    """Return P(T <= t) at the times > 0 of ``question`` by splitting, each on its own.

    ``method`` is the plain simulation, whose step, seed, threads and cluster are taken. The score
    is that of ``averaged_score``, or least action where there is none. The moments and the
    failure rate are not given.
    """
    names = ("dt", "seed", "threads", "cluster")
    settings = Splitting(
        REPLICAS, repetitions=REPETITIONS, **{name: getattr(method, name) for name in names}
    )
    times = np.array(question.times)
    failure, errors = np.zeros((2, times.size))
    if not np.any(times > 0.0):
        raise NotApplicable("splitting needs a time after the start")
    score = averaged_score(system, question)
    rows = []
    for k, t in enumerate(times):
        if t > 0.0:
            asked = system, question.limit, question.start, float(t)
            rows.append(rare_failure(*asked, score=score, settings=settings, progress=progress))
            failure[k], errors[k] = rows[-1].probability, rows[-1].error
            if not failure[k] > 0.0:
                errors[k] = rows[-1].upper_bound
    later = times > 0.0
    words = [
        f"P(T ≤ {t:g}) = {p:.2g} is known to {e:.2g} only"
        for t, p, e in zip(times[later], failure[later], errors[later], strict=True)
        if not e <= MOST_ERROR * p
    ]
    shares = errors[later] / np.where(failure[later] > 0.0, failure[later], errors[later])
    relative = float(np.max(shares))
    measured = Measured(
        l1_error=relative, mass_defect=0.0, minimum=float(failure.min()), residual=nan,
        tail_mass=0.0, failures=tuple(words),
    )  # fmt: skip
    return Passage(
        Number(nan, inf), Number(nan, inf), None, times, 1.0 - failure, errors, "sampling",
        certify(measured, tol=inf, sampled=True), None,
        {
            "replicas": settings.replicas,
            "repetitions": settings.repetitions,
            "seed": settings.seed,
            "score": "averaged reliability" if score else "least action",
            "dt": min(row.dt for row in rows),
        },
        failure, errors,
    )  # fmt: skip


def averaged_score(system: System, question: PassageQuestion) -> ScoreFunction | None:
    """Return ln P(failure | energy, time left) of the averaged energy, Eq. (24).

    None where the limit is not one of H, or failure from rest by the last time is less probable
    than ``LEAST``.
    """
    if question.limit.kind != "H":
        return None
    try:
        process = energy_process(system)
    except NotApplicable:
        return None
    limit, last = question.limit.value, np.array([question.times[-1]])

    def score(energies: Array, times: Array) -> Array:
        failure, _ = first_passage(process, limit, times=times, tol=TOL).failure(times, energies)
        return np.asarray(np.log(np.maximum(failure, 1e-300)))

    try:
        at_rest = float(score(np.zeros(1), last)[0, 0])
    except InvalidInput:  # a limit beyond what double precision reaches
        return None
    return score if at_rest > np.log(LEAST) else None
