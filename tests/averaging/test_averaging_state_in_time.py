"""Displacements and momenta in time by both averagings, against exact mixtures of Gaussians.

The averaged state of a linear oscillator with a uniform phase is a complex Ornstein-Uhlenbeck
process: p(q, t) = (1/2π) ∫N(q; a cos φ, s²) dφ. The trapezoidal rule in φ is exact to round-off
where it has several points per width of the Gaussian.
"""

from dataclasses import replace

import numpy as np
import pytest
from asked import modal_van_der_pol, transient
from scipy.special import roots_gegenbauer
from scipy.stats import multivariate_normal

from averaging import Integrable, NonIntegrable
from averaging.modal.analysis import modal_analysis
from fpk import Contact, System
from fpk.answer.names import parse_observable
from fpk.numeric.quadrature import panel_rule

ONE = System([1.5], [2.0], [0.1], [0.03])
TWO = System([1.0, 2.0], [1.0, 3.0], [0.1, 0.3], [0.02, 0.05])
THREE = System([1.0, 2.0, 0.5], [1.0, 3.0, 2.0], [0.1, 0.3, 0.1], [0.02, 0.05, 0.01])
HERTZ = replace(TWO, contacts=(Contact(2, "right", 10.0, 0.3, law="hertz"),))
MODES, TOTAL, FEM = Integrable(), NonIntegrable("closed-form"), NonIntegrable("fem")
PLANE = Integrable("fem")


def assert_within_stated_error(method, asked, exact):
    """The answer is certified, within its stated error of the exact one, and that is small."""
    answer = transient(method, *asked, tol=1e-10)
    assert answer.certificate.certified, answer.certificate.failures
    rounding = 1e-13 * np.max(exact)  # of the reference
    assert np.all(np.abs(answer.values - exact) <= answer.errors + rounding)
    assert np.all(answer.errors <= 1e-8 * np.max(exact))


def normal(x, variance):
    return np.exp(-0.5 * x * x / variance) / np.sqrt(2.0 * np.pi * variance)


def linear(system, start, t):
    """θ_t and a² = 2 H_0 e^(−ct) of energy averaging without contact."""
    c = np.sum(np.diag(system.damping) / system.mass) / system.n
    d = np.sum(np.diag(system.noise_intensity) / system.mass) / system.n
    return -d / c * np.expm1(-c * t), 2.0 * start * np.exp(-c * t)


@pytest.mark.parametrize("method", [MODES, TOTAL, FEM])
@pytest.mark.parametrize(("start", "t"), [(0.0, 1e-3), (0.5, 1e-4), (0.02, 40.0)])
def test_oscillator_is_a_gaussian_on_a_circle_of_uniform_phase(method, start, t):
    # From a point the energy is nearly sharp at first: the density has the peaks of arcsine's law.
    theta, square = linear(ONE, start, t)
    phase = (np.arange(20_000) + 0.5) * np.pi / 20_000
    orbit = np.sqrt(square) * np.cos(phase)
    x = np.append(np.linspace(-1.0, 1.0, 12), np.array([0.99, 1.0, 1.001]) * np.sqrt(square / 2.0))
    z = np.sqrt(2.0) * x  # √k q
    exact = np.sqrt(2.0) * np.array([np.mean(normal(y - orbit, theta)) for y in z])
    assert_within_stated_error(method, (ONE, "q1", f"H={start}", [t], x), exact)
    # Below, p = √m z.
    p1 = ONE, "p1", f"H={start}", [t], z * np.sqrt(1.5)
    assert_within_stated_error(method, p1, exact / np.sqrt(3.0))


@pytest.mark.parametrize(
    ("name", "start", "t"),
    [
        ("q1", "rest", 1e-3),
        ("q2,p1", "rest", 500.0),
        ("q2", "H1=0.3,H2=0.1", 0.05),
        ("q1,p2", "H1=0.3,H2=0.1", 1.0),
        ("q1,q2", "H1=0.3,H2=0.1", 9.0),
    ],
)
def test_modes_are_gaussians_on_a_torus(name, start, t):
    modes, observable = modal_analysis(TWO), parse_observable(name, 2)
    rows = modes.state_shapes[[c.row + 2 * (c.kind == "p") for c in observable]]
    H, decay = np.array([0.3, 0.1]) * (start != "rest"), np.diag(modes.modal_damping)
    theta = modes.temperature * -np.expm1(-decay * t)
    a = np.sqrt(2.0 * H * np.exp(-decay * t))
    phase = 2.0 * np.pi * np.arange(240) / 240 if start != "rest" else np.zeros(1)
    angles = np.array([f.ravel() for f in np.meshgrid(phase, phase)])
    state = np.concatenate([a[:, None] * np.cos(angles), a[:, None] * np.sin(angles)])
    centre, covariance = rows @ state, rows * np.tile(theta, 2) @ rows.T
    width = np.sqrt(np.diag(covariance)) * 1.5 if start == "rest" else np.full(len(rows), 0.4)
    at = width[:, None] * np.random.default_rng(2).normal(size=(len(rows), 8))
    gauss = multivariate_normal(np.zeros(len(rows)), covariance)
    exact = np.array([np.mean(gauss.pdf((x[:, None] - centre).T)) for x in at.T])
    assert_within_stated_error(MODES, (TWO, name, start, [t], *at), exact)
    if start != "rest":
        wrong = transient(MODES, TWO, name, "H1=0.3,H2=0.11", [t], *at, tol=1e-10)
        assert np.max(np.abs(wrong.values - exact)) > 1e3 * np.max(wrong.errors)


@pytest.mark.parametrize("t", [0.01, 5.0])
def test_total_energy_is_a_gaussian_on_a_sphere(t):
    # One coordinate of a uniform unit vector in 2n dimensions has the density ~ (1 − e²)^(n − 3/2).
    theta, square = linear(THREE, 0.5, t)
    e, w = roots_gegenbauer(400, THREE.n - 1.0)
    at, size = np.linspace(-1.2, 1.2, 9), np.sqrt(THREE.compliance[1, 1])
    mixed = normal((at / size)[:, None] - np.sqrt(square) * e, theta) @ w / w.sum()
    for method in (TOTAL, FEM):
        assert_within_stated_error(method, (THREE, "q2", "H=0.5", [t], at), mixed / size)


def test_joint_density_with_a_stop_integrates_to_the_marginal(name="p1", start="H=0.5", t=3.0):
    at = np.array([0.0, 0.1, 0.45])
    x, w = (a.ravel() for a in panel_rule(np.linspace(-5.0, 0.3, 150), 8))
    y, v = (a.ravel() for a in panel_rule(np.linspace(0.3, 2.0, 150), 8))
    q2, weights = np.append(x, y), np.append(w, v)
    pairs = np.repeat(at, q2.size), np.tile(q2, at.size)
    joint = transient(FEM, HERTZ, f"{name},q2", start, [t], *pairs, tol=1e-10)
    exact = joint.values.reshape(at.size, -1) @ weights
    assert_within_stated_error(FEM, (HERTZ, name, start, [t], at), exact)


@pytest.mark.parametrize(
    ("method", "system", "name", "start"),
    [
        (FEM, HERTZ, "q1", "H=0.5"),
        (FEM, HERTZ, "q2,p2", "H=0.5"),
        (PLANE, modal_van_der_pol(), "q1", "rest"),
    ],
)
def test_late_state_is_stationary(method, system, name, start):
    at = np.random.default_rng(4).normal(0.0, 0.3, (name.count(",") + 1, 10))
    late = transient(method, system, name, start, [5000.0], *at, tol=1e-7)
    (density,) = replace(method, tol=1e-9).solve(system, [parse_observable(name, 2)]).densities
    p, error = density.at(*at)
    assert late.certificate.certified
    assert np.all(np.abs(late.values[0] - p) <= late.errors[0] + error)
    assert np.all(late.errors[0] <= 1e-6 * p.max())


def test_beyond_the_last_energy_the_error_is_stated():
    far = transient(FEM, ONE, "q1", "rest", [1.0], [50.0], tol=1e-10)
    assert far.values[0, 0] == 0.0 < far.errors[0, 0]


def test_a_start_under_noise_has_a_density_at_once():
    later = transient(MODES, TWO, "q1", "noise=0.5", [1e-12], [0.1], tol=1e-10)
    assert_within_stated_error(MODES, (TWO, "q1", "noise=0.5", [0.0], [0.1]), later.values)
