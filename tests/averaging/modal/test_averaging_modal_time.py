"""Modal energies in time: closed forms against mpmath, finite elements against closed forms."""

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from modal_terms import modal_van_der_pol
from numpy.testing import assert_allclose

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_observable, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.solvers.square_root import SquareRoot
from fpk.system.contact import Contact
from fpk.system.modulation import Modulation
from fpk.system.system import System

FIG8 = System([1.0, 1.0], [1.0, 1.0], [0.05, 0.07], [0.015, 0.015])
ALIKE = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05, 0.05])
FADING = replace(FIG8, modulation=Modulation([0.0, 4.0, 10.0], [0.2, 1.4, 0.0]))
CLOSED, FEM = Integrable("closed-form"), Integrable("fem")


def transient(method, system, name, start, times, *at, tol=1e-8):
    observable, begin = parse_observable(name, system.n), parse_start(start, system)
    points = tuple(np.asarray(x, float) for x in at)
    return method.transient(
        system, observable, begin, np.asarray(times, float), points, tol=tol, progress=silent
    )


def passage(method, system, limit, start, times=(), tol=1e-8):
    end, begin = parse_limit(limit, system.n), parse_start(start, system)
    return method.passage(system, end, begin, np.asarray(times, float), tol=tol, progress=silent)


def within(number, other):
    """Two numbers with errors agree, and neither error is larger than 1e-6 of the number."""
    assert number.error <= 1e-6 * abs(number.value)
    assert abs(number.value - other.value) <= number.error + other.error


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize(("start", "t"), [(0.0, 1e-3), (2.0, 1e-2), (0.7, 1.0), (3.0, 40.0)])
def test_transition_density_is_a_noncentral_chi_square(n, start, t):
    x = np.linspace(0.01, 6.0, 9)
    tau, y = -np.expm1(-t), start * np.exp(-t)
    p, error = SquareRoot(n, 1.0, 1.0).density(start, None, t, x)
    mp.mp.dps = 30
    for k, at in enumerate(x):
        if y == 0.0:
            exact = mp.mpf(at) ** (n - 1) * mp.exp(-at / tau) / (mp.gamma(n) * mp.mpf(tau) ** n)
        else:
            root = 2 * mp.sqrt(mp.mpf(at) * y) / tau
            power = (mp.mpf(at) / y) ** (mp.mpf(n - 1) / 2)
            exact = power * mp.exp(-(at + y) / mp.mpf(tau)) * mp.besseli(n - 1, root) / tau
        # tau and y carry a rounding each, which the exponent multiplies.
        assert abs(p[k] - exact) <= error[k] + 1e-300


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize(("limit", "start"), [(0.3, 0.1), (3.0, 0.0), (12.0, 11.0)])
def test_moments_and_failure_rate_of_the_square_root_process(n, limit, start):
    mp.mp.dps = 40
    answer = SquareRoot(n, 1.0, 1.0).passage(limit, start, np.zeros(0), tol=1e-10)
    mean = mp.quad(lambda z: mp.exp(z) * mp.gammainc(n, 0, z) / z**n, mp.linspace(start, limit, 7))
    assert abs(answer.mean.value - mean) <= answer.mean.error <= 1e-12 * mean
    root = mp.findroot(lambda a: mp.hyp1f1(-a, n, limit), answer.rate.value, verify=False)
    assert abs(answer.rate.value - root) <= answer.rate.error <= 1e-11 * root
    # ∫ 2t P(T > t) dt = E T², by the trapezoidal rule in ln t.
    t = answer.mean.value * np.exp(np.arange(-18.0, 4.5, 0.05))
    survival = 1.0 - SquareRoot(n, 1.0, 1.0).failure(limit, start, t, tol=1e-10)[0]
    square = 0.05 * float(np.sum(2.0 * t**2 * survival)) - answer.mean.value**2
    assert_allclose(square, answer.variance.value, rtol=1e-9)


def test_the_known_failure_rate():
    # c = 0.1, D' = 0.05, H_f = 3 D'/c.
    assert_allclose(SquareRoot(1, 0.1, 0.05).rate(1.5).value, 0.013742123052434, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "start", "at"),
    [
        ("H1,H2", "rest", ([0.0, 0.1, 0.4], [0.0, 0.3, 0.1])),
        ("H2,H1", "H1=0.2,H2=0.1", ([0.0, 0.1, 0.4], [0.0, 0.3, 0.1])),
        ("H1", "q1=0.4,p2=0.5", ([0.0, 0.2, 1.0],)),
        ("H", "H1=0.2,H2=0.1", ([0.01, 0.3, 1.0],)),
        ("H2", "noise=0.5", ([0.0, 0.2, 1.0],)),
        ("H1,H2", "noise=1.5", ([0.0, 0.1, 0.4], [0.0, 0.3, 0.1])),
    ],
)
def test_finite_elements_give_the_closed_form_in_time(name, start, at):
    times = [20.0, 80.0]
    exact, fem = (transient(m, FIG8, name, start, times, *at, tol=1e-7) for m in (CLOSED, FEM))
    assert exact.certificate.certified, exact.certificate.failures
    assert fem.certificate.certified, fem.certificate.failures
    assert np.all(np.abs(fem.values - exact.values) <= fem.errors + exact.errors)
    assert np.all(fem.errors <= 2e-7 * exact.values.max(axis=1, keepdims=True))


def test_a_time_too_short_for_the_mesh_is_said():
    answer = transient(FEM, FIG8, "H1", "H1=0.3,H2=0.2", [0.02], [0.3], tol=1e-3)
    exact = transient(CLOSED, FIG8, "H1", "H1=0.3,H2=0.2", [0.02], [0.3])
    assert not answer.certificate.certified
    assert abs(answer.values - exact.values)[0, 0] > 1e-3 * exact.values[0, 0]
    assert "too short" in answer.certificate.failures[-1] or "too short" in " ".join(
        answer.certificate.failures
    )
    assert abs(answer.values - exact.values)[0, 0] <= answer.errors[0, 0]


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
    assert fem.certificate.certified, fem.certificate.failures
    for key in ("mean", "variance", "rate"):
        within(getattr(fem, key), getattr(exact, key))
    gap = np.abs(fem.survival - exact.survival)
    assert np.all(gap <= fem.survival_error + exact.survival_error)


def test_neither_has_failed_is_a_product_of_reliabilities():
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
    mp.mp.dps = 40
    guess = SquareRoot(2, 1.0, 1.0).rate(folds).value
    root = mp.findroot(lambda a: mp.hyp1f1(-a, 2, mp.mpf(folds)), guess, verify=False)
    for method in (CLOSED, FEM):
        answer = passage(method, ALIKE, limit, start, [1.0])
        assert answer.certificate.certified, answer.certificate.failures
        assert (
            abs(answer.rate.value - float(c * root))
            <= answer.rate.error
            <= 1e-8 * answer.rate.value
        )
    within(answer.mean, passage(CLOSED, ALIKE, limit, start).mean)


def test_relaxation_rates_are_sums_of_multiples_of_the_decays():
    exact, fem = (m.relaxation(FIG8, 6, tol=1e-8, progress=silent) for m in (CLOSED, FEM))
    decays = 2.0 * FIG8.fact(modal_analysis).half_bandwidth
    assert_allclose(exact.values[0].real, decays.min(), rtol=1e-14)
    assert fem.certificate.certified, fem.certificate.failures
    assert np.all(np.abs(fem.values - exact.values) <= fem.errors + exact.errors)


@pytest.mark.parametrize("name", ["H1", "H", "q1", "q1,p2"])
def test_no_times_are_an_answer_without_rows(name):
    at = [np.array([0.1, 0.2])] * (1 + name.count(","))
    answer = transient(CLOSED, FIG8, name, "rest", [], *at)
    assert answer.values.shape == answer.errors.shape == (0, 2)


def test_contacts_are_left_out_and_that_is_said():
    system = replace(FIG8, contacts=(Contact(2, "both", 10.0, 0.5),))
    answer = transient(CLOSED, system, "H1", "rest", [1.0], [0.1])
    assert "contacts left out" in answer.settings


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (
            lambda: transient(CLOSED, FIG8, "q1,H1", "rest", [1.0], [0.0], [0.0]),
            NotApplicable,
            "energies",
        ),
        (lambda: transient(FEM, FIG8, "H1", "H=0.3", [1.0], [0.0]), NotApplicable, "every modal"),
        (lambda: transient(FEM, FIG8, "H1", "rest", [0.0, 1.0], [0.0]), InvalidInput, "> 0"),
        (lambda: transient(FEM, FIG8, "H1", "rest", [2.0, 1.0], [0.0]), InvalidInput, "ascend"),
        (lambda: passage(FEM, FIG8, "q2=1", "rest"), NotApplicable, "no displacement"),
        (lambda: passage(CLOSED, FIG8, "H=1", "rest"), NotApplicable, "use fem"),
        (lambda: passage(FEM, FIG8, "H1=1", "H1=1,H2=0"), InvalidInput, "below the limit"),
        (lambda: passage(FEM, FIG8, "H=1", "H1=0.5,H2=0.6"), InvalidInput, "below the limit"),
        (lambda: passage(CLOSED, modal_van_der_pol(), "H1=1", "rest"), NotApplicable, "use fem"),
        (
            lambda: passage(Integrable("quadrature"), FIG8, "H1=1", "rest"),
            NotApplicable,
            "closed-form or fem",
        ),
        # Where the noise is modulated, what is wrong besides is still said first.
        (
            lambda: transient(Integrable("quadrature"), FADING, "H1", "rest", [1.0], [0.0]),
            NotApplicable,
            "closed-form or fem",
        ),
        (lambda: transient(FEM, FADING, "H1", "H=0.3", [1.0], [0.0]), NotApplicable, "every modal"),
        (lambda: transient(FEM, FADING, "H1", "rest", [1.0], [0.0]), NotApplicable, "modulated"),
    ],
)
def test_what_is_not_given_is_refused_in_a_line(ask, error, words):
    with pytest.raises(error, match=words) as caught:
        ask()
    assert "\n" not in str(caught.value)
