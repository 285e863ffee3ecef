"""Displacements tied by stiff springs to contact masses that are not observed."""

import numpy as np
import pytest
from asked import solved
from scipy.integrate import cubature
from systems import TWO_MASSES

from averaging import Exact, NonIntegrable
from averaging.conditional import (
    conditionals,
    gibbs_integral,
    hidden_integral,
)
from averaging.energy_process import log_gibbs_norm
from fpk import Contact, System

ALPHA = 2.0
METHODS = {
    "exact": Exact(),
    **{s: NonIntegrable(solver=s) for s in ("fem", "quadrature", "closed-form")},
}


def tied(ratio, contacts):
    """Two masses with springs 1 and ``ratio``, and (8) with h = ALPHA."""
    return System([1.0, 1.0], [1.0, ratio], [0.1, 0.1], [0.05, 0.05], contacts=contacts)


def graded(low, high, centres, width):
    """Gauss points and weights on panels that grow from ``width``/2 around ``centres``."""
    steps = np.concatenate([[0.0], 0.5 * width * 3.0 ** np.arange(25.0)])
    steps = steps[steps < high - low]
    fine = np.ravel([c + s * steps for c in centres for s in (-1.0, 1.0)])
    uniform = np.linspace(low, high, 11)
    nodes = np.unique(np.concatenate([uniform, fine[(fine > low) & (fine < high)]]))
    # 24 points on panels that are far shorter give the same densities to 2e-15.
    t, w = np.polynomial.legendre.leggauss(20)
    half = 0.5 * np.diff(nodes)[:, None]
    return (nodes[:-1, None] + half * (1.0 + t)).ravel(), (half * w).ravel()


def expected_q1(system, q1):
    """p(q1) of two masses in the Gibbs state by panels that know where the stops and q1 are."""
    k1, k2 = system.stiffness
    width = 1.0 / np.sqrt(ALPHA * (k1 + k2))
    stops = [stop.clearance * (1.0 if stop.side == "right" else -1.0) for stop in system.stops]

    def weight(x):
        # In the extension of the spring between the masses, which nothing cancels.
        touching = [s - x for s in stops]
        reach = 9.0 / np.sqrt(ALPHA * k2)
        z, w = graded(-reach, reach, [s for s in touching if abs(s) < reach], 0.01 * width)
        V = 0.5 * k1 * x * x + 0.5 * k2 * z * z
        contacts = system.contact_energy(0, np.array(x)) + system.contact_energy(1, x + z)
        return w @ np.exp(-ALPHA * (V + contacts))

    x, w = graded(-5.0, 5.0, stops, 0.3 * width)
    return np.array([weight(part) for part in q1]) / (w @ np.array([weight(part) for part in x]))


@pytest.mark.parametrize("ratio", [1.0, 1e6])
def test_a_mass_tied_to_a_contact_mass(ratio):
    system, q1 = tied(ratio, (Contact(2, "both", 10.0, 0.5),)), np.array([0.05, 0.49, 0.5, 0.6])
    expected = expected_q1(system, q1)
    for method in METHODS.values():
        (density,) = solved(method, system, "q1")
        assert density.certificate.certified
        value, error = density.at(q1)
        assert np.all(np.abs(value - expected) <= error + 2e-12)
        assert np.all(error < 1e-11)


@pytest.mark.parametrize("ratio", [pytest.param(1.0, marks=pytest.mark.slow), 1e6])
def test_the_norm_over_two_tied_contact_masses(ratio):
    contacts = (Contact(1, "both", 10.0, 0.4), Contact(2, "both", 20.0, 0.5))
    system = tied(ratio, contacts)
    q1 = np.array([0.0, 0.41, 0.55])
    (q,) = solved(Exact(), system, "q1")
    assert q.certificate.certified
    value, error = q.at(q1)
    assert np.all(np.abs(value - expected_q1(system, q1)) <= error + 2e-12)
    assert np.all(error < 1e-11)
    # E p² = m/h whatever touches what.
    (p1,) = solved(Exact(), system, "p1")
    assert p1.moment(2).value == pytest.approx(1.0 / ALPHA, rel=1e-10)


def test_conditional_laws_are_those_of_the_stiffness_matrix():
    system = System([1.0] * 4, [1.0, 3.0, 2.0, 5.0], [0.1] * 4, [0.1] * 4)
    order = [2, 0, 3, 1]
    laws = conditionals(system, order)
    assert np.prod([law.precision for law in laws]) == pytest.approx(np.prod(system.stiffness))
    q = np.array([0.3, -0.2, 0.7, 0.1])
    energy = sum(
        float(law.energy(q[k], law.weights @ q[order[:i]]))
        for i, (k, law) in enumerate(zip(order, laws, strict=True))
    )
    assert energy == pytest.approx(0.5 * q @ system.stiffness_matrix @ q, rel=1e-14)


@pytest.mark.parametrize(
    ("observed", "hidden"),
    [([1], [0, 3]), ([2], [0, 1]), ([3, 1], [0, 2]), ([], [0, 2])],
)
def test_passes_along_the_chain_are_the_integral_over_all_hidden_masses_at_once(observed, hidden):
    contacts = tuple(Contact(i + 1, "right", 10.0, 0.3) for i in hidden)
    system = System([1.0] * 4, [1.0, 3.0, 2.0, 5.0], [0.1] * 4, [0.1] * 4, contacts=contacts)
    at = np.linspace(-0.5, 0.9, 3 * len(observed)).reshape(len(observed), 3)
    laws = conditionals(system, [*observed, *hidden])[len(observed) :]
    T = 0.5
    zero = np.zeros(at.shape[1])
    direct = hidden_integral(
        lambda V: np.exp(-V / T), zero, at, laws, temperature=T, end=40.0 * T, points=12
    )
    scale = np.prod([np.sqrt(2.0 * np.pi * T / law.precision) for law in laws])
    value, error = gibbs_integral(system, observed, at, temperature=T, points=12)
    assert error < 1e-12
    np.testing.assert_allclose(scale * value, direct, rtol=1e-10, atol=scale * 1e-12)


def test_the_norm_over_three_contact_masses():
    # One pass along the chain, beside the cubature of the whole at once.
    contacts = (*TWO_MASSES, Contact(3, "left", 8.0, 0.4))
    system = System([1.0] * 3, [1.0, 2.0, 3.0], [0.2] * 3, [0.1] * 3, contacts=contacts)

    def weight(q):
        return np.exp(-ALPHA * system.potential(q))

    box = np.full(3, 6.0)
    integral = cubature(weight, -box, box, rtol=1e-5, rule="gk15").estimate
    momenta = (2.0 * np.pi / ALPHA) ** 1.5
    log_norm, error = log_gibbs_norm(system, ALPHA)
    assert error < 1e-12
    assert log_norm == pytest.approx(-np.log(integral * momenta), abs=1e-4)


@pytest.mark.parametrize("method", ["exact", "fem", "closed-form"])
def test_far_out_the_error_covers_what_the_grid_of_a_hidden_mass_leaves_out(method):
    # The stops of mass 1 hold mass 2 down: at two rms of the free chain p is below 1e-20, and where
    # it is most given q2 the energy is far above the last one of every mesh.
    contact = Contact(mass=1, side="both", stiffness=60.0, clearance=0.0, law="power", exponent=2.5)
    stiffness, T = np.array([0.4, 17.0]), 0.5
    system = System([1.0, 1.0], stiffness, [0.2, 0.4], [0.1, 0.2], contacts=(contact,))
    q2 = np.linspace(0.0, 2.0, 41) * np.sqrt(T * np.sum(1.0 / stiffness))
    x, w = graded(-3.0, 3.0, [0.0], 0.1)

    def log_weight(x, q):
        spring = 0.5 * stiffness[0] * x**2 + 0.5 * stiffness[1] * (q - x) ** 2
        return -(spring + 60.0 / 3.5 * np.abs(x) ** 3.5) / T

    unnormalised = [np.sum(w * np.exp(log_weight(x, q))) for q in q2]
    own = np.exp(log_weight(x, x))
    expected = np.array(unnormalised) / (np.sum(w * own) * np.sqrt(2.0 * np.pi * T / stiffness[1]))
    (density,) = solved(METHODS[method], system, "q2")
    p, error = density.at(q2)
    assert density.certificate.certified
    assert np.all(np.abs(p - expected) <= error + 1e-13 * expected)


@pytest.mark.parametrize(("coordinate", "masses"), [("q", 5), ("p", 10)])
def test_the_error_of_a_table_covers_every_point(masses, coordinate):
    # No contact: every displacement and momentum is Gaussian.
    n, T = masses, 2.0
    system = System(np.ones(n), np.ones(n), np.full(n, 0.05), np.full(n, 0.1))
    variance = T * (n if coordinate == "q" else 1.0)
    x = np.linspace(-6.0, 6.0, 1001) * np.sqrt(variance)
    expected = np.exp(-0.5 * x**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    (density,) = solved(METHODS["quadrature"], system, f"{coordinate}{n}")
    p, error = density.at(x)
    assert np.all(np.abs(p - expected) <= error + 5e-16 * (1.0 + 0.5 * x**2 / variance) * expected)
