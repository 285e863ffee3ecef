"""The linear part of a system in any units, and with springs that differ by many decades."""

import numpy as np
import pytest

from fpk.system.linear import (
    decay_time,
    diffusion_matrix,
    drift_matrix,
    natural_modes,
    stationary_covariance,
)
from fpk.system.system import System

EPS = np.finfo(float).eps


@pytest.mark.parametrize(
    ("m", "k", "c"),
    [(1, 1e8, 1), (100, 1e6, 1), (1e-8, 1e8, 1e-2), (1e10, 1e-10, 1e-4)],
)
def test_one_mass_has_the_variances_of_its_temperature(m, k, c):
    """E q² = D/(c k), E p² = m D/c, E q p = 0, whatever the units."""
    D = 3.0
    covariance = stationary_covariance(System([m], [k], [c], [D]))
    exact = np.diag([D / (c * k), m * D / c])
    size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    # The decay c/m is found to EPS times the largest rate.
    rate = np.max(np.abs(np.linalg.eigvals(drift_matrix(System([m], [k], [c], [D])))))
    allowed = 50 * EPS * rate * decay_time(System([m], [k], [c], [D]))
    np.testing.assert_array_less(np.abs(covariance - exact), allowed * size)


def test_the_covariance_is_that_of_the_same_system_in_other_units():
    rng = np.random.default_rng(61)
    m, k, c, D = rng.uniform(0.5, 2.0, (4, 5)) * [[1.0], [1.0], [0.1], [1.0]]
    base = stationary_covariance(System(m, k, c, D))
    M, X, T = 1e-7, 1e5, 1e-4
    other = stationary_covariance(System(M * m, M / T**2 * k, M / T * c, (M * X) ** 2 / T**3 * D))
    unit = np.array([X] * 5 + [M * X / T] * 5)
    # A Lyapunov solution loses the digits of the slowest decay beside the fastest motion.
    size = np.sqrt(np.outer(np.diag(base), np.diag(base)))
    assert np.max(np.abs(other / np.outer(unit, unit) - base) / size) < 1e-11
    A, b = drift_matrix(System(m, k, c, D)), diffusion_matrix(System(m, k, c, D))
    assert np.max(np.abs(A @ base + base @ A.T + b)) < 1e3 * EPS * np.max(np.abs(base))


def test_a_spring_of_1e16_leaves_the_slow_modes_their_digits():
    """Two masses that it joins move as one: k = (1, 1), m = (1, 2), 2 ω⁴ − 5 ω² + 1 = 0."""
    system = System([1.0, 1.0, 1.0], [1.0, 1.0, 1e16], [0.1] * 3, [0.1] * 3)
    shapes, omega = natural_modes(system)
    slow = np.sqrt((5.0 + np.array([-1.0, 1.0]) * np.sqrt(17.0)) / 4.0)
    # Round-off of the largest singular value, 1.4e8, is 3e-8; a coupling of 1e-16 is left out.
    np.testing.assert_allclose(omega[:2], slow, atol=10 * EPS * omega[2])
    assert omega[2] == pytest.approx(np.sqrt(2e16), rel=1e-12)
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(3), atol=1e-14)


def test_modes_solve_the_eigenproblem():
    rng = np.random.default_rng(62)
    for n in (1, 2, 7, 30):
        m, k = rng.uniform(0.5, 2.0, (2, n))
        system = System(m, k, np.ones(n), np.ones(n))
        T, omega = natural_modes(system)
        assert np.all(np.diff(omega) > 0)
        np.testing.assert_allclose(T.T @ np.diag(m) @ T, np.eye(n), atol=100 * EPS)
        left = system.stiffness_matrix @ T - np.diag(m) @ T * omega**2
        assert np.max(np.abs(left)) < 100 * EPS * omega[-1] ** 2
