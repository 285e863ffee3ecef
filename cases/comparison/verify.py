"""The regression gate: scenes by every route, with a shorter simulation, and one table."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from cases.comparison.claims import Finding, Verdict
from cases.comparison.routes import Sampling, all_methods
from cases.comparison.run import Outcome, run_scene
from cases.output.summary import plain
from cases.scene.scene import Scene
from fpk.method import Progress, silent

USUAL, COARSE, COARSE_PATHS = 38.0, 5.0, 4096
"""Relaxation times sampled on a path: a quarter of what ``fpk run`` takes. Bands are from the
sample itself, so that a shorter simulation judges less sharply, never wrongly."""

VERDICTS: tuple[Verdict, ...] = ("holds", "does not hold", "undecided", "not checked")


@dataclass(frozen=True)
class Verified:
    """What the gate found for one scene; it passes where there are no ``problems``."""

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
    sampling = Sampling(
        seed=seed,
        threads=threads,
        paths=COARSE_PATHS if coarse else None,
        relaxations=COARSE if coarse else USUAL,
    )
    return verified(run_scene(scene, all_methods(sampling=sampling), progress=progress))


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


def verify_record(found: Sequence[Verified]) -> dict[str, Any]:
    """Return the record of ``fpk verify``."""
    record: dict[str, Any] = plain(
        {
            "scenes": [{**asdict(v), "holds": v.holds} for v in found],
            "holds": all(v.holds for v in found),
            "claims": {word: sum(v.count(word) for v in found) for word in VERDICTS},
            "seconds": sum(v.seconds for v in found),
        }
    )
    return record


def verify_line(v: Verified, width: int) -> str:
    """Return the line of one scene, printed as soon as it is done."""
    verdict = "holds" if v.holds else f"{len(v.problems)} FAIL"
    return (
        f"{v.scene:{width}}  {verdict:8} {v.judged:4} comparisons judged,"
        f" {v.certificates:3} certificates, {v.seconds:5.1f} s"
    )


def verify_table(found: Sequence[Verified]) -> str:
    """Return the final table, the claims that do not hold, and the verdict."""
    width = max(len("every scene"), *(len(v.scene) for v in found))
    head = ("curves", "judged", "certified", "failing", "claims", "hold", "do not", "open", "s")
    lines = ["", f"{'scene':{width}}" + "".join(f"{h:>10}" for h in head)]
    rows = [(v.scene, _row(v)) for v in found]
    rows.append(
        ("every scene", [sum(column) for column in zip(*(r for _, r in rows), strict=True)])
    )
    for name, row in rows:
        lines.append(f"{name:{width}}" + "".join(f"{n:10d}" for n in row[:-1]) + f"{row[-1]:10.1f}")
    against = [(v.scene, f) for v in found for f in v.claims if f.verdict == "does not hold"]
    if against:
        lines += ["", "Claims of the source that do not hold (findings, not failures)"]
    for name, f in against:
        where = f"{f.curve}: " if f.curve else ""
        lines.append(f"  {name:{width}}{f.claim}; {where}{f.measured}")
    failing = [v.scene for v in found if not v.holds]
    verdict = f"fails: {', '.join(failing)}" if failing else "every check holds"
    return "\n".join([*lines, "", verdict])


def _row(v: Verified) -> list[Any]:
    unknown = v.count("undecided") + v.count("not checked")
    claims = [len(v.claims), v.count("holds"), v.count("does not hold"), unknown]
    return [v.curves, v.judged, v.certificates, len(v.problems), *claims, v.seconds]
