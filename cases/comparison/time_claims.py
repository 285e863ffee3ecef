"""Claims of a scene about averaging errors of first passage, held against what was measured."""

from collections.abc import Iterator, Sequence

from cases.comparison.answers import Answers
from cases.comparison.claims import Finding, verdict_within
from cases.comparison.compare import Comparison
from cases.scene.expect import RELATIONS, Range
from cases.scene.questions import PassageQuestion
from cases.written import with_error


def time_findings(curves: Sequence[Answers]) -> Iterator[Finding]:
    """Yield what became of every claim of a [[passage]] on every curve."""
    for curve in curves:
        for replies in curve.passages:
            question = replies.question
            assert isinstance(question, PassageQuestion)
            for words, limits in (
                ("failure rate", question.rate_error),
                ("P(T ≤ ", question.failure_error),
            ):
                if limits is not None:
                    own = [c for c in replies.comparisons if _is_of(c, question, words)]
                    yield _finding(curve.label, question, words, limits, own)


def _finding(
    label: str, question: PassageQuestion, words: str, limits: Range, own: Sequence[Comparison]
) -> Finding:
    sign, _ = RELATIONS[limits.relation]
    what = "P(T ≤ t)" if words.startswith("P") else words
    claim = (
        f"{question.name}: averaging error of the {what} by the {question.theory} theory"
        f" {sign} {limits.limit:g}"
    )
    if not own:
        return Finding(claim, label, "no answer to compare with", "not checked")
    c = min(own, key=lambda c: c.error)
    measured = f"relative {with_error(c.L1, c.error)}, {c.a.label} against {c.b.label}"
    return Finding(claim, label, measured, verdict_within(c.L1, 2.0 * c.error, limits))


def _is_of(c: Comparison, question: PassageQuestion, words: str) -> bool:
    """Whether the comparison is one of the theory's equation, solved, with the full system."""
    of = c.observable.removeprefix(f"{question.name}: ")
    averaging = c.measures == "averaging" and c.norm == "relative"
    return averaging and of.startswith(words) and c.a.method == question.theory
