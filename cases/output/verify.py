"""The record, the lines and the table of ``fpk verify``."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, get_args

from cases.comparison.claims import Verdict
from cases.comparison.run import Outcome
from cases.output.records import plain
from cases.output.text import claim_line

Row = dict[str, Any]

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

COLUMNS = ("curves", "judged", "certified", "failing", "claims", "hold", "do not", "open", "s")


def verify_row(outcome: Outcome) -> Row:
    """Return what the gate says of a scene; a curve about which nothing is judged is a problem."""
    unjudged = [
        f"{curve.label or outcome.scene.name}: no comparison was judged"
        for curve in outcome.curves
        if not curve.judged
    ]
    problems = [*outcome.problems, *unjudged]
    certificates = [
        density.certificate.certified
        for curve in outcome.curves
        for result in curve.results
        for density in result.densities
    ]
    row: Row = plain(
        {
            "scene": outcome.scene.name,
            "curves": len(outcome.curves),
            "judged": sum(curve.judged for curve in outcome.curves),
            "certificates": sum(certificates),
            "problems": problems,
            "claims": [asdict(f) for f in outcome.findings],
            "seconds": outcome.seconds,
            "holds": not problems,
        }
    )
    return row


def verify_record(rows: Sequence[Row]) -> Row:
    """Return the record of ``fpk verify``."""
    return {
        "scenes": list(rows),
        "holds": all(row["holds"] for row in rows),
        "claims": {word: sum(_verdicts(row)[word] for row in rows) for word in VERDICTS},
        "seconds": sum(row["seconds"] for row in rows),
    }


def verify_line(row: Row, width: int) -> str:
    """Return the line of one scene, printed as soon as it is done."""
    verdict = "holds" if row["holds"] else f"{len(row['problems'])} FAIL"
    return (
        f"{row['scene']:{width}}  {verdict:8} {row['judged']:4} comparisons judged,"
        f" {row['certificates']:3} certificates, {row['seconds']:5.1f} s"
    )


def verify_table(rows: Sequence[Row]) -> str:
    """Return the final table, the claims that do not hold, and the verdict."""
    width = max(len("every scene"), *(len(row["scene"]) for row in rows))
    table = {row["scene"]: _numbers(row) for row in rows}
    table["every scene"] = [sum(column) for column in zip(*table.values(), strict=True)]
    lines = ["", f"{'scene':{width}}" + "".join(f"{h:>10}" for h in COLUMNS)]
    lines += [
        f"{name:{width}}" + "".join(f"{n:10d}" for n in numbers[:-1]) + f"{numbers[-1]:10.1f}"
        for name, numbers in table.items()
    ]
    against = [
        f"  {row['scene']:{width}}{claim_line(claim)}"
        for row in rows
        for claim in row["claims"]
        if claim["verdict"] == "does not hold"
    ]
    if against:
        lines += ["", "Claims of the source that do not hold (findings, not failures)", *against]
    failing = ", ".join(row["scene"] for row in rows if not row["holds"])
    return "\n".join([*lines, "", f"fails: {failing}" if failing else "every check holds"])


def _verdicts(row: Row) -> Counter[str]:
    return Counter(claim["verdict"] for claim in row["claims"])


def _numbers(row: Row) -> list[Any]:
    verdicts = _verdicts(row)
    unknown = verdicts["undecided"] + verdicts["not checked"]
    claims = [len(row["claims"]), verdicts["holds"], verdicts["does not hold"], unknown]
    failing = len(row["problems"])
    return [row["curves"], row["judged"], row["certificates"], failing, *claims, row["seconds"]]
