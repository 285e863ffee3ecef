"""Averaged energies in time: the method nonintegrable and closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from averaging.nonintegrable import NonIntegrable
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_observable, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.system import System

FREE = System([1.0, 2.0], [1.0, 3.0], [0.1, 0.3], [0.02, 0.05])
"""c = Σ(c_i/m_i)/2 = 0.125 and d = Σ(D_i/m_i)/2 = 0.0225, so that the temperature is 0.18."""
TOUCHING = replace(FREE, contacts=(Contact(2, "both", 10.0, 0.5),))
SETTINGS = {"tol": None, "progress": silent}


def transient(system, start, times, at, solver="fem", observable="H", **settings):
    method = NonIntegrable(solver=solver)
    named = parse_observable(observable, system.n), parse_start(start, system)
    return method.transient(system, *named, np.array(times), (np.array(at),), **SETTINGS | settings)


def passage(system, limit, start="rest", times=(), solver="fem"):
    method = NonIntegrable(solver=solver)
    named = parse_limit(limit, system.n), parse_start(start, system)
    return method.passage(system, *named, np.array(times), **SETTINGS)


@pytest.mark.parametrize("start", ["rest", "H=0.5", "q1=0.3,p2=-0.4", "noise=0.5", "noise=0"])
def test_solvers_agree_on_the_transient_density(start):
    times, at = [0.1, 3.0, 100.0], np.linspace(-0.1, 2.0, 15)
    a, b = (transient(FREE, start, times, at, solver) for solver in ("fem", "closed-form"))
    assert a.certificate.certified and b.certificate.certified
    assert np.all(np.abs(a.values - b.values) <= a.errors + b.errors)
    assert a.errors.max() < 1e-9 and np.all(a.values[:, 0] == 0.0)


def test_a_state_begins_with_its_energy():
    start = parse_start("q1=0.3,p2=-0.4", TOUCHING)
    energy = float(TOUCHING.hamiltonian(*start.state(2)))
    a, b = (passage(TOUCHING, "H=2", name) for name in ("q1=0.3,p2=-0.4", f"H={energy!r}"))
    assert a.mean == b.mean


def test_solvers_agree_on_first_passage_and_rates():
    times = [0.0, 5.0, 50.0]
    a, b = (passage(FREE, "H=0.9", times=times, solver=s) for s in ("fem", "closed-form"))
    for x, y in ((a.mean, b.mean), (a.variance, b.variance), (a.rate, b.rate)):
        assert abs(x.value - y.value) <= x.error + y.error < 1e-10 * x.value
    assert np.all(np.abs(a.survival - b.survival) <= a.survival_error + b.survival_error)
    fem, closed = (
        NonIntegrable(solver=s).relaxation(FREE, 4, **SETTINGS) for s in ("fem", "closed-form")
    )
    np.testing.assert_allclose(closed.values, 0.125 * np.arange(1, 5), rtol=1e-14)
    assert np.all(np.abs(fem.values - closed.values) <= fem.errors + closed.errors)


def test_with_contact_it_ends_in_the_stationary_density():
    at = np.linspace(0.05, 2.0, 9)
    late = transient(TOUCHING, "rest", [1.0, 2e3], at)
    (density,) = NonIntegrable().solve(TOUCHING, [parse_observable("H", 2)]).densities
    p, error = density.at(at)
    assert np.all(np.abs(late.values[1] - p) <= late.errors[1] + error)
    # Without the time the assertion fails.
    assert np.max(np.abs(late.values[0] - p)) > 0.1


REFUSED = [
    (lambda: transient(FREE, "rest", [1.0], [0.1], observable="H1"), NotApplicable, "total energy"),
    (lambda: transient(FREE, "rest", [1.0], [0.1], "quadrature"), NotApplicable, "use fem"),
    (lambda: transient(TOUCHING, "rest", [1.0], [0.1], "closed-form"), NotApplicable, "contacts"),
    (lambda: transient(FREE, "H1=1,H2=1", [1.0], [0.1]), NotApplicable, "total energy"),
    (lambda: transient(FREE, "rest", [0.0, 1.0], [0.1]), InvalidInput, "no density"),
    (lambda: transient(FREE, "rest", [2.0, 1.0], [0.1]), InvalidInput, "ascend"),
    (lambda: transient(FREE, "rest", [np.nan], [0.1]), InvalidInput, "finite"),
    (lambda: passage(FREE, "H1=1"), NotApplicable, "total energy"),
    (lambda: passage(FREE, "q1=1"), NotApplicable, "total energy"),
    (lambda: passage(FREE, "H=1", "H=1"), InvalidInput, "below the limit"),
    (lambda: passage(FREE, "H=1000"), InvalidInput, "beyond the range"),
    (lambda: passage(FREE, "H=1", times=[-1.0]), InvalidInput, "0 or later"),
    (lambda: passage(FREE, "H=1", "noise=2", solver="closed-form"), NotApplicable, "use fem"),
    (lambda: passage(replace(FREE, noise_intensity=[0, 0]), "H=1"), NotApplicable, "no noise"),
]


@pytest.mark.parametrize(("ask", "error", "word"), REFUSED)
def test_what_is_not_given_is_refused(ask, error, word):
    with pytest.raises(error, match=word):
        ask()
