"""Functions by polynomials on panels, against functions known in closed form."""

import numpy as np
import pytest

from fpk.numeric.piecewise import Piecewise, PiecewiseTensor, fit, legendre_coefficients

X = np.random.default_rng(20260101).uniform(0.0, 6.0, 400)
NODES = np.array([0.0, 0.7, 1.5, 4.0, 6.0])


def test_a_fit_is_the_function_and_so_is_its_integral():
    f = fit(np.sin, NODES, 1e-13)
    np.testing.assert_allclose(f(X), np.sin(X), atol=1e-14)
    np.testing.assert_allclose(f.antiderivative()(X), 1.0 - np.cos(X), atol=2e-14)
    assert f.antiderivative()(6.0) == pytest.approx(1.0 - np.cos(6.0), abs=1e-14)


@pytest.mark.parametrize("degree", [0, 1, 12])
def test_polynomials_of_the_degree_are_exact_and_one_degree_more_is_not(degree):
    power = fit(lambda x: x**degree, NODES, np.inf, degree=degree)
    np.testing.assert_allclose(power(X), X**degree, rtol=1e-10, atol=1e-12)
    more = fit(lambda x: x ** (degree + 1), NODES, np.inf, degree=degree)
    assert np.max(np.abs(more(X) - X ** (degree + 1))) > 1e-6


@pytest.mark.parametrize(
    "f", [lambda x: np.abs(x - 1.234), lambda x: np.exp(-30.0 * (x - 2.2) ** 2), np.sqrt]
)
def test_what_is_not_smooth_is_split_until_the_estimate_holds(f):
    tol = 1e-8
    fitted = fit(f, NODES, tol)
    assert fitted.nodes.size > NODES.size and np.all(np.isin(NODES, fitted.nodes))
    assert fitted.error.max() <= tol
    k = np.searchsorted(fitted.nodes, X, side="right") - 1
    assert np.all(np.abs(fitted(X) - f(X)) <= fitted.error[k] + 2e-14)


def test_what_cannot_be_fitted_says_so():
    noise = np.random.default_rng(3)
    rough = fit(lambda x: noise.normal(size=x.size), NODES, 1e-6, rounds=4)
    assert rough.error.max() > 0.1


def test_values_may_have_a_shape():
    def f(x):
        return np.stack([np.cos(x), x**2, 0.0 * x], axis=1)

    fitted = fit(f, NODES, 1e-12)
    np.testing.assert_allclose(fitted(X.reshape(20, 20)), f(X).reshape(20, 20, 3), atol=1e-12)
    np.testing.assert_allclose(fitted.antiderivative()(6.0), [np.sin(6.0), 72.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(fitted.antiderivative()(X)[:, 1], X**3 / 3.0, atol=1e-11)


def test_scales_reach_beyond_double_precision():
    # f = exp(−200 x): 520 decades over the panels, each with its own scale.
    nodes = np.linspace(0.0, 6.0, 241)
    unit = legendre_coefficients(lambda x: np.exp(-200.0 * x), nodes[:1], nodes[1:2], 20)
    f = Piecewise(nodes, np.repeat(unit, 240, axis=0), log_scale=-200.0 * nodes[:-1])
    np.testing.assert_allclose(f(X, log_factor=200.0 * X), 1.0, rtol=1e-11)
    assert f(3.6) == 0.0 or f(3.6) < 1e-300


def test_outside_its_nodes_it_is_what_it_is_said_to_be():
    f = fit(np.cos, NODES, 1e-12)
    assert np.array_equal(f([-0.1, 6.1]), [0.0, 0.0])
    logarithm = Piecewise(f.nodes, f.coefficients, outside=-np.inf)
    assert np.array_equal(np.exp(logarithm(np.array([-0.1, 6.1]))), [0.0, 0.0])
    np.testing.assert_allclose(f([0.0, 6.0]), np.cos([0.0, 6.0]), atol=1e-14)


def test_a_tensor_at_points_and_on_a_grid():
    first = legendre_coefficients(np.sin, NODES[:-1], NODES[1:], 14)
    nodes = np.array([0.0, 1.0, 6.0])
    second = legendre_coefficients(np.exp, nodes[:-1], nodes[1:], 17)
    f, y = PiecewiseTensor((NODES, nodes), np.einsum("ki,lj->klij", first, second)), X[::-1]
    np.testing.assert_allclose(f(X, y), np.sin(X) * np.exp(y), rtol=1e-9, atol=1e-9)
    grid = np.sin(X)[:, None] * np.exp(y[:50])
    np.testing.assert_allclose(f(X[:, None], y[:50]), grid, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(f(X, y[:50, None]), grid.T, rtol=1e-9, atol=1e-9)
    assert np.array_equal(f([-1.0, 1.0, 7.0], [1.0, 9.0, 1.0]), np.zeros(3))
