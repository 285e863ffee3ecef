"""Results as text for a terminal."""

from collections.abc import Sequence
from typing import Any

from cases.comparison.verify import Verified
from cases.output.digest import Record, curves_of, refusals_of, verdict_of


def run_text(digest: Record) -> str:
    """Return the comparisons of every curve and the verdict."""
    lines = [digest["title"], ""]
    for curve in curves_of(digest):
        lines += [curve["label"]] if curve["label"] else []
        lines.append(f"  {'of':8}{'a':27}{'b':27}{'measures':11}{'L1':>9} {'allowed':>9}")
        lines += [_comparison_line(c) for c in curve["comparisons"] if not c["repeats"]]
        lines += [_errors_line(e) for e in curve["errors"]]
        lines += [
            f"  {r['routes']}: {'failed' if r['failed'] else 'not taken'}"
            f" ({', '.join(r['observables'])}): {r['reason']}"
            for r in refusals_of(curve)
        ]
        lines.append("")
    if digest["claims"]:
        lines += ["What the source claims", *map(_claim_line, digest["claims"]), ""]
    return "\n".join([*lines, f"{verdict_of(digest)}, {digest['seconds']:.1f} s"])


def density_text(record: Record) -> str:
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


def verify_line(v: Verified, width: int) -> str:
    """Return the line of one scene, printed as soon as it is done."""
    verdict = "holds" if v.holds else f"{len(v.problems)} FAIL"
    return (
        f"{v.scene:{width}}  {verdict:8} {v.judged:4} comparisons judged,"
        f" {v.certificates:3} certificates, {v.seconds:5.1f} s"
    )


def verify_table(verified: Sequence[Verified]) -> str:
    """Return the final table, the claims that do not hold, and the verdict."""
    width = max(len("every scene"), *(len(v.scene) for v in verified))
    head = ("curves", "judged", "certified", "failing", "claims", "hold", "do not", "open", "s")
    lines = ["", f"{'scene':{width}}" + "".join(f"{h:>10}" for h in head)]
    rows = [(v.scene, _verify_row(v)) for v in verified]
    totals = [sum(column) for column in zip(*(row for _, row in rows), strict=True)]
    rows.append(("every scene", totals))
    for name, row in rows:
        lines.append(f"{name:{width}}" + "".join(f"{n:10d}" for n in row[:-1]) + f"{row[-1]:10.1f}")
    against = [(v.scene, f) for v in verified for f in v.claims if f.verdict == "does not hold"]
    if against:
        lines += ["", "Claims of the source that do not hold (findings, not failures)"]
    for name, f in against:
        where = f"{f.curve}: " if f.curve else ""
        lines.append(f"  {name:{width}}{f.claim}; {where}{f.measured}")
    failing = [v.scene for v in verified if not v.holds]
    verdict = f"fails: {', '.join(failing)}" if failing else "every check holds"
    return "\n".join([*lines, "", verdict])


def _verify_row(v: Verified) -> list[Any]:
    unknown = v.count("undecided") + v.count("not checked")
    claims = [len(v.claims), v.count("holds"), v.count("does not hold"), unknown]
    return [v.curves, v.judged, v.certificates, len(v.problems), *claims, v.seconds]


def _comparison_line(c: Record) -> str:
    allowed = "-" if c["band"] is None else f"{c['band']:.2e}"
    verdict = "" if c["holds"] else "  FAILS"
    return (
        f"  {c['observable']:8}{c['a']:27}{c['b']:27}{c['measures']:11}{c['L1']:9.2e} {allowed:>9}"
        f"{verdict}"
    )


def _errors_line(e: Record) -> str:
    bias = e["step_bias"]
    if not isinstance(bias, str):
        bias = f"{bias['L1']:.1e} ({bias['by_chance']:.1e} by chance)"
    averaging = ", ".join(f"{a['theory']} {a['L1']:.1e}" for a in e["averaging"]) or "-"
    return (
        f"  {e['observable']:8}{e['route']}: sampling error {e['sampling']:.1e}; step bias {bias};"
        f" averaging error {averaging}"
    )


def _claim_line(f: Record) -> str:
    where = f"{f['curve']}: " if f["curve"] else ""
    return f"  {f['verdict']:14}{f['claim']}; {where}{f['measured']}"
