"""The answer of a run in one or two sentences."""

from cases.comparison.doubt import ACCEPTABLE_L1
from cases.output.records import Record
from cases.output.words import named
from cases.written import percent

RELIABILITY = "in P(T > t) at the times asked for"


def headline_of(curves: list[Record]) -> str:
    """Return how far each averaged theory is from the full system, in one sentence.

    Where the exact density of all curves is known, a sentence before it says so. Of each curve and
    theory it is the largest L1 distance of a density, each by the reference with which its error is
    least. Under modulated noise, which stationary densities know nothing of, the densities are
    those at the times of the [[transient]] tables, or else it is P(T > t) of the [[passage]]
    tables; without any the sentence says that it is about constant noise. Empty where nothing of it
    is known.
    """
    parts = []
    for curve in curves:
        asked, rows = _asked(curve)
        words = [_words(name, *row) for name, row in _worst(rows).items()]
        where = ", ".join(filter(None, [f"at {curve['label']}" * bool(curve["label"]), asked]))
        if words:
            parts.append((f"{where}: " if where else "") + ", ".join(words))
    sentences = []
    if all(curve["regime"]["incompatible"] is None for curve in curves):
        constant = curves[0]["system"]["modulation"] is None
        known = "known" if constant else "known under constant noise"
        sentences.append(f"The compatibility condition (8) holds: the exact density is {known}.")
    if parts:
        text = "; ".join(parts)
        sentences.append(text[0].upper() + text[1:] + ".")
    return " ".join(sentences)


def measure_of(curves: list[Record]) -> str:
    """Return in words what a distance in the answer of ``headline_of`` is; empty without one."""
    if not any(_asked(curve)[1] for curve in curves):
        return ""
    if _asked(curves[0])[0] == RELIABILITY:
        return "Largest difference of P(T > t), T the time of first passage"
    return "L1 distance ∫|p − p_full| of the density that is furthest off"


def _asked(curve: Record) -> tuple[str, list[Record]]:
    """Words for what the distances are of, empty for stationary densities, and the distances."""
    if curve["system"]["modulation"] is None:
        return "", curve["averaging"]
    for words, questions, norm in (
        ("at the times asked for", curve["transients"], "L1"),
        (RELIABILITY, curve["passages"], "absolute"),
    ):
        rows = [
            {**c, "theory": c["a"], "observable": question["question"]}
            for question in questions
            for c in question["comparisons"]
            if (c["measures"], c["norm"]) == ("averaging", norm)
        ]
        if rows:
            return words, rows
    return "under constant noise", curve["averaging"]


def _worst(rows: list[Record]) -> dict[str, tuple[float, float]]:
    """By theory the L1 distance of the density that is furthest off, and its error; best first.

    ``rows`` are those of ``_asked``; a theory's solution and its simulation count as one.
    """
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for row in sorted(rows, key=lambda row: row["error"]):
        name = named(row["theory"]).partition(",")[0]
        best.setdefault((name, row["observable"]), (row["L1"], row["error"]))
    ascending = sorted((distance, name) for (name, _), distance in best.items())
    worst = {name: distance for distance, name in ascending}
    return dict(sorted(worst.items(), key=lambda row: row[1]))


def _words(name: str, distance: float, error: float) -> str:
    if distance + error <= ACCEPTABLE_L1:
        return f"{name} is within {percent(distance + error, up=True)} of the full system"
    uncertain = f" (± {percent(error, up=True)})" if error > 0.05 * distance else ""
    return f"{name} is {percent(distance)} off{uncertain}"
