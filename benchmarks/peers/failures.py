"""What went wrong with an answer: found by rules in the measurements, not by hand."""

from collections import defaultdict
from collections.abc import Sequence

Line = dict
NEGATIVE = -1e-14
"""Smallest p / max p that counts as round-off: below it any answer is listed as negative."""
LOST = 1e-3
"""Defect of the mass from which it counts as lost or made."""
WRONG = 0.1
"""L1 error from which an answer counts as wrong; 2 is the most there can be with mass one."""
LEAST_ORDER = 1.0
"""Order in the unknowns an axis below which refining does not count as converging."""
GROWN = 2.0
"""Factor on the unknowns from which two settings tell an order."""
DIMENSION = {"W2": 2, "W3": 2, "W4": 2}


def failures(lines: Sequence[Line]) -> list[list[str]]:
    """Return rows: peer, problem, setting, what is wrong with the answer."""
    rows = []
    for line in lines:
        wrong = _of_one(line)
        if wrong:
            rows.append([line["peer"], line["problem"], line["setting"], "; ".join(wrong)])
    needs = {(line["peer"], line["note"].split("; ")[0]) for line in lines}
    helped = [[peer, "all", "all", note] for peer, note in needs if note.startswith("needs")]
    return rows + sorted(helped) + _slow(lines)


def _of_one(line: Line) -> list[str]:
    if line["L1"] is None:
        return [line["note"] or "no finite answer, without a word"]
    wrong = []
    if line["minimum"] is not None and line["minimum"] < NEGATIVE:
        wrong.append(f"negative density, to {line['minimum']:.0e} of the largest")
    if line["mass"] is not None and abs(line["mass"] - 1.0) > LOST:
        wrong.append(f"mass {line['mass']:.3g} in place of 1")
    if line["L1"] > WRONG:
        warned = "after a warning" if "warns" in line["note"] else "without a warning"
        wrong.append(f"wrong by {line['L1']:.2g}, {warned}")
    return wrong


def _slow(lines: Sequence[Line]) -> list[list[str]]:
    """Ladders of one kind of setting whose last refinement gains less than the first order."""
    ladders = defaultdict(list)
    for line in lines:
        if line["L1"]:
            kind = line["setting"].split(",")[0]
            ladders[line["peer"], line["problem"], kind].append(line)
    rows = []
    for (peer, problem, kind), ladder in ladders.items():
        if len(ladder) < 2 or peer == "vibro-fpk":
            continue
        coarse, fine = ladder[-2:]
        grown = (fine["unknowns"] / coarse["unknowns"]) ** (1.0 / DIMENSION.get(problem, 1))
        gain = coarse["L1"] / fine["L1"]
        if grown >= GROWN**0.9 and gain < grown**LEAST_ORDER:
            words = f"{grown:.2g} times the unknowns an axis lower the error {gain:.2g} times only"
            rows.append([peer, problem, kind, words])
    return rows
