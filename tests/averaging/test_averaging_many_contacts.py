"""Contact of many masses: inverse Laplace transforms and passes along the chain."""

from math import gamma

import numpy as np
import pytest
from modal_terms import solved

import averaging.shell.sums as sums
from averaging.exact import Exact
from averaging.nonintegrable import NonIntegrable
from averaging.shell.energy_shell import EnergyShell
from averaging.shell.laplace import PartitionLines
from averaging.shell.ratios import shell_ratios
from fpk.contact import Contact
from fpk.damping import DampingTerm
from fpk.errors import NotApplicable
from fpk.observable import parse_observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

TEMPERATURE = 0.5


def chain(n, masses, *, law="hertz", **more):
    """Unequal masses and springs, stops of growing clearance on both sides of some of them."""
    contacts = tuple(Contact(i, "both", 10.0, 0.4 + 0.03 * i, law) for i in masses)
    mass, springs = np.linspace(1.0, 2.0, n), np.linspace(1.0, 0.7, n)
    return System(mass, springs, np.full(n, 0.1), np.full(n, 0.05), contacts=contacts, **more)


def energies(system):
    """Energies just above each contact energy, and from there to far above all of them."""
    contact = system.fact(EnergyShell).contact_energies
    return np.append(1.01 * np.array(contact), contact[0] * np.array([2.0, 5.0, 20.0, 60.0]))


@pytest.mark.parametrize(
    ("n", "law", "most"), [(4, "hertz", 1e-5), (10, "hertz", 1e-10), (10, "bilinear", 1e-10)]
)
def test_lines_agree_with_rays_over_two_contact_masses(n, law, most):
    system = chain(n, (1, 3), law=law)
    H = energies(system)
    rays = shell_ratios(system, H)
    lines = system.fact(PartitionLines)(H, lambda own, E: np.array(shell_ratios(own, E)))
    states, volume, log_slope, error = lines
    assert np.all(np.abs(states - rays.states) <= (error + rays.error) * states)
    assert np.all(np.abs(volume - rays.volume) <= (error + rays.error) * volume)
    assert np.all(np.abs(log_slope - rays.log_slope) <= 2.0 * most * n)
    assert error.max() <= most


def test_two_contact_masses_of_a_long_chain(monkeypatch):
    # Along a ray v^28 is so narrow that 24 points missed 3e-10 where 6e-12 was stated.
    system = chain(30, (3, 20))
    H = energies(system)
    ratios = shell_ratios(system, H)
    monkeypatch.setattr(sums, "RADIAL_RULE", 3)
    monkeypatch.setattr("averaging.shell.ratios.MOST_MASSES", 30)
    reference = shell_ratios(chain(30, (3, 20)), H)
    assert np.all(np.abs(ratios.states / reference.states - 1.0) <= ratios.error + reference.error)
    assert ratios.error.max() < 1e-10


def over_a_grid(system, points, reach, *, held=None):
    """Potential on a grid over all displacements but q_1, which is ``held`` where it is given."""
    free = range(0 if held is None else 1, system.n)
    q = np.zeros((*(points for _ in free), system.n))
    q[..., 0] = 0.0 if held is None else held
    for axis, i in enumerate(free):
        shape = [-1 if a == axis else 1 for a in range(len(free))]
        q[..., i] = np.linspace(-reach, reach, points).reshape(shape)
    return system.potential(q)


@pytest.mark.parametrize("H", [1.0, 2.5])
def test_the_phase_volume_of_three_contact_masses(H):
    # It is ~ ∫(H − V)^(3/2) dq of three masses, by the trapezoidal rule in each displacement.
    system, reach = chain(3, (1, 2, 3)), 1.4
    ratios = shell_ratios(system, np.array([H]))
    free = (2.0 * np.pi) ** 1.5 * H**3 * gamma(2.5) / gamma(4.0) / np.prod(system.stiffness) ** 0.5
    coarse, fine = (
        np.sum(np.maximum(H - over_a_grid(system, points, reach), 0.0) ** 1.5)
        * (2.0 * reach / (points - 1)) ** 3
        / free
        for points in (61, 121)
    )
    error = abs(fine - coarse)
    assert error < 1e-4 * fine
    assert abs(ratios.volume[0] - fine) <= error + ratios.error[0] * fine


@pytest.mark.parametrize(("n", "points"), [(2, 201), (4, 61)])
def test_exact_displacements_of_stops_on_every_mass(n, points):
    system = chain(n, range(1, n + 1))
    (density,) = solved(Exact(tol=1e-10), system, "q1")
    assert density.certificate.certified
    q = np.array([0.0, 0.3, 0.9])
    values, errors = density.at(q)
    weights = [np.exp(-over_a_grid(system, points, 2.5, held=x) / TEMPERATURE).sum() for x in q]
    np.testing.assert_allclose(values / values[0], np.array(weights) / weights[0], rtol=2e-6)
    assert np.all(errors < 1e-10)


def test_ten_stops_are_exact_to_the_tolerance():
    system = chain(10, range(1, 11))
    (density,) = solved(Exact(tol=1e-10), system, "q10")
    assert density.certificate.certified
    x, w = np.polynomial.legendre.leggauss(400)
    low, high = density.panels[0][[0, -1]]
    total = 0.5 * (high - low) * w @ density(0.5 * (low + high) + 0.5 * (high - low) * x)
    assert total == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_thirty_stops_are_exact_to_the_tolerance():
    (density,) = solved(Exact(tol=1e-10), chain(30, range(1, 31)), "q30")
    assert density.certificate.certified


@pytest.mark.slow
@pytest.mark.parametrize("n", [4, 10])
def test_the_energy_of_stops_on_every_mass_is_certified(n):
    system = chain(n, range(1, n + 1))
    fem, form = (
        solved(NonIntegrable(solver=solver, tol=1e-6), system, "H")[0]
        for solver in ("fem", "closed-form")
    )
    assert fem.certificate.certified and form.certificate.certified
    H = np.linspace(*fem.panels[0][[0, -1]], 400)[1:-1]
    (a, ea), (b, eb) = fem.at(H), form.at(H)
    assert np.all(np.abs(a - b) <= ea + eb)


@pytest.mark.slow
def test_ten_stops_against_simulation():
    system = chain(10, range(1, 11))
    (exact,) = solved(Exact(), system, "q10")
    method = MonteCarlo(seed=5, threads=2, relaxations=40.0)
    (sampled,) = method.solve(system, [parse_observable("q10", 10)]).densities
    at = np.array([-0.8, -0.3, 0.0, 0.4, 0.9])
    value, error = sampled.at(at)
    z = (value - exact(at)) / error
    assert np.all(np.abs(z) < 5.0)


def test_what_is_still_refused():
    system = chain(6, range(1, 7))
    between = Exact().refusal(system, parse_observable("q1,q5", 6))
    assert between is not None and "3 contact masses" in between
    assert Exact().refusal(system, parse_observable("q1,q4", 6)) is None
    assert NonIntegrable().refusal(system, parse_observable("q1", 6)) is not None
    assert NonIntegrable(solver="closed-form").refusal(system, parse_observable("q1", 6)) is None
    damped = chain(5, range(1, 6), damping_terms=(DampingTerm(1, 1, 0.1, q=((1, 2),)),))
    with pytest.raises(NotApplicable, match=r"5 contact masses.*4 at the most"):
        NonIntegrable().prepare(damped)


def test_masses_tied_too_stiffly_are_refused():
    contacts = tuple(Contact(i, "both", 10.0, 0.5) for i in (1, 2, 3))
    system = System([1.0] * 3, [1.0, 1e8, 1e8], [0.1] * 3, [0.05] * 3, contacts=contacts)
    with pytest.raises(NotApplicable, match="tied too stiffly"):
        shell_ratios(system, np.array([2.0]))
