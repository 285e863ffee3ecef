"""Averaging rows once for each pair of theories, refusals with the same reason joined."""

from cases.compare.attempts import Refusal
from cases.compare.compare import Comparison
from cases.compare.routes import register_routes
from cases.show.digest import comparison_rows, refusal_record
from cases.show.text import refusals_of
from fpk.answer.method import ROUTES

register_routes()

FEM, CLOSED = ROUTES["nonintegrable", "fem"], ROUTES["nonintegrable", "closed-form"]
MODAL, SAMPLED = ROUTES["integrable", "closed-form"], ROUTES["integrable", "simulation"]
MONTE_CARLO, LINEAR = ROUTES["montecarlo", "simulation"], ROUTES["linear", "closed-form"]


def row(a, b, measures="averaging"):
    return Comparison("q2", a, b, measures, 0.1, None, 0.0)


def test_solvers_of_one_theory_are_not_repeated():
    rows = comparison_rows(
        [
            row(FEM, CLOSED, "numerical"),
            row(FEM, MONTE_CARLO),
            row(CLOSED, MONTE_CARLO),
            row(FEM, MODAL),
            row(MODAL, SAMPLED, "sampling"),
            row(ROUTES["integrable", "fem"], MONTE_CARLO),
            row(SAMPLED, MONTE_CARLO),
        ]
    )
    assert [r["repeats"] for r in rows] == [False, False, True, False, False, False, False]


def test_one_reason_is_given_once():
    refusals = [
        Refusal(FEM, ("H1",), "H1: knows the total energy only"),
        Refusal(
            ROUTES["nonintegrable", "quadrature"], ("H1", "H2"), "H1: knows the total energy only"
        ),
        Refusal(FEM, ("H2",), "H2: knows the total energy only"),
        Refusal(LINEAR, ("q2",), "has contacts"),
        Refusal(LINEAR, ("q1",), "has contacts", failed=True),
    ]
    first, second, third = refusals_of({"methods": list(map(refusal_record, refusals))})
    assert first == {
        "routes": "energy averaging (fem, quadrature)",
        "observables": ["H1", "H2"],
        "reason": "knows the total energy only",
        "failed": False,
        "gave_up": False,
        "methods": {"nonintegrable": {"fem": None, "quadrature": None}},
    }
    assert (second["routes"], second["failed"], third["failed"]) == ("Gaussian", False, True)
