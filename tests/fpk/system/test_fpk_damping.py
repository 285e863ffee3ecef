"""Damping terms: their values, the balance they lead to, and which are refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from systems import both, chain

from averaging import NonIntegrable
from fpk import Contact, DampingTerm, System
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.damping import gaussian_moment
from fpk.system.equivalent import damping_balance, equivalent_temperature
from fpk.system.linear import stationary_covariance
from fpk.system.system import effects_of
from sim import MonteCarlo

SQUARE = DampingTerm(1, 1, 0.5, q=((1, 2),))


def with_terms(*terms, damping=(0.08, 0.04)):
    return System([1.0, 2.0], [1.0, 3.0], damping, [0.01, 0.02], damping_terms=terms)


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
        ({"q": ((1, 1.5),)}, "whole power"),
        ({"v": ((1, 2), (1, 1))}, "each mass once"),
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


HARD = both(100.0, 0.3, "power", mass=1, exponent=3.0)


def test_the_temperature_balances_damping_by_the_energy_and_noise():
    # c_i = 3 H D_i, and E H v_i² = (n + 1) θ²/m_i: 9 θ² = 1.
    terms = [DampingTerm(i, i, 0.03 * i, energy=1) for i in (1, 2)]
    system = with_terms(*terms, damping=(0.0, 0.0))
    assert equivalent_temperature(system) == pytest.approx(1.0 / 3.0, rel=1e-12)


def squares(displacement, velocity):
    """c_11 gains ``displacement`` q1² + ``velocity`` v1²."""
    return (DampingTerm(1, 1, displacement, q=((1, 2),)), DampingTerm(1, 1, velocity, v=((1, 2),)))


DRIVEN = squares(-0.2, 0.03)


def stopped_chain(count, terms=DRIVEN):
    """Hard stops on each of ``count`` masses."""
    contacts = tuple(replace(HARD[0], mass=i + 1) for i in range(count))
    return chain(count, contacts, damping_terms=terms)


def test_a_stop_in_the_driven_region_makes_the_system_stable():
    """E (0.1 − 0.2 q² + 0.03 v²) v² = D with E q² by adaptive quadrature."""
    system = chain(1, HARD, damping_terms=DRIVEN)
    last = damping_balance(system)

    def power(theta):
        def weight(q):
            return float(np.exp(-system.potential(np.array([q])) / theta))

        square = quad(lambda q: q * q * weight(q), -3, 3)[0] / quad(weight, -3, 3)[0]
        return theta * (0.1 - 0.2 * square + 0.09 * theta)

    assert power(last.temperature) == pytest.approx(0.05, rel=0.02)
    slope = (power(1.01 * last.temperature) - power(0.99 * last.temperature)) / 0.02
    assert last.slope * last.temperature == pytest.approx(slope, rel=0.1)
    MonteCarlo().prepare(system)
    with pytest.raises(NotApplicable, match="grows for ever"):
        MonteCarlo().prepare(replace(system, contacts=()))


@pytest.mark.parametrize("method", [MonteCarlo(), NonIntegrable()])
def test_a_stop_that_keeps_the_mass_out_of_the_damped_region_makes_the_energy_grow(method):
    with pytest.raises(NotApplicable, match="grows for ever"):
        method.prepare(chain(1, HARD, damping_terms=squares(0.2, -0.03)))
    method.prepare(chain(1, damping_terms=squares(0.2, -0.03)))  # without the stop it is stable


@pytest.mark.parametrize("masses", [(1,), (2,), (1, 2)])
def test_stops_out_of_reach_leave_the_balance_of_the_chain(masses):
    terms = (
        DampingTerm(1, 1, 0.7, q=((1, 2),)),
        DampingTerm(2, 2, 0.2, q=((1, 1), (2, 1)), v=((2, 2),), energy=1),
    )
    free = System([1.0, 2.0], [1.0, 3.0], [0.05, 0.02], [0.01, 0.02], damping_terms=terms)
    far = replace(free, contacts=tuple(Contact(mass, "both", 1e-30, 10.0) for mass in masses))
    expected = equivalent_temperature(free)
    assert damping_balance(far).temperature == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("count", [1, 4])
def test_samples_of_many_contact_masses_give_the_balance_of_gauss_points(count, monkeypatch):
    expected = damping_balance(stopped_chain(count))
    monkeypatch.setattr("fpk.system.equivalent.MAX_GRID_POINTS", 0)
    sampled = damping_balance(stopped_chain(count))
    assert sampled.temperature == pytest.approx(expected.temperature, rel=0.02)
    assert sampled.energy == pytest.approx(expected.energy, rel=0.03)
    assert sampled.slope == pytest.approx(expected.slope, rel=0.05)


@pytest.mark.parametrize(("mass", "coefficient", "stable"), [(7, -0.8, True), (12, -1.7, False)])
def test_a_term_far_along_the_chain_is_weighed_with_all_stops(mass, coefficient, stable):
    """c11 = 0.1 + q1² + coefficient q_mass²: far out both squares are equal."""
    terms = (DampingTerm(1, 1, 1.0, q=((1, 2),)), DampingTerm(1, 1, coefficient, q=((mass, 2),)))
    system = stopped_chain(12, terms)
    if stable:
        MonteCarlo().prepare(system)
    else:
        with pytest.raises(NotApplicable, match="grows for ever"):
            MonteCarlo().prepare(system)


def test_a_power_that_vanishes_by_symmetry_is_none():
    """c11 = 0.1 + 0.1 H q1² q2 between equal stops: the mean of the term is 0 at every θ."""
    term = DampingTerm(1, 1, 0.1, q=((1, 2), (2, 1)), energy=1)
    system = chain(2, both(10.0, 0.3, mass=1), damping_terms=(term,))
    assert damping_balance(system).temperature == pytest.approx(0.5, rel=1e-12)
