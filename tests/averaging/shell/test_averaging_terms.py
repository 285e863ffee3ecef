"""Averages of state-dependent damping over the energy shell: against sampling and one period."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from systems import chain, in_units

from averaging.energy_process import energy_process
from averaging.shell.averages import shell_averages
from fpk import Contact, DampingTerm, System
from fpk.system.process import log_density_slope

ONE = (
    DampingTerm(1, 1, 0.7, q=((1, 2),)),
    DampingTerm(1, 1, -0.3, v=((1, 2),), energy=1),
    DampingTerm(1, 1, 0.4, q=((1, 1),)),
)
TWO = (
    ONE[0],
    DampingTerm(2, 1, 0.5, q=((1, 1),), v=((1, 1), (2, 1))),
    DampingTerm(2, 2, -0.3, q=((2, 3),)),
    DampingTerm(1, 2, 0.2, q=((1, 1), (2, 1)), v=((1, 1), (2, 1)), energy=1),
)
THREE = (*TWO, DampingTerm(3, 1, 0.6, q=((2, 1), (3, 1)), v=((1, 1), (3, 1))))
RIGHT = (Contact(2, "right", 20.0, 0.3),)


def scene(n, terms, contacts=()):
    masses, springs = [1.3, 0.6, 0.9, 1.1], [2.0, 1.0, 3.0, 1.5]
    damping = noise = np.full(n, 0.1)
    return System(masses[:n], springs[:n], damping, noise, contacts=contacts, damping_terms=terms)


ODD = (DampingTerm(2, 2, 0.5, q=((2, 1),)),)
SCENES = {
    "n = 2": scene(2, TWO, RIGHT),
    "n = 2, both": scene(2, TWO, (*RIGHT, Contact(1, "both", 5.0, 0.2, "bilinear"))),
    "n = 3": scene(3, THREE, RIGHT),
    "n = 3, two": scene(3, THREE, (Contact(2, "both", 20.0, 0.3), Contact(3, "left", 2.0, 0.0))),
    "n = 3, free": scene(3, THREE),
    "odd, even V": scene(2, ODD, (Contact(2, "both", 20.0, 0.3),)),
}


def term_power(system, energy):
    """The power of the damping terms and its error."""
    return shell_averages(system, np.atleast_1d(energy))[4:]


def sampled_terms(system, energy, samples=200_000, seed=20261121):
    """c_ij v_i v_j of each term at random states of one shell, and the weights of these.

    q is uniform where the springs alone have less than H, v uniform in direction: the weight of
    the shell is then K^(n/2 − 1).
    """
    rng, n = np.random.default_rng(seed), system.n
    x = rng.standard_normal((samples, n))
    x *= rng.random((samples, 1)) ** (1 / n) / np.linalg.norm(x, axis=1, keepdims=True)
    q = np.sqrt(2.0 * energy) * x @ np.linalg.cholesky(np.linalg.inv(system.stiffness_matrix)).T
    kinetic = energy - system.potential(q)
    q, kinetic = q[kinetic > 0], kinetic[kinetic > 0]
    v = rng.standard_normal(q.shape)
    v *= np.sqrt(2.0 * kinetic)[:, None] / np.linalg.norm(v, axis=1, keepdims=True)
    v /= np.sqrt(system.mass)
    levels = np.full(kinetic.size, energy)
    power = [t.value(q, v, levels) * v[:, t.row] * v[:, t.column] for t in system.damping_terms]
    return np.array(power), kinetic ** (n / 2 - 1) / np.sum(kinetic ** (n / 2 - 1))


def assert_sampled(system, energy, relative):
    """The power meets the sample to 4.5 standard errors; its own error is ``relative`` or less.

    ``relative`` to the sum of the rms values of the terms without contact.
    """
    power, error = term_power(system, energy)
    terms, weight = sampled_terms(system, energy)
    values = terms.sum(axis=0)
    mean = weight @ values
    spread = np.sqrt(np.sum((weight * (values - mean)) ** 2))
    assert abs(power[0] - mean) < 4.5 * spread + error[0]
    terms, weight = sampled_terms(replace(system, contacts=()), energy)
    assert error[0] < relative * np.sqrt(terms**2 @ weight).sum()


# 24 comparisons: 4.5 standard errors give a false alarm once in 6000 choices of the seed. The
# weight 1/√K of one mass has no variance: it is averaged over its period below.
@pytest.mark.parametrize("name", SCENES)
def test_the_power_is_the_mean_over_random_states_of_the_shell(name):
    for energy in (0.05, 0.3, 1.0, 4.0):
        assert_sampled(SCENES[name], energy, 2e-11)


def test_three_contact_masses_meet_the_sample():
    stops = tuple(Contact(i + 1, "both", 10.0, 0.3) for i in range(3))
    terms = (ONE[0], DampingTerm(2, 2, 0.2, q=((1, 1), (3, 1))))
    assert_sampled(scene(4, terms, stops), 1.0, 1e-8)


@pytest.mark.parametrize("energy", [0.3, 1.0, 4.0])
def test_one_mass_is_averaged_over_its_period(energy):
    def rates(t, s):
        q, v, *_ = s
        c = 0.7 * q**2 - 0.3 * v**2 * energy + 0.4 * q
        return [v, -(2.0 * q + 20.0 * max(q - 0.3, 0.0) ** 1.5) / 1.3, c * v * v]

    def turns(t, s):
        return s[1]

    turns.terminal, turns.direction = True, -1.0
    start = [-np.sqrt(energy), 0.0, 0.0]  # at rest on the left, where no stop is
    half = solve_ivp(rates, (0.0, 100.0), start, events=turns, rtol=1e-10, atol=1e-12)
    power, error = term_power(scene(1, ONE, (Contact(1, "right", 20.0, 0.3),)), energy)
    assert power[0] == pytest.approx(half.y[2, -1] / half.t[-1], rel=1e-7)
    assert error[0] < 1e-10 * max(abs(power[0]), energy**2)


def test_below_contact_the_polynomial_of_the_energy_is_that_of_the_shell():
    # A contact that is out of reach leaves the polynomial; of one that is all but absent the
    # integrals are evaluated: the two ways meet.
    for n, terms in ((1, ONE), (2, TWO), (3, THREE)):
        energy = np.array([0.1, 1.0, 7.0])
        free = term_power(scene(n, terms), energy)[0]
        far, absent = (
            term_power(scene(n, terms, (Contact(n, "right", *stop),)), energy)[0]
            for stop in ((20.0, 100.0), (1e-14, 0.01))
        )
        np.testing.assert_allclose(far, free, rtol=1e-13)
        np.testing.assert_allclose(absent, far, rtol=1e-11)


def test_of_two_contact_masses_the_table_is_within_its_error():
    system, energy = SCENES["n = 3, two"], np.linspace(0.2, 3.0, 60)
    tabulated, bound = term_power(system, energy)
    for k in range(0, 60, 12):
        direct, error = term_power(replace(system), energy[k])
        assert abs(direct[0] - tabulated[k]) <= bound[k] + error[0]
    assert np.all(bound < 1e-9)


def test_units_do_not_matter():
    a, L, t = 3.0, 0.02, 7.0
    E, one, energy = a * L**2 / t**2, SCENES["n = 2"], np.array([0.05, 0.5, 3.0])
    p, r = energy_process(one), energy_process(in_units(one, a, L, t))
    c, d = p.coefficients(energy), r.coefficients(E * energy)
    np.testing.assert_allclose(d.drift, c.drift * E / t, rtol=1e-10)
    np.testing.assert_allclose(d.dissipation, c.dissipation * E / t, rtol=1e-10)
    np.testing.assert_allclose(d.diffusion, c.diffusion * E**2 / t, rtol=1e-10)
    np.testing.assert_allclose(d.divergence, c.divergence * E / t, rtol=1e-10)
    np.testing.assert_allclose(log_density_slope(d) * E, log_density_slope(c), rtol=1e-9)
    assert r.energy_scale == pytest.approx(E * p.energy_scale)


def test_many_masses_with_a_term():
    terms = (DampingTerm(4, 4, 0.2, q=((4, 2),)),)
    system = chain(30, (Contact(30, "both", 10.0, 0.5),), damping_terms=terms)
    power, error = term_power(system, np.array([1.0, 10.0, 40.0]))
    assert np.all(error < 1e-11 * power) and np.all(power > 0)
