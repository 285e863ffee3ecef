"""Results as text for a terminal."""

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
        claims = [f"  {claim['verdict']:14}{claim_line(claim)}" for claim in digest["claims"]]
        lines += ["What the source claims", *claims, ""]
    return "\n".join([*lines, f"{verdict_of(digest)}, {digest['seconds']:.1f} s"])


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


def claim_line(claim: Record) -> str:
    """Return the claim, the curve that it is about and what was measured."""
    where = f"{claim['curve']}: " if claim["curve"] else ""
    return f"{claim['claim']}; {where}{claim['measured']}"
