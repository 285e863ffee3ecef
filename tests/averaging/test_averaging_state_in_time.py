"""Displacements and momenta in time by both averagings, against exact mixtures of Gaussians.

Of a linear oscillator whose phase is uniform the averaged state is a complex Ornstein-Uhlenbeck
process: p(q, t) = (1/2π) ∫N(q; a cos φ, s²) dφ. The trapezoidal rule in φ is exact to round-off
where it has several points per width of the Gaussian.
"""

from dataclasses import replace

import numpy as np
import pytest
from modal_terms import modal_van_der_pol
from numpy.testing import assert_allclose
from scipy.special import roots_gegenbauer
from scipy.stats import multivariate_normal

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.nonintegrable import NonIntegrable
from fpk.answer.method import silent
from fpk.answer.names import parse_observable, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.system.contact import Contact
from fpk.system.system import System
from sim import MonteCarlo

ONE = System([1.5], [2.0], [0.1], [0.03])
TWO = System([1.0, 2.0], [1.0, 3.0], [0.1, 0.3], [0.02, 0.05])
THREE = System([1.0, 2.0, 0.5], [1.0, 3.0, 2.0], [0.1, 0.3, 0.1], [0.02, 0.05, 0.01])
HERTZ = replace(TWO, contacts=(Contact(2, "right", 10.0, 0.3, law="hertz"),))
MODES, TOTAL, FEM = Integrable(), NonIntegrable("closed-form"), NonIntegrable("fem")


def transient(method, system, name, start, times, *at, tol=1e-10):
    asked = parse_observable(name, system.n), parse_start(start, system)
    points = tuple(np.asarray(x, dtype=float) for x in at)
    times = np.asarray(times, dtype=float)
    return method.transient(system, *asked, times, points, tol=tol, progress=silent)


def assert_within_stated_error(answer, exact, tol=1e-8):
    """The answer is certified, within its stated error of the exact one, and that is small."""
    assert answer.certificate.certified, answer.certificate.failures
    rounding = 1e-13 * np.max(exact)  # of the judge
    assert np.all(np.abs(answer.values - exact) <= answer.errors + rounding)
    assert np.all(answer.errors <= tol * np.max(exact))


def normal(x, variance):
    return np.exp(-0.5 * x * x / variance) / np.sqrt(2.0 * np.pi * variance)


def linear(system, start, t):
    """θ_t and a² = 2 H_0 e^(−ct) of energy averaging without contact."""
    c = np.sum(np.diag(system.damping) / system.mass) / system.n
    d = np.sum(np.diag(system.noise_intensity) / system.mass) / system.n
    return -d / c * np.expm1(-c * t), 2.0 * start * np.exp(-c * t)


@pytest.mark.parametrize("method", [MODES, TOTAL, FEM])
@pytest.mark.parametrize(("start", "t"), [(0.0, 1e-3), (0.5, 1e-4), (0.5, 1.0), (0.02, 40.0)])
def test_oscillator_is_a_gaussian_on_a_circle_of_uniform_phase(method, start, t):
    # From a point the energy is nearly sharp at first: the density has the peaks of arcsine's law.
    theta, square = linear(ONE, start, t)
    phase = (np.arange(20_000) + 0.5) * np.pi / 20_000
    orbit = np.sqrt(square) * np.cos(phase)
    x = np.append(np.linspace(-1.0, 1.0, 12), np.array([0.99, 1.0, 1.001]) * np.sqrt(square / 2.0))
    z = np.sqrt(2.0) * x  # √k q
    exact = np.sqrt(2.0) * np.array([np.mean(normal(y - orbit, theta)) for y in z])
    assert_within_stated_error(transient(method, ONE, "q1", f"H={start}", [t], x), exact)
    # Below, p = √m z.
    p = transient(method, ONE, "p1", f"H={start}", [t], z * np.sqrt(1.5))
    assert_within_stated_error(p, exact / np.sqrt(3.0))


def test_sharp_energy_peaks_near_the_turning_point():
    x = np.linspace(0.7, 0.712, 400)  # the amplitude is √(2 · 0.5/2) = 0.7071
    p = transient(FEM, ONE, "q1", "H=0.5", [1e-4], x).values[0]
    assert 0.705 < x[np.argmax(p)] < 0.7071
    assert p.max() > 4.0 * transient(FEM, ONE, "q1", "H=0.5", [1e-4], [0.0]).values[0, 0]


@pytest.mark.parametrize("name", ["q1", "p2", "q1,p1", "q1,q2", "q2,p1"])
def test_modes_from_rest_are_gaussian(name):
    modes, observable = modal_analysis(TWO), parse_observable(name, 2)
    rows = modes.state_shapes[[c.row + 2 * (c.kind == "p") for c in observable]]
    scaled = np.random.default_rng(1).normal(0.0, 1.5, (len(observable), 20))
    for t in (1e-3, 2.0, 500.0):
        theta = modes.temperature * -np.expm1(-np.diag(modes.modal_damping) * t)
        covariance = rows * np.tile(theta, 2) @ rows.T
        at = np.sqrt(np.diag(covariance))[:, None] * scaled
        exact = multivariate_normal(np.zeros(len(rows)), covariance).pdf(at.T)
        assert_within_stated_error(transient(MODES, TWO, name, "rest", [t], *at), exact)


@pytest.mark.parametrize(("name", "t"), [("q2", 0.05), ("p1", 3.0), ("q1,p2", 1.0), ("q1,q2", 9.0)])
def test_modes_from_energies_are_gaussians_on_a_torus(name, t):
    modes, observable = modal_analysis(TWO), parse_observable(name, 2)
    rows = modes.state_shapes[[c.row + 2 * (c.kind == "p") for c in observable]]
    H, decay = np.array([0.3, 0.1]), np.diag(modes.modal_damping)
    theta = modes.temperature * -np.expm1(-decay * t)
    a = np.sqrt(2.0 * H * np.exp(-decay * t))
    phase = 2.0 * np.pi * np.arange(240) / 240
    first, second = (f.ravel() for f in np.meshgrid(phase, phase))
    state = np.array([a[0] * np.cos(first), a[1] * np.cos(second), a[0] * np.sin(first),
                      a[1] * np.sin(second)])  # fmt: skip
    centre, covariance = rows @ state, rows * np.tile(theta, 2) @ rows.T
    at = np.random.default_rng(2).normal(0.0, 0.4, (len(rows), 8))
    gauss = multivariate_normal(np.zeros(len(rows)), covariance)
    exact = np.array([np.mean(gauss.pdf((x[:, None] - centre).T)) for x in at.T])
    assert_within_stated_error(transient(MODES, TWO, name, "H1=0.3,H2=0.1", [t], *at), exact)
    wrong = transient(MODES, TWO, name, "H1=0.3,H2=0.11", [t], *at)
    assert np.max(np.abs(wrong.values - exact)) > 1e3 * np.max(wrong.errors)


@pytest.mark.parametrize("t", [0.01, 5.0])
def test_total_energy_is_a_gaussian_on_a_sphere(t):
    # One coordinate of a uniform unit vector in 2n dimensions has the density ~ (1 − e²)^(n − 3/2).
    theta, square = linear(THREE, 0.5, t)
    e, w = roots_gegenbauer(400, THREE.n - 1.0)
    at = np.linspace(-1.2, 1.2, 9)
    z = at / np.sqrt(THREE.compliance[1, 1])
    mixed = normal(z[:, None] - np.sqrt(square) * e, theta) @ w / w.sum()
    exact = mixed / np.sqrt(THREE.compliance[1, 1])
    for method in (TOTAL, FEM):
        assert_within_stated_error(transient(method, THREE, "q2", "H=0.5", [t], at), exact)


@pytest.mark.parametrize("start", ["rest", "H=0.4", "noise=0.3"])
@pytest.mark.parametrize("name", ["q1", "p2", "q1,q2", "q2,p1"])
def test_stops_out_of_reach_change_nothing(name, start):
    # The displacement of mass 2 is integrated out by quadrature where it is not observed.
    far = replace(TWO, contacts=(Contact(2, "both", 10.0, 8.0),))
    at = np.random.default_rng(3).normal(0.0, 0.3, (name.count(",") + 1, 12))
    times = [0.02, 0.5, 30.0]
    exact = transient(TOTAL, TWO, name, start, times, *at).values
    for k, t in enumerate(times):
        assert_within_stated_error(transient(FEM, far, name, start, [t], *at), exact[k])


@pytest.mark.parametrize(("name", "start"), [("q1", "H=0.5"), ("p1", "rest")])
def test_joint_density_with_a_stop_integrates_to_the_marginal(name, start):
    at = np.array([0.0, 0.1, 0.45])
    x, w = (a.ravel() for a in panel_rule(np.linspace(-5.0, 0.3, 150), 8))
    y, v = (a.ravel() for a in panel_rule(np.linspace(0.3, 2.0, 150), 8))
    q2, weights = np.append(x, y), np.append(w, v)
    for t in (1.0, 10.0):
        joint = transient(FEM, HERTZ, f"{name},q2", start, [t], np.repeat(at, q2.size),
                          np.tile(q2, at.size))  # fmt: skip
        exact = joint.values.reshape(at.size, -1) @ weights
        assert_within_stated_error(transient(FEM, HERTZ, name, start, [t], at), exact)


@pytest.mark.parametrize("name", ["q1", "q2", "p1", "q2,p2"])
def test_late_state_is_stationary(name):
    at = np.random.default_rng(4).normal(0.0, 0.3, (name.count(",") + 1, 10))
    late = transient(FEM, HERTZ, name, "H=0.5", [2000.0], *at)
    (density,) = FEM.solve(HERTZ, [parse_observable(name, 2)]).densities
    p, error = density.at(*at)
    assert_allclose(late.values[0], p, rtol=0.0, atol=1e-10 * p.max())
    assert np.all(np.abs(late.values[0] - p) <= late.errors[0] + error)


def test_beyond_the_last_energy_the_error_is_stated():
    far = transient(FEM, ONE, "q1", "rest", [1.0], [50.0])
    assert far.values[0, 0] == 0.0 < far.errors[0, 0]


@pytest.mark.parametrize("name", ["q1", "q2,p2"])
def test_two_energies_by_elements_give_what_the_closed_form_gives(name):
    at = np.random.default_rng(6).normal(0.0, 0.4, (name.count(",") + 1, 10))
    asked = TWO, name, "H1=0.1,H2=0.3", [30.0, 300.0], *at
    exact = transient(MODES, *asked).values
    assert_within_stated_error(transient(Integrable("fem"), *asked, tol=1e-8), exact)


def test_late_state_of_coupled_energies_is_stationary():
    system, at = modal_van_der_pol(), np.linspace(-2.0, 2.0, 9)
    late = transient(Integrable("fem"), system, "q1", "rest", [5000.0], at, tol=1e-7)
    (density,) = Integrable("fem", tol=1e-9).solve(system, [parse_observable("q1", 2)]).densities
    p, error = density.at(at)
    assert late.certificate.certified
    assert np.all(np.abs(late.values[0] - p) <= late.errors[0] + error)
    assert np.all(late.errors[0] <= 1e-6 * p.max())


@pytest.mark.slow
def test_two_energies_too_soon_after_the_start_are_not_certified():
    asked = TWO, "q1", "H1=0.1,H2=0.3", [0.01], [0.0, 0.3]
    soon, exact = transient(Integrable("fem"), *asked, tol=1e-6), transient(MODES, *asked)
    assert not soon.certificate.certified
    assert np.all(np.abs(soon.values - exact.values) <= soon.errors)


STOPS = replace(THREE, contacts=tuple(Contact(i, "both", 10.0, 0.5) for i in (1, 2)))


@pytest.mark.parametrize(
    ("method", "system", "name", "error", "words"),
    [
        (Integrable("fem"), THREE, "q1", NotApplicable, "two modal energies, not for"),
        (NonIntegrable("quadrature"), TWO, "q1", NotApplicable, "stationary densities only"),
        (TOTAL, HERTZ, "q1", NotApplicable, "the system has contacts"),
        (FEM, TWO, "H1", NotApplicable, "knows the total energy only"),
        (FEM, STOPS, "p1", NotApplicable, "one contact mass at the most"),
        (MODES, TWO, "q1,H1", NotApplicable, "in time"),
    ],
)
def test_what_is_not_given_is_refused_in_one_line(method, system, name, error, words):
    at = [np.zeros(1)] * (name.count(",") + 1)
    with pytest.raises(error, match=words) as caught:
        transient(method, system, name, "rest", [1.0], *at)
    assert "\n" not in str(caught.value)


def test_no_density_at_the_start_and_none_too_narrow():
    with pytest.raises(InvalidInput, match="must be > 0"):
        transient(MODES, TWO, "q1", "rest", [0.0, 1.0], [0.0])
    with pytest.raises(NotApplicable, match="too narrow"):
        transient(TOTAL, TWO, "q1,p1", "H=0.5", [1e-6], [0.0], [0.0])
    at_once = transient(MODES, TWO, "q1", "noise=0.5", [0.0], [0.1])
    assert_within_stated_error(
        at_once, transient(MODES, TWO, "q1", "noise=0.5", [1e-12], [0.1]).values
    )


@pytest.mark.slow
def test_full_system_is_near_the_averaged_one_after_many_periods():
    # Fig. 6(a) with B = 10: what is left is the error of averaging, a few hundredths in L1.
    system = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02],
                    contacts=(Contact(2, "both", 10.0, 0.5),))  # fmt: skip
    edges = np.linspace(-1.0, 1.0, 41)
    middle = 0.5 * (edges[1:] + edges[:-1])
    times = [40.0, 100.0]
    p = transient(FEM, system, "q1", "rest", times, middle)
    full = transient(
        MonteCarlo(paths=20_000, seed=5), system, "q1", "rest", times, middle, tol=None
    )
    l1 = 0.05 * np.sum(np.abs(p.values - full.values), axis=1)
    assert np.all(l1 < 0.15), l1
