"""Averages of state-dependent damping over the energy shell: against sampling and trajectories."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from averaging_systems import chain, term_power

from averaging.energy_process import energy_process
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.process import log_density_slope
from fpk.system.system import System

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


SCENES = {
    "n = 1": scene(1, ONE, (Contact(1, "right", 20.0, 0.3),)),
    "n = 2": scene(2, TWO, RIGHT),
    "n = 2, both": scene(2, TWO, (*RIGHT, Contact(1, "both", 5.0, 0.2, "bilinear"))),
    "n = 3": scene(3, THREE, RIGHT),
    "n = 3, two": scene(3, THREE, (Contact(2, "both", 20.0, 0.3), Contact(3, "left", 2.0, 0.0))),
    "n = 3, free": scene(3, THREE),
    "odd, even V": scene(
        2, (DampingTerm(2, 2, 0.5, q=((2, 1),)),), (Contact(2, "both", 20.0, 0.3),)
    ),
}


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


def sampled_power(system, energy):
    """⟨Σ c_ij v_i v_j⟩ of the terms on one shell and its standard error."""
    terms, weight = sampled_terms(system, energy)
    power = terms.sum(axis=0)
    mean = weight @ power
    return mean, np.sqrt(np.sum((weight * (power - mean)) ** 2))


def size_of(system, energy):
    """What the errors of the power are relative to: Σ of the terms' rms values without contact."""
    terms, weight = sampled_terms(replace(system, contacts=()), energy)
    return np.sqrt(terms**2 @ weight).sum()


# 24 comparisons: 4.5 standard errors give a false alarm once in 6000 choices of the seed. The
# weight 1/√K of one mass has no variance: it is averaged over its period below.
@pytest.mark.parametrize("name", [name for name in SCENES if name != "n = 1"])
def test_the_power_is_the_mean_over_random_states_of_the_shell(name):
    system = SCENES[name]
    for energy in (0.05, 0.3, 1.0, 4.0):
        power, error = term_power(system)(np.array([energy]))
        mean, spread = sampled_power(system, energy)
        assert abs(power[0] - mean) < 4.5 * spread + error[0]
        assert error[0] < 2e-11 * size_of(system, energy)


def test_one_mass_is_averaged_over_its_period():
    system = SCENES["n = 1"]
    for energy in (0.3, 1.0, 4.0):
        # RK4 over 2000 steps a unit time from q at rest to the other turning point and back.
        reach = np.sqrt(2.0 * energy / 2.0)
        low, high = -reach, reach
        state, work, t, h = np.array([low, 0.0]), np.zeros(2), 0.0, 5e-4

        def rates(s, H=energy):
            q, v = s
            overlap = max(q - 0.3, 0.0)
            c = 0.7 * q**2 - 0.3 * v**2 * H + 0.4 * q
            return np.array([v, -(2.0 * q + 20.0 * overlap**1.5) / 1.3]), c * v * v

        while True:
            k1, w1 = rates(state)
            k2, w2 = rates(state + 0.5 * h * k1)
            k3, w3 = rates(state + 0.5 * h * k2)
            k4, w4 = rates(state + h * k3)
            new = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            gain = h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
            if state[1] > 0.0 >= new[1]:
                share = state[1] / (state[1] - new[1])
                work += share * np.array([gain, h])
                break
            work += np.array([gain, h])
            state, t = new, t + h
        assert high > state[0]
        power, error = term_power(system)(np.array([energy]))
        # The powers of overlap limit RK4 to order 2.5 at contact: (5e-4)^2.5 times its stiffness.
        assert power[0] == pytest.approx(work[0] / work[1], rel=1e-5)
        assert error[0] < 2e-11 * size_of(system, energy)


def test_below_contact_the_polynomial_of_the_energy_is_that_of_the_shell():
    # A contact that is out of reach leaves the polynomial; of one that is all but absent the
    # integrals are evaluated: the two ways meet.
    for n, terms in ((1, ONE), (2, TWO), (3, THREE)):
        free = scene(n, terms)
        far = scene(n, terms, (Contact(n, "right", 20.0, 100.0),))
        power = term_power(far)
        energy = np.array([0.1, 1.0, 7.0])
        np.testing.assert_allclose(power(energy)[0], term_power(free)(energy)[0], rtol=1e-13)
        absent = scene(n, terms, (Contact(n, "right", 1e-14, 0.01),))
        np.testing.assert_allclose(term_power(absent)(energy)[0], power(energy)[0], rtol=1e-11)


def test_of_two_contact_masses_the_table_is_what_it_interpolates():
    system = SCENES["n = 3, two"]
    energy = np.linspace(0.2, 3.0, 60)
    tabulated, bound = term_power(system)(energy)
    for k in range(0, 60, 12):
        direct, error = term_power(SCENES["n = 3, two"])(energy[k : k + 1])
        assert abs(direct[0] - tabulated[k]) <= bound[k] + error[0]
    assert np.all(bound < 1e-9)


def test_three_contact_masses_meet_the_sample():
    stops = tuple(Contact(i + 1, "both", 10.0, 0.3) for i in range(3))
    system = scene(4, (ONE[0], DampingTerm(2, 2, 0.2, q=((1, 1), (3, 1)))), stops)
    power, error = term_power(system)(np.array([1.0]))
    mean, spread = sampled_power(system, 1.0)
    assert abs(power[0] - mean) < 4.5 * spread
    assert error[0] < 1e-8 * size_of(system, 1.0)


def test_units_do_not_matter():
    a, L, t = 3.0, 0.02, 7.0
    E = a * L**2 / t**2
    one = SCENES["n = 2"]
    terms = tuple(
        DampingTerm(
            u.i,
            u.j,
            u.coefficient
            * (a / t)
            / (L ** sum(p for _, p in u.q) * (L / t) ** sum(p for _, p in u.v) * E**u.energy),
            q=u.q,
            v=u.v,
            energy=u.energy,
        )
        for u in one.damping_terms
    )
    stop = Contact(2, "right", 20.0 * a * L / t**2 / L**1.5, 0.3 * L)
    two = System(
        a * one.mass,
        a / t**2 * one.stiffness,
        a / t * one.damping,
        a**2 * L**2 / t**3 * one.noise_intensity,
        contacts=(stop,),
        damping_terms=terms,
    )
    energy = np.array([0.05, 0.5, 3.0])
    c, d = (
        p.coefficients(e)
        for p, e in zip(
            (energy_process(one), energy_process(two)), (energy, E * energy), strict=True
        )
    )
    np.testing.assert_allclose(d.drift, c.drift * E / t, rtol=1e-10)
    np.testing.assert_allclose(d.dissipation, c.dissipation * E / t, rtol=1e-10)
    np.testing.assert_allclose(log_density_slope(d) * E, log_density_slope(c), rtol=1e-9)
    assert energy_process(two).energy_scale == pytest.approx(E * energy_process(one).energy_scale)


def test_many_masses_with_a_term():
    power, error = term_power(
        System(
            np.ones(30),
            np.ones(30),
            np.full(30, 0.1),
            np.full(30, 0.05),
            contacts=(Contact(30, "both", 10.0, 0.5),),
            damping_terms=(DampingTerm(4, 4, 0.2, q=((4, 2),)),),
        )
    )(np.array([1.0, 10.0, 40.0]))
    assert np.all(error < 1e-11 * power) and np.all(power > 0)
    assert chain(30).n == 30


# One trajectory without damping and noise, long enough to visit the shell: masses 1 and 0.7 with a
# bilinear stop, where no orbit that stays by itself was met.
TRAJECTORY = System(
    [1.0, 0.7],
    [1.0, 1.0],
    [0.05, 0.02],
    [0.01, 0.02],
    contacts=(Contact(2, "right", 300.0, 0.2, "bilinear"),),
    damping_terms=(
        DampingTerm(1, 1, 0.3, q=((1, 2),)),
        DampingTerm(2, 2, 0.2, q=((2, 1),)),
        DampingTerm(1, 1, 0.4, v=((2, 2),)),
        DampingTerm(1, 2, 0.1, q=((1, 1), (2, 1))),
    ),
)
STEP, STEPS, BATCHES, STARTS = 1e-3, 1_000_000, 25, 6


@numba.njit(cache=True)
def time_averages(q, v, dt, steps, batches):
    """Batch means of Σ c_ij v_i v_j and Σ D_ii v_i² of ``TRAJECTORY`` by velocity Verlet.

    The step is 0.02 of the time of the stop: Verlet's shadow energy departs by (0.02)²/8 = 5e-5 in
    contact, and wanders where the stiffness jumps, by a thousandth in a batch: v is
    brought back to H = 1 after each. The third column is how far it had gone.
    """
    means = np.zeros((batches, 3))
    a = -2.0 * q[0] + q[1], (q[0] - q[1] - 300.0 * max(q[1] - 0.2, 0.0)) / 0.7
    for b in range(batches):
        power = noise = 0.0
        for _ in range(steps):
            v[0] += 0.5 * dt * a[0]
            v[1] += 0.5 * dt * a[1]
            q[0] += dt * v[0]
            q[1] += dt * v[1]
            a = -2.0 * q[0] + q[1], (q[0] - q[1] - 300.0 * max(q[1] - 0.2, 0.0)) / 0.7
            v[0] += 0.5 * dt * a[0]
            v[1] += 0.5 * dt * a[1]
            c = 0.05 + 0.3 * q[0] ** 2 + 0.4 * v[1] ** 2
            power += c * v[0] ** 2 + (0.02 + 0.2 * q[1]) * v[1] ** 2
            power += 0.1 * q[0] * q[1] * v[0] * v[1]
            noise += 0.01 * v[0] ** 2 + 0.02 * v[1] ** 2
        kinetic = 0.5 * (v[0] ** 2 + 0.7 * v[1] ** 2)
        potential = 0.5 * q[0] ** 2 + 0.5 * (q[1] - q[0]) ** 2
        potential += 150.0 * max(q[1] - 0.2, 0.0) ** 2
        means[b] = power / steps, noise / steps, kinetic + potential - 1.0
        v *= np.sqrt(max(1.0 - potential, 0.0) / kinetic)
    return means


def test_drift_and_diffusion_are_time_averages_of_a_trajectory():
    energy = 1.0
    c = energy_process(TRAJECTORY).coefficients(np.array([energy]))
    source = 0.01 / 1.0 + 0.02 / 0.7
    rng = np.random.default_rng(3)
    values, errors = [], []
    for _ in range(STARTS):
        q = 0.3 * rng.normal(size=2)
        while TRAJECTORY.potential(q) > 0.9 * energy:
            q = 0.3 * rng.normal(size=2)
        v = rng.normal(size=2)
        v *= np.sqrt(2.0 * (energy - TRAJECTORY.potential(q))) / np.linalg.norm(v)
        v /= np.sqrt(TRAJECTORY.mass)
        means = time_averages(q, v, STEP, STEPS, BATCHES)
        assert TRAJECTORY.hamiltonian(q, v * TRAJECTORY.mass) == pytest.approx(energy, rel=1e-12)
        assert np.max(np.abs(means[:, 2])) < 2e-3
        values.append(means[:, :2].mean(axis=0))
        errors.append(means[:, :2].std(axis=0, ddof=1) / np.sqrt(BATCHES))
    expected = np.array([source - c.drift[0], 0.5 * c.diffusion[0]])
    # No start is a separate part of the shell: each one meets the average. With 25 batches, 4.5
    # standard errors are met but once in 7000; there are twelve of them.
    z = (np.array(values) - expected) / np.array(errors)
    assert np.max(np.abs(z)) < 4.5
    # All together: the accuracy that is shown, and a false alarm once in 15 000.
    mean, error = np.mean(values, axis=0), np.linalg.norm(errors, axis=0) / STARTS
    assert np.all(error < 0.01 * expected)
    assert np.all(np.abs(mean - expected) < 4.0 * error)
    # A factor of the momenta off by (n + 2)/n = 2, the one of another shell, would not pass.
    wrong = expected[0] + term_power(TRAJECTORY)(np.array([energy]))[0][0]
    assert abs(mean[0] - wrong) > 20.0 * error[0]
