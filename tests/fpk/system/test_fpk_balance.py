"""Balance of damping terms and noise in a chain with stops, against other integrals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from systems import both, chain

from averaging import NonIntegrable
from fpk import Contact, DampingTerm, System
from fpk.numeric.errors import NotApplicable
from fpk.system.equivalent import damping_balance, equivalent_temperature
from sim import MonteCarlo

HARD = both(100.0, 0.3, "power", mass=1, exponent=3.0)


def squares(displacement, velocity):
    """c_11 gains ``displacement`` q1² + ``velocity`` v1²."""
    return (
        DampingTerm(1, 1, displacement, q=((1, 2),)),
        DampingTerm(1, 1, velocity, v=((1, 2),)),
    )


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


def test_moments_with_two_stops_against_a_sample():
    """E c_ij v_i v_j over a weighted sample of three coupled masses, two of which touch."""
    terms = (DampingTerm(1, 1, 0.5, q=((2, 1), (3, 1))), DampingTerm(2, 2, 0.3, q=((1, 3),)))
    stops = (Contact(1, "left", 20.0, 0.1), Contact(3, "right", 5.0, 0.05))
    mass, damping, noise = [1.0, 2.0, 1.5], [0.2, 0.3, 0.4], [0.01, 0.02, 0.03]
    system = System(mass, [1.0, 3.0, 0.5], damping, noise, contacts=stops, damping_terms=terms)
    theta = damping_balance(system).temperature
    rng = np.random.default_rng(11)
    q = rng.multivariate_normal(np.zeros(3), theta * system.compliance, 400_000)
    weight = np.exp(-sum(system.contact_energy(i, q[:, i]) for i in (0, 2)) / theta)
    c = 0.5 * q[:, 1] * q[:, 2] / 1.0 + 0.3 * q[:, 0] ** 3 / 2.0
    mean = float(np.sum(weight * c) / np.sum(weight))
    power = theta * (0.2 / 1.0 + 0.3 / 2.0 + 0.4 / 1.5 + mean)
    assert power == pytest.approx(0.01 + 0.02 / 2.0 + 0.03 / 1.5, rel=0.02)
    assert abs(mean) > 0.02 * 0.6  # the terms are not lost in the tolerance


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow), 4])
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
