"""Displacements tied by stiff springs to contact masses that are not observed."""

from dataclasses import replace

import numpy as np
import pytest
from asked import assert_known, solved
from references import EnergyReference, chain_of, pieces

from averaging import Exact, NonIntegrable
from fpk import Contact, System

ALPHA = 2.0
METHODS = {
    "exact": Exact(),
    **{s: NonIntegrable(solver=s) for s in ("fem", "quadrature", "closed-form")},
}


ONE = (Contact(2, "both", 10.0, 0.5),)
BOTH = (Contact(1, "both", 10.0, 0.4), Contact(2, "both", 20.0, 0.5))


@pytest.mark.parametrize(
    ("ratio", "contacts", "methods"),
    [(1.0, ONE, METHODS), (1e6, ONE, METHODS), (1e6, BOTH, ["exact"])],
)
def test_a_mass_tied_to_a_contact_mass(ratio, contacts, methods):
    # (8) holds with h = ALPHA.
    system = System([1.0, 1.0], [1.0, ratio], [0.1, 0.1], [0.05, 0.05], contacts=contacts)
    q1 = np.array([0.0, 0.05, 0.41, 0.5, 0.6])
    # In the Gibbs state the stops of mass 1 are a factor of p(q1).
    others = tuple(c for c in contacts if c.mass == 2)
    reference = EnergyReference(chain_of(replace(system, contacts=others)))

    def weight(x):
        p = reference.of_displacement(0, x.ravel())[0].reshape(x.shape)
        return np.exp(-ALPHA * system.contact_energy(0, x)) * p

    stops = sorted(stop.sign * stop.clearance for stop in system.stops)
    expected = weight(q1) / pieces(weight, np.array([-5.0, *stops, 5.0]))
    for name in methods:
        q, p = solved(METHODS[name], system, "q1", "p1")
        assert np.all(assert_known(q, [q1], expected, rounding=2e-12) < 1e-11)
        # E p² = m/h whatever touches what.
        assert p.moment(2).value == pytest.approx(1.0 / ALPHA, rel=1e-10)


@pytest.mark.parametrize("method", ["exact", "fem", "closed-form"])
def test_far_out_the_error_covers_what_the_grid_of_a_hidden_mass_leaves_out(method):
    # The stops of mass 1 hold mass 2 down: at two rms of the free chain p is below 1e-20, and where
    # it is most given q2 the energy is far above the last one of every mesh.
    contact = Contact(mass=1, side="both", stiffness=60.0, clearance=0.0, law="power", exponent=2.5)
    stiffness, T = np.array([0.4, 17.0]), 0.5
    system = System([1.0, 1.0], stiffness, [0.2, 0.4], [0.1, 0.2], contacts=(contact,))
    q2 = np.linspace(0.0, 2.0, 41) * np.sqrt(T * np.sum(1.0 / stiffness))
    expected, _ = EnergyReference(chain_of(system)).of_displacement(1, q2)
    (density,) = solved(METHODS[method], system, "q2")
    assert_known(density, [q2], expected, rounding=1e-13 * expected)


@pytest.mark.parametrize(("coordinate", "masses"), [("q", 5), ("p", 10)])
def test_the_error_of_a_table_covers_every_point(masses, coordinate):
    # No contact: every displacement and momentum is Gaussian.
    n, T = masses, 2.0
    system = System(np.ones(n), np.ones(n), np.full(n, 0.05), np.full(n, 0.1))
    variance = T * (n if coordinate == "q" else 1.0)
    x = np.linspace(-6.0, 6.0, 1001) * np.sqrt(variance)
    expected = np.exp(-0.5 * x**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    (density,) = solved(METHODS["quadrature"], system, f"{coordinate}{n}")
    rounding = 5e-16 * (1.0 + 0.5 * x**2 / variance) * expected
    assert_known(density, [x], expected, rounding)


ROUND_OFF = 5e-15
"""Relative round-off of the reference, but for energies within 1e-8 of themselves of a stop's."""


def system_of(stiffness, damping, noise, stops):
    """One mass with ``stops``: side, stiffness, clearance and law of each."""
    contacts = tuple(Contact(1, *stop) for stop in stops)
    return System([1.0], [stiffness], [[damping]], [[noise]], contacts=contacts)


STOPS = {
    "far and none": (
        [("left", 22636.573, 2.10133450600572, "bilinear"), ("right", 184.84, 0.0, "hertz")],
        (0.13803692208250382, 0.053247678927404375, 6.890192884958267),
    ),
    "Hertz, both": ([("both", 118.9207115, 0.014142135623730949, "hertz")], (1.0, 0.1, 0.05)),
    "near and far, stiff": (
        [("left", 2e6, 0.085, "bilinear"), ("right", 433.0, 0.562, "bilinear")],
        (5.9, 0.1, 0.027),
    ),
    "very stiff": ([("right", 1e8, 0.4, "bilinear")], (1.0, 0.1, 0.1)),
}


@pytest.mark.parametrize("name", STOPS)
def test_the_mass_of_the_energy_is_one_to_its_error(name):
    stops, (stiffness, damping, noise) = STOPS[name]
    system, kT = system_of(stiffness, damping, noise, stops), noise / damping
    (p,) = solved(Exact(), system, "H")
    assert p.l1_error < 1e-11
    touched = [0.5 * stiffness * s.clearance**2 for s in system.stops]
    shares = np.array([0.5, 1.0 - 1e-6, 1.0 + 1e-12, 1.0 + 1e-8, 1.0 + 1e-5, 1.001, 1.1, 3.0])
    energies = kT * np.array([1e-12, 1e-6, 0.01, 0.3, 1.0, 3.0, 10.0])
    H = np.append(energies, np.outer(touched, shares))
    H = H[H > 0.0]
    expected, _ = EnergyReference(chain_of(system)).of_energy(H)
    assert_known(p, [H], expected, ROUND_OFF * expected)


@pytest.mark.parametrize("share", [-4e-16, 0.0, 4e-16])
def test_the_energy_of_a_stop_itself_is_known_to_its_rounding(share):
    # p rises from there like √(H − H_c), so that one rounding of H_c is 1e-8 of p.
    system = system_of(1.0, 0.1, 0.1, (("both", 1e6, 0.7, "bilinear"),))
    (p,) = solved(Exact(), system, "H")
    (contact,) = {0.5 * s.clearance**2 for s in system.stops}
    H = np.array([contact * (1.0 + share)])
    value, error = p.at(H)
    assert 1e-9 < error[0] / value[0] < 3e-8
    assert abs(value - EnergyReference(chain_of(system)).of_energy(H)[0]) <= error
