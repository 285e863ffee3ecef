"""Stationary densities of a system by several methods, and the run of a scene."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial as partial_of
from math import inf
from time import perf_counter
from typing import Any

from cases.compare.answering import replies_of
from cases.compare.answers import Answers
from cases.compare.attempts import REFUSALS, Attempts, Budget
from cases.compare.in_time import Replies
from cases.scene.questions import Question
from cases.scene.scene import Scene
from cases.scene.written import bound
from fpk.answer.certificate import Certificate
from fpk.answer.density import Density
from fpk.answer.method import Method, Plan, Progress, Result, silent
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.numeric.errors import NotApplicable
from fpk.system.system import System


def joint_at_stops(system: System, observables: Sequence[Observable]) -> list[Observable]:
    """Return the unobserved pairs (q, p) of masses at stops with q observed, for impact rates."""
    touching = [Coordinate("q", i) for i in system.contact_masses]
    pairs = [(q, Coordinate("p", q.row)) for q in touching if (q,) in observables]
    return [pair for pair in pairs if pair not in observables]


def answers_of(
    system: System,
    observables: Sequence[Observable],
    methods: Sequence[Method],
    attempts: Attempts | None = None,
    *,
    share: float | None = None,
    rates: bool = False,
) -> Answers:
    """Return the answers of ``methods``, each for the observables that it gives.

    ``attempts`` must have no refusals yet; they are added to it. ``share``: the methods were not
    named, and each runs as its ``unasked`` with this share of the work; None: they were named.
    ``rates``: ``Result.beside`` gets the joint densities from which impact rates follow.
    """
    attempts = attempts or Attempts()
    offers: list[tuple[Method, Plan | str]] = []
    for method in methods:
        try:
            taken = method if share is None else method.unasked(system, share=share)
            offers.append((taken, taken.planned(system, ())))
        except NotApplicable as error:
            offers.append((method, str(error)))
    attempts.budget.begin(sum(m.route.sampled and isinstance(plan, Plan) for m, plan in offers))
    results: list[Result] = []
    for method, (taken, plan) in zip(methods, offers, strict=True):
        refuse = partial_of(attempts.refuse, method.route)
        reasons = {o: plan if isinstance(plan, str) else plan.refusal(o) for o in observables}
        for reason in dict.fromkeys(filter(None, reasons.values())):
            refuse((observable_name(o) for o, r in reasons.items() if r == reason), reason)
        given = [observable for observable, reason in reasons.items() if not reason]
        if not given:
            continue

        def solve(own: Any, taken: Method = taken, plan: Any = plan, given: Any = given) -> Result:
            """Return the answer of ``own``, at a looser tolerance if ``attempts`` relax."""
            beside = joint_at_stops(system, given) if rates else []
            plan = plan if own is taken else own.prepare(system)
            how: Any = {"beside": beside, "progress": attempts.progress}
            result: Result = own.solve(system, given, plan=plan, **how)

            def ask(tol: float | None) -> Result:
                if tol is None:
                    return result
                looser: Method = replace(result.method, tol=tol)  # type: ignore[type-var]
                return looser.solve(system, given, **how)

            def certificates(answer: Result) -> list[Certificate]:
                judged = answer.densities if hasattr(result.method, "tol") else ()
                return [density.certificate for density in judged]

            return attempts.at_default(result.method.route.label, ask, certificates)

        result = attempts.answer_of(
            method.route,
            map(observable_name, given),
            partial_of(attempts.budget.spend, taken, solve),
            failures=REFUSALS if taken is method else (),
        )
        if result is None:
            continue
        attempts.interrupted |= result.partial
        worst = max((d.l1_error for d in result.densities if isinstance(d, Density)), default=0.0)
        if taken is not method and worst > getattr(taken, "tol", inf):
            route = method.route
            attempts.notes.append(
                f"{route.label}: certified to {bound(worst)}; its work is bounded as no method was"
                f" named; fpk density --method {route.method} goes further"
            )
        results.append(result)
    refused, notes = tuple(attempts.refused), tuple(attempts.notes)
    return Answers(system, tuple(results), refused, notes=notes, interrupted=attempts.interrupted)


@dataclass(frozen=True)
class Outcome:
    """The answers for each curve of a scene, its own system first, and the computing time."""

    scene: Scene
    curves: tuple[Answers, ...]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words."""
        return tuple(text for curve in self.curves for text in curve.problems)


def run_scene(
    scene: Scene,
    methods: Sequence[Method],
    *,
    progress: Progress = silent,
    partial: bool = False,
    relax: bool = False,
    tol: float | None = None,
    save: Callable[[Outcome], object] = lambda outcome: None,
) -> Outcome:
    """Return the answers of ``methods`` for every curve of ``scene``, each method ``unasked``.

    ``partial``: Ctrl-C ends the work; later curves have no answers. ``relax``: default tolerances
    may be loosened. ``tol``: tolerance of the solvers for questions in time, None: their own. The
    ``seconds`` of the simulations are shared by a ``Budget``. ``save`` is called with the outcome
    so far after the answers of each curve, before they are compared.
    """
    start, share = perf_counter(), 1.0 / len(scene.curves)
    questions = 1 + len(scene.passages) + len(scene.transients)
    given = [s for m in methods if m.route.sampled and (s := getattr(m, "seconds", None))]
    budget = Budget(max(given, default=None), len(scene.curves) * questions)
    attempts = partial_of(Attempts, partial, relax, budget, progress)
    curves: list[Answers] = []
    for k, curve in enumerate(scene.curves, start=1):
        interrupted = any(c.interrupted for c in curves)
        wanted = [] if interrupted else methods
        of = curve.system, scene.observables, wanted, attempts()
        answers = answers_of(*of, share=share, rates=True)
        own: Any = {"label": curve.label, "value": curve.value, "exceedance": scene.exceedance}
        own["asked"] = scene.observables if scene.densities_asked else ()
        answers = replace(answers, **own)
        if not (interrupted or answers.interrupted):
            replies: list[Replies] = []
            asked: tuple[Question, ...] = (*scene.passages, *scene.transients)
            for question in asked:
                if any(r.interrupted for r in replies):
                    replies.append(Replies(question, interrupted=True))
                else:
                    asked_of = curve.system, question, methods, attempts()
                    replies.append(replies_of(*asked_of, tol=tol))
            count = len(scene.passages)
            absence = answers.absence if replies and answers.asked else None
            none = [f"no stationary density: {absence}"] if absence else []
            answers = replace(
                answers,
                passages=tuple(replies[:count]),
                transients=tuple(replies[count:]),
                notes=(*answers.notes, *none, *(note for r in replies for note in r.notes)),
                interrupted=any(r.interrupted for r in replies),
            )
        curves.append(answers)
        save(Outcome(scene, tuple(curves), perf_counter() - start))
        progress(k - 1, len(scene.curves), "comparing")
        _ = answers.problems  # compares now, under the progress bar; comparisons are cached
        progress(k, len(scene.curves), "comparing")
    return Outcome(scene, tuple(curves), perf_counter() - start)
