"""Balance of damping terms and noise in a chain with stops, against other integrals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from averaging import Integrable, NonIntegrable
from fpk.answer.method import silent
from fpk.answer.names import Coordinate
from fpk.numeric.errors import NotApplicable
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.equivalent import _contact_states, damping_balance, equivalent_temperature
from fpk.system.system import System
from sim import MonteCarlo

CUBIC = Contact(1, "both", 100.0, 0.3, "power", exponent=3.0)


def one_mass(displacement: float, velocity: float, *contacts: Contact) -> System:
    """c = 0.1 + displacement q² + velocity v² on one mass."""
    terms = (
        DampingTerm(1, 1, displacement, q=((1, 2),)),
        DampingTerm(1, 1, velocity, v=((1, 2),)),
    )
    return System([1.0], [1.0], [0.1], [0.02], contacts=contacts, damping_terms=terms)


def test_a_stop_that_keeps_the_mass_from_where_it_is_driven_makes_the_system_stable() -> None:
    """E (0.1 − 0.2 q² + 0.03 v²) v² = D with E q² by adaptive quadrature."""
    system = one_mass(-0.2, 0.03, CUBIC)
    last = damping_balance(system)

    def power(theta: float) -> float:
        def weight(q: float) -> float:
            return float(np.exp(-system.potential(np.array([q])) / theta))

        square = quad(lambda q: q * q * weight(q), -3, 3)[0] / quad(weight, -3, 3)[0]
        return theta * (0.1 - 0.2 * square + 0.09 * theta)

    assert power(last.temperature) == pytest.approx(0.02, rel=0.02)
    slope = (power(1.01 * last.temperature) - power(0.99 * last.temperature)) / 0.02
    assert last.slope * last.temperature == pytest.approx(slope, rel=0.1)
    MonteCarlo().prepare(system)


@pytest.mark.parametrize("method", [MonteCarlo(), NonIntegrable()])
def test_a_stop_that_keeps_the_mass_from_where_it_is_damped_makes_the_energy_grow(
    method: MonteCarlo | NonIntegrable,
) -> None:
    with pytest.raises(NotApplicable, match="grows for ever"):
        method.prepare(one_mass(0.2, -0.03, CUBIC))
    method.prepare(one_mass(0.2, -0.03))  # without the stop it is stable


def test_stops_out_of_reach_leave_the_balance_of_the_chain() -> None:
    terms = (
        DampingTerm(1, 1, 0.7, q=((1, 2),)),
        DampingTerm(2, 2, 0.2, q=((1, 1), (2, 1)), v=((2, 2),), energy=1),
    )

    def chain(*contacts: Contact) -> System:
        return System(
            [1.0, 2.0], [1.0, 3.0], [0.05, 0.02], [0.01, 0.02],
            contacts=contacts, damping_terms=terms,
        )  # fmt: skip

    expected = equivalent_temperature(chain())
    for masses in ((1,), (2,), (1, 2)):
        far = chain(*(Contact(mass, "both", 1e-30, 10.0) for mass in masses))
        assert damping_balance(far).temperature == pytest.approx(expected, rel=0.02)


def test_moments_with_two_stops_against_a_sample() -> None:
    """E c_ij v_i v_j over a weighted sample of three coupled masses, two of which touch."""
    terms = (DampingTerm(1, 1, 0.5, q=((2, 1), (3, 1))), DampingTerm(2, 2, 0.3, q=((1, 3),)))
    stops = (Contact(1, "left", 20.0, 0.1), Contact(3, "right", 5.0, 0.05))
    system = System(
        [1.0, 2.0, 1.5], [1.0, 3.0, 0.5], [0.2, 0.3, 0.4], [0.01, 0.02, 0.03],
        contacts=stops, damping_terms=terms,
    )  # fmt: skip
    theta = damping_balance(system).temperature
    rng = np.random.default_rng(11)
    q = rng.multivariate_normal(np.zeros(3), theta * system.compliance, 400_000)
    weight = np.exp(-sum(system.contact_energy(i, q[:, i]) for i in (0, 2)) / theta)
    c = 0.5 * q[:, 1] * q[:, 2] / 1.0 + 0.3 * q[:, 0] ** 3 / 2.0
    mean = float(np.sum(weight * c) / np.sum(weight))
    power = theta * (0.2 / 1.0 + 0.3 / 2.0 + 0.4 / 1.5 + mean)
    assert power == pytest.approx(0.01 + 0.02 / 2.0 + 0.03 / 1.5, rel=0.02)
    assert abs(mean) > 0.02 * 0.6  # the terms are not lost in what is allowed


@pytest.mark.parametrize(("mass", "stiffness"), [(1.0, 1.0), (1.3, 0.7), (0.77, 3.1), (7.1, 0.9)])
def test_terms_that_cancel_on_average_are_decided_alike_by_all(
    mass: float, stiffness: float
) -> None:
    """0.3 κ q² − 0.1 μ v² averages to exactly zero: c is 0.1 on average, and p(H) exponential."""
    terms = (
        DampingTerm(1, 1, 0.3 * stiffness, q=((1, 2),)),
        DampingTerm(1, 1, -0.1 * mass, v=((1, 2),)),
    )
    system = System([mass], [stiffness], [0.1], [0.02], damping_terms=terms)
    MonteCarlo().prepare(system)
    for method, energy in ((NonIntegrable(), Coordinate("H")), (Integrable(), Coordinate("H", 0))):
        (density,) = method.prepare(system).solve([(energy,)], silent).densities
        value, error = density.at(np.array([0.1]))
        assert abs(value[0] - 5.0 * np.exp(-0.5)) <= error[0] + 1e-12
        assert density.certificate.certified


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_samples_of_many_contact_masses_give_what_gauss_points_give(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = stopped_chain(count)
    expected = damping_balance(system)
    monkeypatch.setattr("fpk.system.equivalent.MAX_GRID_POINTS", 0)
    sampled = damping_balance(system)
    assert sampled.temperature == pytest.approx(expected.temperature, rel=0.02)
    assert sampled.energy == pytest.approx(expected.energy, rel=0.03)
    assert sampled.slope == pytest.approx(expected.slope, rel=0.05)


@pytest.mark.parametrize("count", [6, 12, 30])
@pytest.mark.parametrize("stiffness", [100.0, 1e4])
def test_far_out_equal_stops_hold_all_masses_alike(count: int, stiffness: float) -> None:
    """Springs do not matter there: E q² = 2 ∫q² exp(−U/θ) dq / 2 ∫exp(−U/θ) dq of each mass."""
    contacts = tuple(Contact(i + 1, "both", stiffness, 0.3, "power", 3.0) for i in range(count))
    system = replace(stopped_chain(count), contacts=contacts)
    theta = 1e8
    q, weights = _contact_states(system, theta)
    squares = (q * q) @ weights / weights.sum()

    def moment(power: int) -> float:
        def weight(x: float) -> float:
            overlap = max(x - 0.3, 0.0)
            return float(x**power * np.exp(-stiffness * overlap**4 / (4.0 * theta)))

        reach = 0.3 + (160.0 * theta / stiffness) ** 0.25
        return quad(weight, 0.0, reach, points=[0.3], limit=200)[0]

    np.testing.assert_allclose(squares, moment(2) / moment(0), rtol=0.03)


@pytest.mark.parametrize(("mass", "coefficient", "stable"), [(7, -0.8, True), (12, -1.7, False)])
def test_a_term_far_along_the_chain_is_judged_with_all_stops(
    mass: int, coefficient: float, stable: bool
) -> None:
    """c11 = 0.1 + q1² + coefficient q_mass²: far out both squares are equal."""
    terms = (DampingTerm(1, 1, 1.0, q=((1, 2),)), DampingTerm(1, 1, coefficient, q=((mass, 2),)))
    system = replace(stopped_chain(12), damping_terms=terms)
    if stable:
        MonteCarlo().prepare(system)
    else:
        with pytest.raises(NotApplicable, match="grows for ever"):
            MonteCarlo().prepare(system)


def test_a_power_that_vanishes_by_symmetry_is_none() -> None:
    """c11 = 0.1 + 0.1 H q1² q2 between equal stops: the mean of the term is 0 at every θ."""
    term = DampingTerm(1, 1, 0.1, q=((1, 2), (2, 1)), energy=1)
    ones, stops = np.ones(2), (Contact(1, "both", 10.0, 0.3),)
    system = System(ones, ones, 0.1 * ones, 0.1 * ones, contacts=stops, damping_terms=(term,))
    assert damping_balance(system).temperature == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("count", [5, pytest.param(30, marks=pytest.mark.slow)])
def test_many_stops_are_part_of_the_balance(count: int) -> None:
    """Between its stops the first mass stays where it is damped; without them the energy grows."""
    MonteCarlo().prepare(stopped_chain(count))
    with pytest.raises(NotApplicable, match="grows for ever"):
        MonteCarlo().prepare(replace(stopped_chain(count), contacts=()))


def stopped_chain(count: int) -> System:
    """Hard stops on every mass, and c11 = 0.1 − 0.2 q1² + 0.03 v1²."""
    terms = one_mass(-0.2, 0.03).damping_terms
    contacts = tuple(Contact(i + 1, "both", 100.0, 0.3, "power", 3.0) for i in range(count))
    ones = np.ones(count)
    return System(ones, ones, 0.1 * ones, 0.02 * ones, contacts=contacts, damping_terms=terms)
