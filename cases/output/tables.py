"""Results as text for a terminal."""

from typing import Any

from cases.comparison.run import Outcome
from cases.output.telling import ErrorsApart, errors_apart, told_comparisons, told_refusals


def run_text(outcome: Outcome) -> str:
    """Return the comparisons of every curve and the verdict."""
    lines = [outcome.scene.title, ""]
    for curve in outcome.curves:
        if curve.label:
            lines.append(curve.label)
        lines.append(f"  {'of':8}{'a':27}{'b':27}{'measures':11}{'L1':>9} {'allowed':>9}")
        for c in told_comparisons(curve.comparisons):
            allowed = "-" if c.band is None else f"{c.band:.2e}"
            verdict = "" if c.holds else "  FAILS"
            lines.append(
                f"  {c.observable:8}{c.a:27}{c.b:27}{c.measures:11}{c.L1:9.2e} {allowed:>9}"
                f"{verdict}"
            )
        lines += [_errors_line(e) for e in errors_apart(curve)]
        lines += [
            f"  {r.route}: {'failed' if r.failed else 'not taken'} ({', '.join(r.observables)}):"
            f" {r.reason}"
            for r in told_refusals(curve.refusals)
        ]
        lines.append("")
    lines += claims_lines(outcome)
    judged = sum(c.band is not None for curve in outcome.curves for c in curve.comparisons)
    verdict = f"{len(outcome.problems)} checks fail" if outcome.problems else "every check holds"
    lines.append(f"{judged} judged comparisons, {verdict}, {outcome.seconds:.1f} s")
    return "\n".join(lines)


def _errors_line(e: ErrorsApart) -> str:
    bias = "not measured"
    if e.step_bias is not None:
        bias = f"{e.step_bias[0]:.1e} ({e.step_bias[1]:.1e} by chance)"
    averaging = ", ".join(f"{theory} {distance:.1e}" for theory, distance, _ in e.averaging) or "-"
    return (
        f"  {e.observable:8}{e.route}: sampling error {e.sampling:.1e}; step bias {bias};"
        f" averaging error {averaging}"
    )


def claims_lines(outcome: Outcome) -> list[str]:
    """Return what became of the claims of the source, one line each."""
    if not outcome.findings:
        return []
    lines = ["What the source claims"]
    for f in outcome.findings:
        where = f"{f.curve}: " if f.curve else ""
        lines.append(f"  {f.verdict:14}{f.claim}; {where}{f.measured}")
    return [*lines, ""]


def density_text(record: dict[str, Any]) -> str:
    """Return the points, the density and its error in columns."""
    kind = "one standard error" if record["error_kind"] == "sampling" else "numerical error"
    lines = [f"# {record['observable']}   density   {kind}"]
    for point, value, error in zip(
        record["points"], record["density"], record["error"], strict=True
    ):
        at = point if isinstance(point, list) else [point]
        words = ["nan" if x is None else f"{x:.12g}" for x in (*at, value)]
        lines.append("  ".join([*words, "nan" if error is None else f"{error:.2g}"]))
    return "\n".join(lines)
