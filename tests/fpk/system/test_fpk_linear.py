"""The linear part of a system: modes, covariance and decay, in any units."""

import numpy as np
import pytest
from systems import in_units

from fpk.numeric.errors import NotApplicable
from fpk.system.linear import (
    decay_time,
    diffusion_matrix,
    displacements_given,
    drift_matrix,
    natural_modes,
    stationary_covariance,
)
from fpk.system.system import System

EPS = np.finfo(float).eps
PAIR = [1.0, 2.0], [3.0, 4.0]


def test_the_covariance_is_that_of_the_same_system_in_other_units():
    m, k, c, D = np.random.default_rng(61).uniform(0.5, 2.0, (4, 5))
    system, M, X, T = System(m, k, 0.1 * c, D), 1e-7, 1e5, 1e-4
    base = stationary_covariance(system)
    other = stationary_covariance(in_units(system, M, X, T))
    unit = np.array([X] * 5 + [M * X / T] * 5)
    # A Lyapunov solution loses the digits of the slowest decay beside the fastest motion.
    size = np.sqrt(np.outer(np.diag(base), np.diag(base)))
    assert np.max(np.abs(other / np.outer(unit, unit) - base) / size) < 1e-11


def test_modes_solve_the_eigenproblem():
    rng = np.random.default_rng(62)
    for n in (1, 2, 30):
        m, k = rng.uniform(0.5, 2.0, (2, n))
        system = System(m, k, np.ones(n), np.ones(n))
        T, omega = natural_modes(system)
        assert np.all(np.diff(omega) > 0)
        np.testing.assert_allclose(T.T @ np.diag(m) @ T, np.eye(n), atol=100 * EPS)
        residual = system.stiffness_matrix @ T - np.diag(m) @ T * omega**2
        assert np.max(np.abs(residual)) < 100 * EPS * omega[-1] ** 2
    # det(K − ω² M) = 0 for m = (1, 2), k = (3, 4): 2 ω⁴ − (2·7 + 4) ω² + 12 = 0.
    omega = natural_modes(System(*PAIR, [0.1, 0.2], [0.3, 0.4]))[1]
    np.testing.assert_allclose(omega**2, np.sort(np.roots([2.0, -18.0, 12.0])), rtol=1e-13)


def test_a_spring_of_1e16_leaves_the_slow_modes_their_digits():
    """Two masses that it joins move as one: k = (1, 1), m = (1, 2), 2 ω⁴ − 5 ω² + 1 = 0."""
    shapes, omega = natural_modes(System([1.0] * 3, [1.0, 1.0, 1e16], [0.1] * 3, [0.1] * 3))
    slow = np.sqrt((5.0 + np.array([-1.0, 1.0]) * np.sqrt(17.0)) / 4.0)
    # Round-off of the largest singular value, 1.4e8, is 3e-8; a coupling of 1e-16 is left out.
    np.testing.assert_allclose(omega[:2], slow, atol=10 * EPS * omega[2])
    assert omega[2] == pytest.approx(np.sqrt(2e16), rel=1e-12)
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(3), atol=1e-14)


def test_covariance_solves_the_lyapunov_equation():
    gain = [[1.0], [0.2]]
    one = System(*PAIR, [[0.1, 0.05], [-0.02, 0.2]], [0.3], noise_gain=gain)
    A, b, S = drift_matrix(one), diffusion_matrix(one), stationary_covariance(one)
    # Backward stable to some ε of A Σ, n = 4.
    np.testing.assert_allclose(A @ S + S @ A.T, -b, rtol=0, atol=1e-13 * np.abs(A @ S).max())
    np.testing.assert_array_equal(S, S.T)
    assert np.linalg.eigvalsh(S)[0] > 0
    # The drift matrix acts as Eq. (6): q' = p/m, p' = −K q − c p/m.
    q, p = np.array([0.3, -0.4]), np.array([0.5, 0.6])
    v = p / one.mass
    expected = np.concatenate([v, -one.stiffness_matrix @ q - one.damping @ v])
    np.testing.assert_allclose(A @ np.concatenate([q, p]), expected, rtol=1e-15)


def test_an_undamped_mode_is_refused():
    for damping in ([0.0, 0.0], [[0.0, 0.3], [-0.3, 0.0]]):
        undamped = System(*PAIR, damping, [0.3, 0.4])
        assert decay_time(undamped) == np.inf
        with pytest.raises(NotApplicable, match="not damped"):
            stationary_covariance(undamped)
    # One damper reaches both modes of the chain through the springs.
    assert decay_time(System(*PAIR, [0.1, 0.0], [0.3, 0.4])) < 1e4


@pytest.mark.parametrize("given", [[], [2], [1, 3], [0, 4]])
def test_displacements_between_given_masses_are_a_bridge(given):
    system = System([1.0] * 5, [1.0, 3.0, 2.0, 5.0, 0.5], [0.1] * 5, [0.1] * 5)
    free = [i for i in range(5) if i not in given]
    expected = np.zeros((5, 5))
    expected[np.ix_(free, free)] = np.linalg.inv(system.stiffness_matrix[np.ix_(free, free)])
    found = displacements_given(system, given)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
