"""What a reader is told: averaging rows once for each pair of theories, reasons joined."""

from cases.comparison.compare import Comparison
from cases.comparison.run import Refusal
from cases.output.telling import told_comparisons, told_refusals


def row(a: str, b: str, measures: str = "averaging") -> Comparison:
    return Comparison("q2", a, b, measures, 0.1, None, 0.0, True)  # type: ignore[arg-type]


def test_solvers_of_one_theory_are_not_repeated():
    fem, closed = "nonintegrable/fem", "nonintegrable/closed-form"
    rows = [
        row(fem, closed, "numerical"),
        row(fem, "montecarlo"),
        row(closed, "montecarlo"),
        row(fem, "integrable/closed-form"),
        row("integrable/closed-form", "integrable/simulation", "sampling"),
        row("integrable/fem", "montecarlo"),
        row("integrable/simulation", "montecarlo"),
    ]
    assert told_comparisons(rows) == (*rows[:2], *rows[3:])


def test_one_reason_is_told_once():
    refusals = [
        Refusal("nonintegrable/fem", ("H1",), "H1: knows the total energy only"),
        Refusal("nonintegrable/quadrature", ("H1", "H2"), "H1: knows the total energy only"),
        Refusal("linear", ("q2",), "has contacts"),
        Refusal("linear", ("q1",), "has contacts", failed=True),
    ]
    first, second, third = told_refusals(refusals)
    assert first == Refusal(
        "nonintegrable/fem|quadrature", ("H1", "H2"), "knows the total energy only"
    )
    assert (second.route, second.failed, third.failed) == ("linear", False, True)
