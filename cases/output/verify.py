"""The record, the lines and the table of ``fpk verify``, from the digest of each scene."""

from collections import Counter
from collections.abc import Sequence
from typing import get_args

from cases.comparison.claims import Verdict
from cases.output.digest import curves_of
from cases.output.records import Record
from cases.output.text import rendered

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

COLUMNS = ("curves", "judged", "certified", "failing", "claims", "hold", "do not", "open", "s")


def verify_row(digest: Record) -> Record:
    """Return what the gate says of a scene; a curve about which nothing is judged is a problem."""
    curves = curves_of(digest)
    unjudged = [
        f"{curve['label'] or digest['scene']}: no comparison was judged"
        for curve in curves
        if all(comparison["band"] is None for comparison in curve["comparisons"])
    ]
    problems = [*digest["problems"], *unjudged]
    taken = [method for curve in curves for method in curve["methods"] if method["applies"]]
    return {
        "scene": digest["scene"],
        "curves": len(curves),
        "judged": digest["judged"],
        "certificates": sum(d["certificate"]["certified"] for m in taken for d in m["densities"]),
        "problems": problems,
        "claims": digest["claims"],
        "seconds": digest["seconds"],
        "holds": not problems,
    }


def verify_record(rows: Sequence[Record]) -> Record:
    """Return the record of ``fpk verify``."""
    verdicts = Counter(claim["verdict"] for row in rows for claim in row["claims"])
    return {
        "scenes": list(rows),
        "holds": all(row["holds"] for row in rows),
        "claims": {word: verdicts[word] for word in VERDICTS},
        "seconds": sum(row["seconds"] for row in rows),
    }


def verify_line(row: Record, width: int) -> str:
    """Return the line of one scene, printed as soon as it is done."""
    verdict = "holds" if row["holds"] else f"{len(row['problems'])} FAIL"
    return (
        f"{row['scene']:{width}}  {verdict:8} {row['judged']:4} comparisons judged,"
        f" {row['certificates']:3} certificates, {row['seconds']:5.1f} s"
    )


def verify_table(rows: Sequence[Record]) -> str:
    """Return the final table, the claims that do not hold, and the verdict."""
    table = {row["scene"]: _numbers(row) for row in rows}
    table["every scene"] = [sum(column) for column in zip(*table.values(), strict=True)]
    claims = [(row["scene"], claim) for row in rows for claim in row["claims"]]
    record = {
        "columns": COLUMNS,
        "table": table,
        "width": max(map(len, table)),
        "against": [(name, c) for name, c in claims if c["verdict"] == "does not hold"],
        "failing": [row["scene"] for row in rows if not row["holds"]],
    }
    return rendered("verify.txt", record)


def _numbers(row: Record) -> list[float]:
    """The entries of one row, in the order of ``COLUMNS``."""
    verdicts = Counter(claim["verdict"] for claim in row["claims"])
    counts = [row[key] for key in ("curves", "judged", "certificates")]
    lengths = [len(row["problems"]), len(row["claims"])]
    open_claims = verdicts["undecided"] + verdicts["not checked"]
    claims = [verdicts["holds"], verdicts["does not hold"], open_claims]
    return [*counts, *lengths, *claims, row["seconds"]]
