"""Crossings, spectra, autocovariances and relaxation rates where they are exact."""

from itertools import combinations_with_replacement

import mpmath
import numpy as np
import pytest
from asked import TURNED, ask
from scipy.linalg import eigvals, expm

import fpk
from averaging.gaussian import Linear
from averaging.phase_space.method import PhaseSpace
from averaging.theory import Exact
from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.linear import diffusion_matrix, drift_matrix, stationary_covariance

UNEQUAL = fpk.System([1, 2], [1, 1.5], [0.08, 0.04], [0.01, 0.02])
"""Unequal temperatures."""


@pytest.mark.parametrize("system", [UNEQUAL, TURNED])
@pytest.mark.parametrize("row", [0, 1])
def test_the_spectrum_of_a_linear_system_is_that_of_its_covariance_in_time(system, row):
    # C(t) = e^(At) Σ: the trapezoidal rule of its transform, whose error is of order step², by
    # two steps and Richardson's extrapolation.
    A, Sigma = drift_matrix(system), stationary_covariance(system)
    w = np.array([0.0, 0.3, 0.7, 1.1, 2.0])
    sums = []
    for step in (0.04, 0.02):
        count = round(400.0 / step)
        forward, state = expm(A * step), Sigma[:, row].copy()
        C = np.empty(count)
        for k in range(count):
            C[k] = state[row]
            state = forward @ state
        C[0] *= 0.5
        t = step * np.arange(count)
        sums.append(np.cos(np.outer(w, t)) @ C * step / np.pi)
    expected = (4.0 * sums[1] - sums[0]) / 3.0
    answer = ask(Linear(), "spectrum", system, row, w)
    # At the end of the sum the covariance has fallen below e^(−400/50) of its start, step⁴ = 2e-7.
    left = abs(C[-1]) * 400.0 / np.pi
    assert answer.values == pytest.approx(expected, abs=left + 1e-6 * expected.max())
    assert np.all(answer.errors < 1e-11 * answer.values)


@pytest.mark.parametrize("system", [UNEQUAL, TURNED])
def test_the_spectrum_of_a_linear_system_adds_up_to_the_variance(system):
    # ω = tan θ: S is a rational function of ω that falls as ω⁻⁴, periodic and analytic in θ.
    for row in (0, 1):
        theta = np.pi * (np.arange(4000) / 4000.0 - 0.5 + 0.5 / 4000.0)
        S = ask(Linear(), "spectrum", system, row, np.tan(theta)).values
        total = np.sum(S / np.cos(theta) ** 2) * np.pi / 4000.0
        assert total == pytest.approx(stationary_covariance(system)[row, row], rel=1e-12)


CRITICAL = fpk.System([1.0], [1.0], [2.0], [0.01])
"""Both eigenvalues of the drift are −1, with one eigenvector."""
LIGHT = fpk.System([1, 2], [1, 1.5], [1e-6, 2e-6], [0.01, 0.02])


@pytest.mark.parametrize("system", [UNEQUAL, TURNED, CRITICAL, LIGHT])
def test_the_autocovariance_of_a_linear_system_is_its_exponential(system):
    # 40 digits; of Σ, the matrix of the Lyapunov equation A Σ + Σ Aᵀ = −b.
    lags, n = np.array([0.0, 0.3, 1.0, 7.0, 40.0, 1000.0]), 2 * system.n
    with mpmath.workdps(40):
        A = mpmath.matrix(drift_matrix(system).tolist())
        one = mpmath.eye(n)
        both = [A[i, k] * one[j, m] + one[i, k] * A[j, m] for i, j, k, m in np.ndindex(n, n, n, n)]
        b = mpmath.matrix([-x for x in diffusion_matrix(system).ravel().tolist()])
        Sigma = mpmath.lu_solve(mpmath.matrix(np.reshape(both, (n * n, n * n)).tolist()), b)
        for row in range(system.n):
            column = mpmath.matrix([Sigma[n * k + row] for k in range(n)])
            expected = [(mpmath.expm(A * mpmath.mpf(t)) * column)[row] for t in lags.tolist()]
            answer = ask(Linear(), "correlation", system, row, lags, tol=1e-9)
            assert np.all(answer.errors < 1e-9 * answer.values[0])
            for value, error, exact in zip(answer.values, answer.errors, expected, strict=True):
                assert abs(mpmath.mpf(value) - exact) <= error


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


def test_crossings_of_a_linear_system_are_those_of_its_joint_density():
    for system in (UNEQUAL, TURNED):
        a = np.linspace(-2.0, 2.0, 9)
        rice = ask(Linear(), "crossings", system, 1, a)
        (joint,) = Linear().solve(system, [parse_observable("q2,p2", 2)]).densities
        p = np.linspace(0.0, 8.0, 4001)
        v_density = np.maximum(p / system.mass[1], 0.0) * joint(a[:, None], p)
        rate = np.trapezoid(v_density, p, axis=1)
        # The trapezoidal rule, h²/12 times the slope at p = 0.
        left = (p[1] - p[0]) ** 2 / 12.0 * joint(a, np.zeros(9)) / system.mass[1]
        assert np.all(np.abs(rate - rice.values) <= 1.1 * left + rice.errors)


def test_crossings_of_a_gibbs_state_have_a_gaussian_velocity():
    contact = fpk.Contact(mass=2, side="right", stiffness=10.0, clearance=0.2)
    system = fpk.System([1, 2], [1, 1], [0.08, 0.08], [0.02, 0.02], contacts=(contact,))
    a = np.linspace(-1.5, 1.0, 11)
    for row in (0, 1):
        answer = ask(Exact(), "crossings", system, row, a)
        (q,) = Exact().solve(system, [parse_observable(f"q{row + 1}", 2)]).densities
        expected = q(a) * np.sqrt(0.25 / (2.0 * np.pi * system.mass[row]))
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


def test_one_of_a_conjugate_pair_is_listed():
    # One mass: μ = 0.04 ± i ω. μ; 2μ and μ + μ*; 3μ and 2μ + μ*; ...
    system = fpk.System([1.0], [1.0], [0.08], [0.01])
    w = np.sqrt(1.0 - 0.04**2)
    values = ask(Linear(), "relaxation", system, 8).values
    k = [(1, 1), (2, 0), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (4, 4)]
    expected = sorted((n * 0.04, m * w) for n, m in k)
    listed = sorted(zip(values.real.round(9), values.imag, strict=True))
    assert np.array(listed) == pytest.approx(np.array(expected), abs=1e-9)


def test_no_decay_rate_is_more_exact_than_double_precision():
    # Critical damping: both eigenvalues are 1, and are found to the root of the round-off.
    system = fpk.System([1.0], [1.0], [2.0], [0.01])
    answer = Linear().relaxation(system, 2, tol=1e-6, progress=silent)
    assert answer.values[0] == pytest.approx(1.0, abs=answer.errors[0])
    assert 1e-10 < answer.errors[0] < 1e-6


@pytest.mark.parametrize("question", ["spectrum", "correlation", "crossings"])
def test_a_system_with_contacts_is_not_linear(question):
    contact = fpk.Contact(mass=2, side="right", stiffness=10.0, clearance=0.2)
    system = fpk.System([1, 2], [1, 1], [0.08, 0.08], [0.02, 0.02], contacts=(contact,))
    with pytest.raises(NotApplicable, match="contacts"):
        getattr(Linear(), question)(
            system, (Coordinate("q", 0),), np.zeros(1), tol=None, progress=silent
        )
