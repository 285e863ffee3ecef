"""Records of the regression gate ``fpk verify``: a row for each scene, and all of them."""

from collections import Counter
from collections.abc import Sequence
from typing import get_args

from cases.comparison.claims import Verdict
from cases.output.digest import curves_of
from cases.output.records import Record


def verify_row(digest: Record) -> Record:
    """Return what the gate says of a scene; a curve about which nothing is judged is a problem."""
    curves = curves_of(digest)
    unjudged = [
        f"{curve['label'] or digest['scene']}: no comparison was judged"
        for curve in curves
        for part in [(curve, *curve["passages"], *curve["transients"])]
        if all(c["band"] is None for answers in part for c in answers["comparisons"])
    ]
    problems = [*digest["problems"], *unjudged]
    taken = [method for curve in curves for method in curve["methods"] if method["applies"]]
    in_time = [
        answer["certificate"]["certified"]
        for curve in curves
        for question in curve["passages"] + curve["transients"]
        for answer in question["answers"]
    ]
    return {
        "scene": digest["scene"],
        "curves": len(curves),
        "judged": digest["judged"],
        "certificates": sum(
            [d["certificate"]["certified"] for m in taken for d in m["densities"]] + in_time
        ),
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
        "claims": {word: verdicts[word] for word in get_args(Verdict)},
        "seconds": sum(row["seconds"] for row in rows),
    }
