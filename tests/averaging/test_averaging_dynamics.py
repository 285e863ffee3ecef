"""Crossings, spectra, autocovariances and relaxation rates where they are exact."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from asked import ask, assert_refused
from scipy.linalg import eigvals, expm, solve_continuous_lyapunov
from systems import TURNED, in_units

import fpk
from averaging import Exact, Integrable, Linear, NonIntegrable, PhaseSpace
from fpk import System
from fpk.answer.method import silent
from fpk.answer.names import REST, Coordinate, parse_limit, parse_observable
from fpk.answer.question import QUESTIONS
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.linear import diffusion_matrix, drift_matrix
from sim import MonteCarlo

UNEQUAL = fpk.System([1, 2], [1, 1.5], [0.08, 0.04], [0.01, 0.02])
"""Unequal temperatures."""


@pytest.mark.parametrize("row", [0, 1])
def test_the_spectrum_of_a_linear_system_is_that_of_its_transfer_function(row):
    # S = (h b hᵀ)/(2π), h = e_row (iω − A)⁻¹: from the drift and the diffusion alone.
    A, b = drift_matrix(TURNED), diffusion_matrix(TURNED)
    w = np.array([0.0, 0.3, 0.7, 1.1, 2.0])
    h = np.array([np.linalg.inv(1j * x * np.eye(4) - A)[row] for x in w])
    expected = np.einsum("wi,ij,wj->w", h, b, h.conj()).real / (2.0 * np.pi)
    answer = ask(Linear(), "spectrum", TURNED, row, w)
    assert answer.values == pytest.approx(expected, rel=1e-11)
    assert np.all(answer.errors < 1e-11 * answer.values)


CRITICAL = fpk.System([1.0], [1.0], [2.0], [0.01])
"""Both eigenvalues of the drift are −1, with one eigenvector."""
LIGHT = fpk.System([1, 2], [1, 1.5], [1e-6, 2e-6], [0.01, 0.02])


@pytest.mark.parametrize("system", [TURNED, CRITICAL, LIGHT])
def test_the_autocovariance_of_a_linear_system_is_its_exponential(system):
    lags = np.array([0.0, 0.3, 1.0, 7.0, 40.0, 1000.0])
    A, b = drift_matrix(system), diffusion_matrix(system)
    Sigma = solve_continuous_lyapunov(A, -b)
    for row in range(system.n):
        expected = [(expm(A * t) @ Sigma)[row, row] for t in lags]
        answer = ask(Linear(), "correlation", system, row, lags, tol=1e-9)
        assert np.all(answer.errors < 1e-9 * answer.values[0])
        # Round-off of the equation and of the matrices in double.
        rounding = 1e-9 * answer.values[0] if system is LIGHT else 1e-13 * answer.values[0]
        assert np.all(np.abs(answer.values - expected) <= answer.errors + rounding)


def test_after_long_nothing_is_left_of_a_correlation():
    answer = ask(Linear(), "correlation", UNEQUAL, 1, np.array([1e5, 1e90]))
    assert np.all(np.abs(answer.values) <= answer.errors) and np.all(answer.errors < 1e-290)


@pytest.mark.parametrize("lag", [-1.0, np.nan, np.inf])
def test_lags_are_times(lag):
    for method in (Linear(), PhaseSpace()):
        with pytest.raises(InvalidInput, match="at"):
            method.correlation(
                UNEQUAL, (Coordinate("q", 0),), np.array([0.0, lag]), tol=None, progress=silent
            )


@pytest.mark.parametrize("question", ["crossings", "spectrum", "correlation"])
def test_answers_are_judged_by_the_tolerance_that_is_asked_for(question):
    # Less than a rounding: no answer has it.
    answer = getattr(Linear(), question)(UNEQUAL, (Coordinate("q", 0),), np.ones(1), tol=1e-30)
    assert not answer.certificate.certified and answer.certificate.missed > 1e-30


STOPPED = fpk.System(
    [1, 2], [1, 1], [0.08, 0.08], [0.02, 0.02], contacts=(fpk.Contact(2, "right", 10.0, 0.2),)
)


def test_crossings_of_a_gibbs_state_have_a_gaussian_velocity():
    a = np.linspace(-1.5, 1.0, 11)
    for row in (0, 1):
        answer = ask(Exact(), "crossings", STOPPED, row, a)
        (q,) = Exact().solve(STOPPED, [parse_observable(f"q{row + 1}", 2)]).densities
        expected = q(a) * np.sqrt(0.25 / (2.0 * np.pi * STOPPED.mass[row]))
        assert answer.values == pytest.approx(expected, rel=1e-12)
        assert np.all(np.abs(answer.values - expected) <= answer.errors + q.at(a)[1])


@pytest.mark.parametrize("system", [UNEQUAL, TURNED])
def test_relaxation_rates_of_a_linear_system_are_sums_of_eigenvalues(system):
    mu = -eigvals(drift_matrix(system))
    sums = [sum(t) for n in (1, 2, 3, 4, 5) for t in combinations_with_replacement(mu, n)]
    upper = sorted((s for s in sums if s.imag > -1e-9), key=lambda s: s.real)
    answer = ask(Linear(), "relaxation", system, 8)
    assert answer.values.real == pytest.approx([s.real for s in upper[:8]], rel=1e-12)
    assert np.all(answer.values.imag >= -1e-12)


def test_no_decay_rate_is_more_exact_than_double_precision():
    # Both eigenvalues are 1, and are found to the root of the round-off.
    answer = Linear().relaxation(CRITICAL, 2, tol=1e-6, progress=silent)
    assert answer.values[0] == pytest.approx(1.0, abs=answer.errors[0])
    assert 1e-10 < answer.errors[0] < 1e-6


@pytest.mark.parametrize("question", ["spectrum", "correlation", "crossings"])
def test_a_system_with_contacts_is_not_linear(question):
    assert_refused(NotApplicable, "contacts", ask, Linear(), question, STOPPED, 0, np.zeros(1))


FREE = System([1.0], [1.0], [0.1], [0.05])
Q, TIMES, AT = parse_observable("q1", 1), np.array([1.0]), np.array([0.5])
ARGUMENTS = {
    "crossings": (Q, AT),
    "spectrum": (Q, AT),
    "correlation": (Q, AT),
    "relaxation": (2,),
    "passage": (parse_limit("H=1", 1), REST, TIMES),
    "transient": (Q, REST, TIMES, (AT,)),
}
METHODS = (
    Exact(), Linear(), Integrable(), Integrable("fem"), NonIntegrable(), PhaseSpace(), MonteCarlo(),
)  # fmt: skip
ASKED = [(m, q) for m in METHODS for q in ARGUMENTS if hasattr(m, q)]


@pytest.mark.parametrize(("method", "question"), ASKED)
def test_no_such_tolerance(method, question):
    for tol in (0.0, -1e-3, np.nan):
        with pytest.raises(InvalidInput, match="tol"):
            getattr(method, question)(FREE, *ARGUMENTS[question], tol=tol)


@pytest.mark.parametrize("name", ["crossings", "spectrum", "correlation"])
def test_questions_state_their_units(name):
    length, mass, time = 3.0, 0.2, 7.0
    of_axis, of_values = (length**a * mass**b * time**c for a, b, c in QUESTIONS[name].powers)
    at = np.array([0.0, 0.3, 1.0])
    one = ask(Linear(), name, UNEQUAL, 1, at)
    other = ask(Linear(), name, in_units(UNEQUAL, mass, length, time), 1, at * of_axis)
    np.testing.assert_allclose(other.values, one.values * of_values, rtol=1e-9)
