"""The main job: every curve of a scene by every route that applies, and what they say together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

from cases.comparison.answers import Answers, answers_of
from cases.comparison.claims import Finding, findings
from cases.scene.scene import Scene
from fpk.method import Method, Progress, silent


@dataclass(frozen=True)
class Outcome:
    """The curves of a scene, the scene's own first, and the seconds that their answers took.

    ``findings`` says what became of the claims in ``[expect]``; they do not count as problems.
    """

    scene: Scene
    curves: tuple[Answers, ...]
    seconds: float
    findings: tuple[Finding, ...] = ()

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words; empty when all do."""
        return tuple(text for curve in self.curves for text in curve.problems)


def run_scene(scene: Scene, methods: Sequence[Method], *, progress: Progress = silent) -> Outcome:
    """Return the answers of ``methods`` for every curve of ``scene``.

    Once a simulation was interrupted, the curves that follow are not run.
    """
    start = perf_counter()
    curves: list[Answers] = []
    for curve in scene.curves:
        interrupted = any(r.partial for c in curves for r in c.results)
        wanted = [m for m in methods if not interrupted and m.route.unasked(curve.system)]
        answers = answers_of(curve.system, scene.observables, wanted, progress=progress)
        curves.append(replace(answers, label=curve.label, value=curve.value))
    claims = findings(scene.expect, curves)
    return Outcome(scene, tuple(curves), perf_counter() - start, claims)
