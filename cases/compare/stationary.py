"""Stationary densities of a system by several methods, and the run of a scene."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial as partial_of
from math import inf
from time import perf_counter
from typing import Any

from cases.compare.answering import replies_of
from cases.compare.answers import Answers
from cases.compare.attempts import INTERRUPTED, REFUSALS, Attempts, Budget, budget_of
from cases.compare.in_time import Replies
from cases.scene.questions import Question
from cases.scene.scene import Scene
from cases.scene.written import bound
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
    *,
    progress: Progress = silent,
    partial: bool = False,
    relax: bool = False,
    share: float | None = None,
    rates: bool = False,
    budget: Budget | None = None,
) -> Answers:
    """Return the answers of ``methods``, each for the observables that it gives.

    ``share``: the methods were not named, and each runs as its ``unasked`` with this share of the
    work; None: they were named. ``partial``: Ctrl-C ends the work, the answers so far are returned.
    ``relax``: all tolerances are defaults; a missed one is ``loosened``, with a note. ``rates``:
    the joint densities from which impact rates follow are computed ``beside``. ``budget``: wall
    time of the simulations.
    """
    budget = budget or Budget()
    budget.begin(sum(m.route.sampled and _is_taken(m, system, share) for m in methods))
    results: list[Result] = []
    attempts = Attempts(partial, relax)
    for method in methods:
        refuse = partial_of(attempts.refuse, method.route)
        if attempts.interrupted:
            refuse(map(observable_name, observables), INTERRUPTED)
            continue
        reasons: dict[Observable, str | None]
        try:
            taken = method if share is None else method.unasked(system, share=share)
            plan = taken.planned(system, ())
            reasons = {observable: plan.refusal(observable) for observable in observables}
        except NotApplicable as error:
            reasons = dict.fromkeys(observables, str(error))
        for reason in dict.fromkeys(filter(None, reasons.values())):
            refuse((observable_name(o) for o, r in reasons.items() if r == reason), reason)
        given = [observable for observable, reason in reasons.items() if not reason]
        if not given:
            continue

        def solve(own: Method, taken: Method = taken, plan: Plan = plan, given: Any = given) -> Any:
            plan = plan if own is taken else own.prepare(system)
            answer = partial_of(own.solve, plan=plan, progress=progress)
            return _solve_curve(answer, system, given, attempts, progress, rates)

        result = attempts.answer_of(
            method.route,
            map(observable_name, given),
            partial_of(budget.spend, taken, solve),
            failures=REFUSALS if taken is method else (),
        )
        if result is None:
            continue
        attempts.interrupted |= result.partial
        if taken is not method and _worst_error(result) > getattr(taken, "tol", inf):
            route = method.route
            attempts.notes.append(
                f"{route.label}: certified to {bound(_worst_error(result))}; its work is bounded"
                f" as no method was named; fpk density --method {route.method} goes further"
            )
        results.append(result)
    refused, notes = tuple(attempts.refused), tuple(attempts.notes)
    return Answers(system, tuple(results), refused, notes=notes, interrupted=attempts.interrupted)


def _is_taken(method: Method, system: System, share: float | None) -> bool:
    """Whether the method, named (``share`` None) or unasked, applies to the system."""
    try:
        (method if share is None else method.unasked(system, share=share)).planned(system, ())
    except NotApplicable:
        return False
    return True


def _solve_curve(
    solve: Callable[..., Result],
    system: System,
    observables: Sequence[Observable],
    attempts: Attempts,
    progress: Progress,
    rates: bool,
) -> Result:
    """The answer by ``solve``, at a looser tolerance if ``attempts`` relax."""
    beside = joint_at_stops(system, observables) if rates else []
    result = solve(system, observables, beside=beside)

    def ask(tol: float | None) -> Result:
        if tol is None:
            return result
        method: Any = replace(result.method, tol=tol)  # type: ignore[type-var]  # methods are dataclasses
        again: Result = method.solve(system, observables, beside=beside, progress=progress)
        return again

    own = hasattr(result.method, "tol")
    label = result.method.route.label
    return attempts.at_default(
        label, ask, lambda r: [d.certificate for d in r.densities] if own else []
    )


def _worst_error(result: Result) -> float:
    """Largest L1 error that a solver states, 0 for samples."""
    return max((d.l1_error for d in result.densities if isinstance(d, Density)), default=0.0)


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

    ``partial``: Ctrl-C ends the work; later curves are not run. ``relax``: default tolerances may
    be loosened. ``tol``: tolerance of the solvers for questions in time, None: their own. The
    ``seconds`` of the simulations are shared by a ``Budget``. ``save`` is called with the outcome
    so far after the answers of each curve, before they are compared.
    """
    start, share = perf_counter(), 1.0 / len(scene.curves)
    questions = 1 + len(scene.passages) + len(scene.transients)
    budget = budget_of(methods, len(scene.curves) * questions)
    options: Any = {"progress": progress, "partial": partial, "relax": relax, "budget": budget}
    curves: list[Answers] = []
    for k, curve in enumerate(scene.curves, start=1):
        interrupted = any(c.interrupted for c in curves)
        wanted = [] if interrupted else methods
        stationary: Any = {"share": share, "rates": True, **options}
        answers = answers_of(curve.system, scene.observables, wanted, **stationary)
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
                    replies.append(replies_of(curve.system, question, methods, tol=tol, **options))
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
