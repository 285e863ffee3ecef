"""Modal energies in time: finite elements against closed forms, and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from asked import assert_agree, assert_near, passage, transient
from modal_terms import modal_van_der_pol
from mpmath import findroot, hyp1f1
from numpy.testing import assert_allclose

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from fpk import Contact, System
from fpk.answer.method import silent
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.solvers.square_root import SquareRoot
from fpk.system.modulation import Modulation

FIG8 = System([1.0, 1.0], [1.0, 1.0], [0.05, 0.07], [0.015, 0.015])
ALIKE = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05, 0.05])
FADING = replace(FIG8, modulation=Modulation([0.0, 4.0, 10.0], [0.2, 1.4, 0.0]))
CLOSED, FEM, QUADRATURE = (Integrable(s) for s in ("closed-form", "fem", "quadrature"))
PAIR = [0.0, 0.1, 0.4], [0.0, 0.3, 0.1]


@pytest.mark.parametrize(
    ("name", "start", "at"),
    [
        ("H2,H1", "H1=0.2,H2=0.1", PAIR),
        ("H1", "q1=0.4,p2=0.5", ([0.0, 0.2, 1.0],)),
        ("H", "rest", ([0.01, 0.3, 1.0],)),
        ("H2", "noise=0.5", ([0.0, 0.2, 1.0],)),
        pytest.param("H1,H2", "noise=1.5", PAIR, marks=pytest.mark.slow),
    ],
)
def test_finite_elements_give_the_closed_form_in_time(name, start, at):
    exact, fem = (
        transient(m, FIG8, name, start, [20.0, 80.0], *at, tol=1e-7) for m in (CLOSED, FEM)
    )
    assert exact.certificate.certified, exact.certificate.failures
    assert_near(fem, exact)
    assert np.all(fem.errors <= 2e-7 * exact.values.max(axis=1, keepdims=True))


def test_a_time_too_short_for_the_mesh_is_reported():
    answer = transient(FEM, FIG8, "H1", "H1=0.3,H2=0.2", [0.02], [0.3], tol=1e-3)
    exact = transient(CLOSED, FIG8, "H1", "H1=0.3,H2=0.2", [0.02], [0.3])
    assert not answer.certificate.certified
    assert "too short" in " ".join(answer.certificate.failures)
    error = abs(answer.values - exact.values)[0, 0]
    assert 1e-3 * exact.values[0, 0] < error <= answer.errors[0, 0]


def test_the_transient_ends_in_the_certified_stationary_density():
    system, H = modal_van_der_pol(), np.array([0.01, 0.03, 0.1])
    (stationary,) = FEM.solve(system, [parse_observable("H1,H2", 2)]).densities
    answer = transient(FEM, system, "H1,H2", "H1=0.05,H2=0.01", [20_000.0], H, H)
    assert answer.certificate.certified, answer.certificate.failures
    p, error = stationary.at(H, H)
    assert np.all(np.abs(answer.values[0] - p) <= answer.errors[0] + error)


@pytest.mark.parametrize("limit", ["H1=0.6", "H1=0.6,H2=0.5"])
def test_first_passage_by_elements_is_that_of_the_product(limit):
    times = [0.0, 3.0, 10.0, 40.0]
    exact, fem = (passage(m, FIG8, limit, "H1=0.2,H2=0.1", times) for m in (CLOSED, FEM))
    assert exact.certificate.certified, exact.certificate.failures
    assert_agree(fem, exact)
    for number in (fem.mean, fem.variance, fem.rate):
        assert number.error <= 1e-6 * abs(number.value)


def test_reliabilities_of_independent_modes_are_multiplied():
    times = np.array([1.0, 5.0, 20.0, 60.0])
    both = passage(CLOSED, FIG8, "H1=0.6,H2=0.5", "rest", times)
    alone = [passage(CLOSED, FIG8, limit, "rest", times) for limit in ("H1=0.6", "H2=0.5")]
    assert_allclose(both.survival, alone[0].survival * alone[1].survival, rtol=1e-12)
    assert_allclose(both.rate.value, sum(a.rate.value for a in alone), rtol=1e-13)


@pytest.mark.parametrize("folds", [0.5, 3.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_the_sum_of_like_modes_is_a_gamma_process_of_two(folds):
    modes = ALIKE.fact(modal_analysis)
    theta, c = modes.temperature[0], 2.0 * modes.half_bandwidth[0]
    limit, start = f"H={folds * theta}", f"H1={0.1 * folds * theta},H2={0.3 * folds * theta}"
    guess = SquareRoot(2, 1.0, 1.0).rate(folds).value
    root = float(c * findroot(lambda a: hyp1f1(-a, 2, folds), guess, verify=False))
    closed, fem = (passage(method, ALIKE, limit, start, [1.0]) for method in (CLOSED, FEM))
    assert_agree(fem, closed)
    for rate in (closed.rate, fem.rate):
        assert abs(rate.value - root) <= rate.error <= 1e-8 * rate.value


def test_relaxation_rates_are_sums_of_multiples_of_the_decays():
    exact, fem = (m.relaxation(FIG8, 6, tol=1e-8, progress=silent) for m in (CLOSED, FEM))
    decays = 2.0 * FIG8.fact(modal_analysis).half_bandwidth
    assert_allclose(exact.values[0].real, decays.min(), rtol=1e-14)
    assert_near(fem, exact)


@pytest.mark.parametrize("name", ["H1", "H", "q1", "q1,p2"])
def test_no_times_are_an_answer_without_rows(name):
    at = [np.array([0.1, 0.2])] * (1 + name.count(","))
    answer = transient(CLOSED, FIG8, name, "rest", [], *at)
    assert answer.values.shape == answer.errors.shape == (0, 2)


def test_contacts_are_left_out_and_that_is_stated():
    system = replace(FIG8, contacts=(Contact(2, "both", 10.0, 0.5),))
    answer = transient(CLOSED, system, "H1", "rest", [1.0], [0.1])
    assert "contacts left out" in answer.settings


TRANSIENTS = [
    (CLOSED, FIG8, "q1,H1", "rest", [1.0], NotApplicable, "energies"),
    (FEM, FIG8, "H1", "H=0.3", [1.0], NotApplicable, "every modal"),
    (FEM, FIG8, "H1", "rest", [0.0, 1.0], InvalidInput, "> 0"),
    (FEM, FIG8, "H1", "rest", [2.0, 1.0], InvalidInput, "ascend"),
    # Where the noise is modulated, other reasons still come first.
    (QUADRATURE, FADING, "H1", "rest", [1.0], NotApplicable, "closed-form or fem"),
    (FEM, FADING, "H1", "H=0.3", [1.0], NotApplicable, "every modal"),
    (FEM, FADING, "H1", "rest", [1.0], NotApplicable, "modulated"),
]
PASSAGES = [
    (FEM, FIG8, "q2=1", "rest", NotApplicable, "no displacement"),
    (CLOSED, FIG8, "H=1", "rest", NotApplicable, "use fem"),
    (FEM, FIG8, "H1=1", "H1=1,H2=0", InvalidInput, "below the limit"),
    (FEM, FIG8, "H=1", "H1=0.5,H2=0.6", InvalidInput, "below the limit"),
    (CLOSED, modal_van_der_pol(), "H1=1", "rest", NotApplicable, "use fem"),
    (QUADRATURE, FIG8, "H1=1", "rest", NotApplicable, "closed-form or fem"),
]


@pytest.mark.parametrize(
    ("method", "system", "name", "start", "times", "error", "words"), TRANSIENTS
)
def test_transients_are_refused_in_a_line(method, system, name, start, times, error, words):
    with pytest.raises(error, match=words) as caught:
        transient(method, system, name, start, times, *([[0.0]] * (1 + name.count(","))))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("method", "system", "limit", "start", "error", "words"), PASSAGES)
def test_passages_are_refused_in_a_line(method, system, limit, start, error, words):
    with pytest.raises(error, match=words) as caught:
        passage(method, system, limit, start)
    assert "\n" not in str(caught.value)
