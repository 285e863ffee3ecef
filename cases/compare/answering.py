"""Answers to one question in time: windows of densities, splitting for rare failure."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from functools import partial as partial_of
from operator import methodcaller
from time import perf_counter
from typing import Any

import numpy as np

from cases.compare.attempts import Attempts, Budget
from cases.compare.in_time import Given, Replies
from cases.compare.rare import SPLITTING, split_passage, splitting_of
from cases.compare.routes import with_settings
from cases.scene.questions import PassageQuestion, Question, TransientQuestion
from fpk.answer.dynamics import Passage
from fpk.answer.method import Method, silent
from fpk.answer.question import QUESTIONS
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.system import System
from sim.questions.passage import LEAST_TAIL_FAILURES
from sim.sample.settings import LEAST_PATHS

WINDOW_POINTS = 129
"""Number of equidistant points in a window, the interval in which p at one time is compared."""

WINDOW_SHARE = 1e-3
"""Density at the edge of a window over the largest density; also the L1 tolerance of the quick
solution by which windows are chosen."""

DECADES, SCALES, MANY = (-8.0, 3.0), 12.0, 4401
"""``MANY`` points of the quick solution: energies from 1e-8 to 1e3 of the energy scale E and 0, or
displacements and momenta within ± ``SCALES`` of their values at the energy E."""


def replies_of(
    system: System,
    question: Question,
    methods: Sequence[Method],
    attempts: Attempts | None = None,
    *,
    tol: float | None = None,
) -> Replies:
    """Return the answers of all ``methods`` that can answer ``question``; others are ignored.

    ``attempts`` must have no refusals yet; refusals and notes are added to it. ``tol``: tolerance
    of solvers that do not sample, None, or if ``attempts`` relax: their defaults. Simulations of a
    first passage run until the last time, unless too few would fail by an earlier certified answer.
    Splitting replaces the simulation of the full system if no answer of this system is certified.
    """
    attempts, names = attempts or Attempts(), (question.name,)
    budget = attempts.budget
    kind = QUESTIONS["passage" if isinstance(question, PassageQuestion) else "transient"]
    able: list[Any] = [method for method in methods if hasattr(method, kind.name)]
    # One more for splitting, or for the choice of the window.
    budget.begin(1 + sum(method.route.sampled for method in able))
    given: list[Given] = []

    @cache
    def window() -> tuple[Array | None, tuple[Any, ...]]:
        if isinstance(question, TransientQuestion) and able:
            return window_of(system, question, able, budget)
        return None, ()

    def ask(route: Any, work: Any) -> bool:
        def timed() -> Given:
            points, _ = window()
            start = perf_counter()
            return Given(route, work(points), perf_counter() - start)

        answer = attempts.answer_of(route, names, timed, failures=(NotCertified, InvalidInput))
        given.extend([answer] if answer else [])
        return answer is not None

    def answered(points: Array | None, method: Any) -> Any:
        bounds: dict[str, Any] = {"checkpoint": None, "partial": False}
        if isinstance(question, PassageQuestion) and question.times:
            last = bounds["time"] = question.times[-1]
            known = (g.answer for g in given if g.answer.certificate.certified)
            share = max([1.0 - x.survival[-1] for x in known if isinstance(x, Passage)], default=1)
            # Twice the failures that leave a tail, and twice that for chance.
            if method.route.sampled and method.paths * share < 4.0 * LEAST_TAIL_FAILURES:
                words = f"{share:.2g} of the paths are expected to fail by t = {last:g}"
                raise NotApplicable(f"too rare for plain simulation: {words}")
        bounded: Any = with_settings(method, bounds)
        start, times = question.start, np.array(question.times)

        def at_tolerance(tol: float | None) -> Any:
            how: Any = {"tol": tol, "progress": attempts.progress}
            if isinstance(question, PassageQuestion):
                return bounded.passage(system, question.limit, start, times, **how)
            return bounded.transient(system, question.of, start, times, (points,), **how)

        if not attempts.relax:
            return at_tolerance(None if method.route.sampled else tol)
        label = f"{question.name}: {method.route.label}"
        return attempts.at_default(label, at_tolerance, lambda answer: [answer.certificate])

    for method in able:
        ask(method.route, lambda points, m=method: budget.spend(m, partial_of(answered, points)))
    if isinstance(question, PassageQuestion) and not attempts.interrupted:
        # Splitting is for constant noise only.
        known = any(g.answer.certificate.certified for g in given if g.route.solves == "full")
        asked = question.times and system.modulation is None and not known
        plain = next((m for m in able if m.route.solves == "full" and m.route.sampled), None)

        def split(own: Any) -> Passage:
            settings, later = splitting_of(own), sum(t > 0.0 for t in question.times)
            if budget.seconds is not None:
                settings = replace(settings, seconds=settings.seconds / max(1, later))
            return split_passage(system, question, settings, progress=attempts.progress)

        if plain and asked and ask(SPLITTING, lambda _: budget.spend(plain, split)):
            replaced = [g for g in given if g.route == plain.route]
            given = [g for g in given if g not in replaced]
            for words in (w for g in replaced for w in g.answer.certificate.failures):
                attempts.refuse(plain.route, names, words)
    points, windows = window() if given else (None, ())
    ends = attempts.interrupted, tuple(attempts.notes)
    return Replies(question, tuple(given), tuple(attempts.refused), points, windows, *ends)


def window_of(
    system: System, question: TransientQuestion, methods: Sequence[Any], budget: Budget
) -> tuple[Array, tuple[Any, ...]]:
    """Return ascending points, and for each time the indices (``WINDOW_POINTS``,) of its window.

    The points are of all windows together. Windows follow from a quick answer of the first of
    ``methods`` that gives one within the ``budget``; without any there are no windows, and the
    points are ``MANY`` over all scales.
    """
    (coordinate,), values = question.of, question.start.values
    damping, noise = np.diag(system.damping), np.diag(system.noise_matrix)
    warm = noise.sum() / damping.sum() if damping.sum() > 0.0 else noise.sum()
    energy = float(max(warm, 1e-300) * max(1.0, values.get("noise", 1.0)))
    energy = max([energy, *(v for k, v in values.items() if k.startswith("H"))])
    if question.start.kind == "state":
        energy = max(energy, float(system.hamiltonian(*question.start.state(system.n))))
    if coordinate.kind == "H":  # points up to the larger scale: by the noise, or by the start
        at = np.concatenate([[0.0], energy * np.logspace(*DECADES, MANY)])
    else:
        row = coordinate.row
        unit = system.mass[row] if coordinate.kind == "p" else system.compliance[row, row]
        at = np.linspace(-SCALES, SCALES, MANY) * float(np.sqrt(2.0 * energy * unit))
    asked = system, question.of, question.start, np.array(question.times), (at,)
    few = {"paths": LEAST_PATHS, "checkpoint": None, "partial": False}
    for method in methods:
        tol = None if method.route.sampled else WINDOW_SHARE
        ask = methodcaller("transient", *asked, tol=tol, progress=silent)
        try:
            answer = budget.spend(with_settings(method, few), ask)
            grids = []
            for density in answer.values:
                inside = np.flatnonzero(density > WINDOW_SHARE * density.max())
                if not inside.size:
                    raise NotCertified("no density is seen at any energy or displacement")
                low, high = max(inside[0] - 1, 0), min(inside[-1] + 1, at.size - 1)
                grids.append(np.linspace(at[low], at[high], WINDOW_POINTS))
        except (NotApplicable, NotCertified, InvalidInput):
            continue  # its full answer will give the reason
        points = np.unique(np.concatenate(grids))
        return points, tuple(np.searchsorted(points, grid) for grid in grids)
    return at, ()
