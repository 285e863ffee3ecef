"""Gauss-Legendre rules are exact to degree 2n − 1 and no further."""

import numpy as np
import pytest

from fpk.numeric.quadrature import gauss_legendre, panel_rule


@pytest.mark.parametrize("points", [1, 2, 5, 20])
def test_exact_to_degree_2n_minus_1(points):
    x, w = gauss_legendre(points)
    for degree in range(2 * points):
        exact = 2.0 / (degree + 1) if degree % 2 == 0 else 0.0
        assert w @ x**degree == pytest.approx(exact, abs=1e-14)


@pytest.mark.parametrize("points", [1, 2, 5])
def test_no_further_than_degree_2n_minus_1(points):
    x, w = gauss_legendre(points)
    # Error of x^2n: the squared norm of the monic Legendre polynomial, 2^(2n+1) n!⁴/((2n+1)(2n)!²).
    n = np.arange(1.0, points + 1.0)
    exact = 2.0 ** (2 * points + 1) * np.prod(n / (n + points)) ** 2 / (2 * points + 1)
    error = 2.0 / (2 * points + 1) - w @ x ** (2 * points)
    assert error == pytest.approx(exact, rel=1e-9)


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
