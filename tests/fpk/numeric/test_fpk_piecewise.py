"""Functions by polynomials on panels, against functions known in closed form."""

import numpy as np
import pytest

from fpk.numeric.piecewise import Piecewise, PiecewiseTensor, fit, legendre_coefficients
from fpk.numeric.quadrature import gauss_legendre, panel_rule

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
    assert np.isnan(f(np.nan))
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


@pytest.mark.parametrize("points", [1, 2, 5, 20])
def test_gauss_legendre_is_exact_to_degree_2n_minus_1_and_no_further(points):
    x, w = gauss_legendre(points)
    for degree in range(2 * points):
        exact = 2.0 / (degree + 1) if degree % 2 == 0 else 0.0
        assert w @ x**degree == pytest.approx(exact, abs=1e-14)
    # Error of x^2n: the squared norm of the monic Legendre polynomial, 2^(2n+1) n!⁴/((2n+1)(2n)!²).
    n = np.arange(1.0, points + 1.0)
    exact = 2.0 ** (2 * points + 1) * np.prod(n / (n + points)) ** 2 / (2 * points + 1)
    error = 2.0 / (2 * points + 1) - w @ x ** (2 * points)
    assert error == pytest.approx(exact, rel=1e-9, abs=1e-14)


def test_panels_add_up_and_stay_inside():
    nodes = np.array([0.0, 0.1, 0.7, 3.0])
    x, w = panel_rule(nodes, 6)
    assert x.shape == w.shape == (3, 6)
    assert np.all((x > nodes[:-1, None]) & (x < nodes[1:, None]))
    np.testing.assert_allclose(w.sum(axis=1), np.diff(nodes), rtol=1e-14)
    assert np.sum(w * x**11) == pytest.approx(3.0**12 / 12.0, rel=1e-14)


def test_a_cached_rule_cannot_be_changed():
    x, _ = gauss_legendre(3)
    with pytest.raises(ValueError, match="read-only"):
        x[0] = 0.0
