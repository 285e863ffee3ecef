"""Damping terms: their values, the balance they lead to, and which are refused."""

import numpy as np
import pytest
from systems import damping_at

from fpk import DampingTerm, System
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.damping import gaussian_moment
from fpk.system.equivalent import equivalent_temperature
from fpk.system.linear import stationary_covariance
from fpk.system.system import effects_of

SQUARE = DampingTerm(1, 1, 0.5, q=((1, 2),))


def with_terms(*terms, damping=(0.08, 0.04)):
    return System([1.0, 2.0], [1.0, 3.0], damping, [0.01, 0.02], damping_terms=terms)


def test_the_matrix_gains_each_monomial():
    system = with_terms(SQUARE, DampingTerm(1, 2, -0.3, q=((1, 1),), v=((2, 3),), energy=1))
    q, p = np.array([[0.3, -0.7], [1.0, 2.0]]), np.array([[0.2, 0.5], [-1.0, 0.4]])
    v, H = p / system.mass, system.hamiltonian(q, p)
    expected = np.broadcast_to(system.damping, (2, 2, 2)).copy()
    expected[:, 0, 0] += 0.5 * q[:, 0] ** 2
    expected[:, 0, 1] -= 0.3 * q[:, 0] * v[:, 1] ** 3 * H
    assert np.allclose(damping_at(system, q, p), expected, rtol=1e-14)


def test_a_constant_term_joins_the_matrix_and_a_zero_one_is_dropped():
    system = with_terms(DampingTerm(1, 2, 0.01), DampingTerm(2, 2, 0.0, q=((1, 2),)))
    assert system.damping_terms == () and system.damping[0, 1] == 0.01
    assert not effects_of(system).state_damping


def test_terms_are_effects_and_odd_ones_break_the_mirror():
    even = effects_of(with_terms(SQUARE))
    odd = effects_of(with_terms(DampingTerm(1, 1, 0.5, q=((1, 1),), energy=1)))
    assert even.state_damping and even.mirror and not even.energy_damping
    assert odd.state_damping and not odd.mirror and odd.energy_damping


def test_negative_damping_needs_a_term_that_takes_the_energy_out():
    with pytest.raises(InvalidInput, match="does not dissipate"):
        with_terms(damping=(-0.1, 0.04))
    assert with_terms(SQUARE, damping=(-0.1, 0.04)).damping_terms
    with pytest.raises(NotApplicable, match="grows"):
        equivalent_temperature(with_terms(DampingTerm(1, 1, -0.5, q=((1, 2),))))
    with pytest.raises(NotApplicable, match="not linear"):
        stationary_covariance(with_terms(SQUARE))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"q": ((1, 0),)}, "power of 1 or more"),
        ({"energy": -1}, "power of 0 or more"),
        ({"q": ((1, 9),)}, "degree"),
        ({"coefficient": np.nan}, "finite"),
        ({"q": ((3, 2),)}, "use 1 to 2"),
    ],
)
def test_refused_terms(wrong, words):
    with pytest.raises(InvalidInput, match=words):
        with_terms(DampingTerm(**{"i": 1, "j": 1, "coefficient": 1.0, **wrong}))


def test_gaussian_moments_of_isserlis():
    cov = np.array([[2.0, 0.5], [0.5, 3.0]])
    assert gaussian_moment(cov, (2, 2)) == pytest.approx(2.0 * 3.0 + 2 * 0.5**2, rel=1e-15)
    assert gaussian_moment(cov, (4, 0)) == pytest.approx(3 * 2.0**2, rel=1e-15)
    assert gaussian_moment(cov, (3, 1)) == pytest.approx(3 * 2.0 * 0.5, rel=1e-15)
    assert gaussian_moment(cov, (2, 1)) == 0.0 and gaussian_moment(cov, (0, 0)) == 1.0


def test_the_temperature_balances_damping_and_noise():
    """Against a Gibbs sample: q ~ N(0, θ/K), v ~ N(0, θ/m), E Σ c_ij v_i v_j = Σ D_ii/m_i."""
    constant = 0.01 + 0.02 / 2.0
    assert equivalent_temperature(with_terms()) == pytest.approx(
        constant / (0.08 + 0.02), rel=1e-14
    )
    system = with_terms(
        DampingTerm(1, 1, 0.7, q=((1, 2),)),
        DampingTerm(2, 2, 0.2, q=((1, 1), (2, 1)), v=((2, 2),), energy=1),
        damping=(-0.05, 0.02),
    )
    theta = equivalent_temperature(system)
    rng = np.random.default_rng(7)
    q = rng.multivariate_normal([0, 0], theta * np.linalg.inv(system.stiffness_matrix), 400_000)
    p = rng.normal(size=q.shape) * np.sqrt(theta * system.mass)
    v = p / system.mass
    power = np.einsum("xi,xij,xj->x", v, damping_at(system, q, p), v)
    standard_error = power.std() / np.sqrt(power.size)
    assert abs(power.mean() - constant) < 4.0 * standard_error
    assert standard_error < 0.01 * constant
