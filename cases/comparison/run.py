"""The run of a scene: the answers for each of its curves, stationary and in time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

from cases.comparison.answering import replies_of
from cases.comparison.answers import Answers
from cases.comparison.attempts import budget_of
from cases.comparison.in_time import Replies
from cases.comparison.stationary import answers_of
from cases.scene.questions import Question
from cases.scene.scene import Scene
from fpk.method import Method, Progress, silent


@dataclass(frozen=True)
class Outcome:
    """The curves of a scene, the scene's own first, and the seconds that their answers took."""

    scene: Scene
    curves: tuple[Answers, ...]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words; empty when all do."""
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
    """Return the answers of ``methods`` for every curve of ``scene``, as they are taken unasked.

    ``partial`` and ``relax`` as in ``answers_of``, ``tol`` as in ``replies_of``; once one was
    interrupted, the curves that follow are not run. The ``seconds`` of the simulations are shared
    as ``Budget`` says. ``save`` gets the outcome so far when the
    answers of a curve have been made, before they are compared.
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
        _ = answers.problems  # compares, once and for all: the comparisons are cached
        progress(k, len(scene.curves), "comparing")
    return Outcome(scene, tuple(curves), perf_counter() - start)
