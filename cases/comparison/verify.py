"""The regression gate: scenes by every route, with a shorter simulation, and one table."""

from dataclasses import dataclass

from cases.comparison.claims import Finding, Verdict
from cases.comparison.routes import all_methods
from cases.comparison.run import Outcome, run_scene
from cases.scene.scene import Scene
from fpk.method import Progress, silent

USUAL, COARSE, COARSE_PATHS = 38.0, 5.0, 4096
"""Relaxation times sampled on a path: a quarter of what ``fpk run`` takes. Bands are from the
sample itself, so that a shorter simulation judges less sharply, never wrongly."""

VERDICTS: tuple[Verdict, ...] = ("holds", "does not hold", "undecided", "not checked")


@dataclass(frozen=True)
class Verified:
    """The verdict of the gate on one scene; it passes where there are no ``problems``."""

    scene: str
    curves: int
    judged: int
    certificates: int
    problems: tuple[str, ...]
    claims: tuple[Finding, ...]
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether every judged comparison and every certificate holds."""
        return not self.problems

    def count(self, verdict: Verdict) -> int:
        """Return how many claims of the source ended so."""
        return sum(f.verdict == verdict for f in self.claims)


def verify_scene(
    scene: Scene,
    *,
    coarse: bool = False,
    seed: int | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Verified:
    """Return what every route says of ``scene``, held against each other.

    ``coarse`` is for a quick look: a still shorter simulation.
    """
    methods = all_methods(
        seed=seed,
        threads=threads,
        paths=COARSE_PATHS if coarse else None,
        relaxations=COARSE if coarse else USUAL,
    )
    return verified(run_scene(scene, methods, progress=progress))


def verified(outcome: Outcome) -> Verified:
    """Return the gate's view of an outcome; a curve about which nothing is judged is a problem."""
    problems = list(outcome.problems)
    problems += [
        f"{curve.label or outcome.scene.name}: no comparison was judged"
        for curve in outcome.curves
        if all(c.band is None for c in curve.comparisons)
    ]
    return Verified(
        scene=outcome.scene.name,
        curves=len(outcome.curves),
        judged=sum(c.band is not None for curve in outcome.curves for c in curve.comparisons),
        certificates=sum(
            d.certificate.certified
            for curve in outcome.curves
            for result in curve.results
            for d in result.densities
        ),
        problems=tuple(problems),
        claims=outcome.findings,
        seconds=outcome.seconds,
    )
