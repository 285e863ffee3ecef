"""One mass by finite elements in the plane: exact densities, values from outside, errors."""

from dataclasses import replace

import numpy as np
import pytest
from asked import solved, transient
from systems import both, by_energy

from averaging.gaussian import Linear
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.plane import elements, oscillator
from averaging.theory import Exact
from fpk import Contact, DampingTerm, System
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable

VAN_DER_POL = System(
    [1.0], [1.0], [-1.0], [0.3], damping_terms=(DampingTerm(1, 1, 1.0, q=((1, 2),)),)
)
CUBIC = System(
    [1.0], [1.0], [0.05], [0.2],
    contacts=(Contact(1, "right", 3.0, 0.0, law="bilinear"),),
    damping_terms=(DampingTerm(1, 1, 0.3, v=((1, 2),)),),
)  # fmt: skip


@pytest.mark.parametrize(
    ("system", "q", "p", "mean", "moment"),
    [
        (VAN_DER_POL, [0.0, 0.3, 1.0, 2.0], [0.1378333, 0.1420965, 0.1890900, 0.3055836],
         lambda q: q * q, 2.2064757),
        (CUBIC, [-1.0, 0.0, 0.3], [0.3224624, 0.6766157, 0.5527156], lambda q: q, -0.2920734),
    ],
    ids=["limit cycle", "tails thinner than a Gaussian"],
)  # fmt: skip
def test_values_from_outside(system, q, p, mean, moment):
    """Elements of degree 8 to 10 on rectangles, made outside, in seven digits."""
    (density,) = solved(PhaseSpace(tol=1e-4), system, "q1")
    assert density.certificate.certified, density.certificate.failures
    values, errors = density.at(np.array(q))
    assert np.all(np.abs(values - p) <= errors + 1e-7) and errors.max() < 1e-3
    number = density.expectation(mean)
    assert abs(number.value - moment) <= number.error + 1e-7


@pytest.mark.parametrize("contacts", [(), both(20.0, mass=1), (Contact(1, "right", 1e5, 0.1),)])
def test_exact_densities_by_another_weight_than_their_own(contacts, monkeypatch):
    """Condition (8): u = exp(−∫ c/D dH). The weight that is u itself would hide the equation."""
    system, weight = by_energy([1.0, 0.5, 0.2], [0.3], contacts), oscillator.weighted

    def other(o, top):
        o = weight(o, top)
        return replace(o, fall=0.6 * o.psi)

    monkeypatch.setattr(elements, "weighted", other)
    observables = "q1", "p1", "q1,p1"
    answers = solved(PhaseSpace(tol=1e-4), system, *observables)
    for density, exact in zip(answers, solved(Exact(), system, *observables), strict=True):
        assert density.certificate.certified, density.certificate.failures
        assert l1_distance(density, exact) <= density.l1_error
        points = [0.6 * np.array([x[0], x[0] / 3.0, x[-1] / 7.0, x[-1]]) for x in exact.panels]
        values, errors = density.at(*points)
        known, _ = exact.at(*points)
        assert np.all(np.abs(values - known) <= errors)


@pytest.mark.parametrize("ratio", [0.003, 0.5])
def test_identities_hold_for_light_and_strong_damping(ratio):
    terms = DampingTerm(1, 1, 2.0 * ratio, q=((1, 2),)), DampingTerm(1, 1, ratio, v=((1, 2),))
    system = System([2.0], [3.0], [ratio], [ratio], contacts=both(5.0, mass=1), damping_terms=terms)
    result = PhaseSpace(tol=1e-4).solve(system, [parse_observable("q1", 1)])
    assert result.densities[0].certificate.certified
    for identity in result.identities:
        assert abs(identity.value - identity.expected) <= identity.error < 1e-2, identity


FREE = System([1.0], [1.0], [0.3], [0.15])


@pytest.mark.parametrize(("name", "start"), [("q1", "q1=0.3,p1=-0.5"), ("q1,p1", "rest")])
def test_the_density_in_time_is_the_gaussian_one_without_stops(name, start):
    times, x = [3.0, 10.0, 40.0], np.linspace(-1.2, 1.4, 9)
    at = [x, 0.4 - 0.5 * x][: name.count(",") + 1]
    plane, exact = (
        transient(method, FREE, name, start, times, *at, tol=1e-4)
        for method in (PhaseSpace(), Linear())
    )
    assert plane.certificate.certified and exact.certificate.certified
    assert np.all(np.abs(plane.values - exact.values) <= plane.errors + exact.errors)
    assert plane.errors[-1].max() < 1e-8 and exact.errors.max() < 1e-11


def test_the_density_in_time_tends_to_the_stationary_one_of_a_limit_cycle():
    """From an orbit, which is even; phases mix at a rate of about 0.2."""
    q = np.array([0.0, 1.0, 2.0])
    answer = transient(PhaseSpace(), VAN_DER_POL, "q1", "H=0.5", [1.0, 100.0], q, tol=1e-3)
    assert answer.certificate.certified, answer.certificate.failures
    known = [0.1378333, 0.1890900, 0.3055836]
    assert np.all(np.abs(answer.values[1] - known) <= answer.errors[1] + 1e-7)
    assert abs(answer.values[0] - known).max() > 1e-2


@pytest.mark.parametrize(
    ("system", "name", "start", "words"),
    [
        (FREE, "H", "rest", "not those of energies"),
        (FREE, "q1", "noise=1", "stationary start"),
        (System([1.0] * 2, [1.0] * 2, [0.1] * 2, [0.1] * 2), "q1", "rest", "one mass"),
    ],
)
def test_densities_in_time_that_are_refused(system, name, start, words):
    with pytest.raises(NotApplicable, match=words):
        transient(PhaseSpace(), system, name, start, [1.0], np.zeros(1))
