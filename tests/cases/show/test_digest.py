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


def test_solvers_of_one_theory_are_not_repeated():
    pairs = [
        (FEM, CLOSED, "numerical", False),
        (FEM, MONTE_CARLO, "averaging", False),
        (CLOSED, MONTE_CARLO, "averaging", True),
        (FEM, MODAL, "averaging", False),
        (MODAL, SAMPLED, "sampling", False),
        (ROUTES["integrable", "fem"], MONTE_CARLO, "averaging", False),
        (SAMPLED, MONTE_CARLO, "averaging", False),
    ]
    rows = comparison_rows(
        [Comparison("q2", a, b, kind, 0.1, None, 0.0) for a, b, kind, _ in pairs]
    )
    assert [r["repeats"] for r in rows] == [repeats for *_, repeats in pairs]


def test_one_reason_is_given_once():
    words = "H1: knows the total energy only"
    refusals = [
        Refusal(FEM, ("H1",), words),
        Refusal(ROUTES["nonintegrable", "quadrature"], ("H1", "H2"), words),
        Refusal(FEM, ("H2",), words.replace("H1", "H2")),
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
