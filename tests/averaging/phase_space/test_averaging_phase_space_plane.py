"""One mass by finite elements in the plane: exact densities, values from outside, errors."""

from dataclasses import replace

import numpy as np
import pytest
from asked import solved, transient
from systems import both, by_energy

from averaging.gaussian import Linear
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.plane import elements, oscillator, stationary
from averaging.phase_space.plane.stationary import plane_ladder, plane_ladder_of
from averaging.phase_space.refinement import LEAST_SHARE, Options
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


def test_a_distance_of_one_density_far_below_that_of_the_other_is_not_believed(monkeypatch):
    q, p = (parse_observable(c, 1) for c in ("q1", "p1"))
    ladder = next(plane_ladder(oscillator.oscillator_of(CUBIC), [q, p], Options(4.0, 1e12)))
    by_chance = {q: 1e-3, p: 1e-9}
    monkeypatch.setattr(stationary, "solution_distance", lambda a, b, of: by_chance[of])
    again = plane_ladder_of(ladder.finest, ladder.coarser, [q, p])
    assert again.believed == {q: 1e-3, p: pytest.approx(LEAST_SHARE * 1e-3)}
    assert again.errors[p] == pytest.approx(LEAST_SHARE * again.errors[q], rel=1e-3)


def one(m, k, c, D, term, *stop):
    contacts = (Contact(1, *stop),) if stop else ()
    return System([m], [k], [c], [D], contacts=contacts, damping_terms=(term,))


@pytest.mark.parametrize(
    ("system", "q", "of_q", "p", "of_p"),
    [
        (one(0.3, 0.702, -0.00402, 0.00163, DampingTerm(1, 1, 0.00191, q=((1, 2),))),
         [0.0, 2.06], [0.1186313, 0.1723019], [0.0, 0.943], [0.2585103, 0.3749130]),
        (one(0.158, 0.371, 0.116, 0.0848, DampingTerm(1, 1, 0.0903, q=((1, 4),)),
             "right", 2030.0, 1.2, "power", 2.5),
         [-1.15, -0.267, 0.616], [0.3095018, 0.3520099, 0.3239425],
         [-0.265, 0.0, 0.265], [0.8393617, 1.5607332, 0.9246562]),
        (one(0.306, 1.0, -0.00622, 0.0256, DampingTerm(1, 1, 3.53e-6, v=((1, 4),)),
             "both", 71100.0, 0.0, "bilinear"),
         [0.0, 0.0104], [26.4631211, 30.3960617], [0.0, 1.54], [0.1794083, 0.2061556]),
        (one(5.73, 2.92, -3.2, 0.593, DampingTerm(1, 1, 14200.0, v=((1, 4),)),
             "both", 11300.0, 0.0989, "power", 3.0),
         [0.0, 0.0915], [3.4507921, 3.0215300], [0.0, 0.658], [0.4300756, 0.4741708]),
        (VAN_DER_POL, [0.3, 2.0], [0.1420965, 0.3055836], [], []),
    ],
    ids=["light", "position", "stiff", "strong", "van der Pol"],
)  # fmt: skip
def test_random_systems_within_their_stated_errors(system, q, of_q, p, of_p):
    """Drawn by benchmarks/random_systems.py and rounded; known to 1e-7 from 20 times finer runs."""
    for density, at, known in zip(
        solved(PhaseSpace(tol=1e-3), system, "q1", "p1"), (q, p), (of_q, of_p), strict=True
    ):
        assert density.certificate.certified, density.certificate.failures
        values, errors = density.at(np.array(at))
        assert np.all(np.abs(values - known) <= errors + 2e-7 * max(known, default=0.0))


def test_a_thin_ring_is_refused():
    """The noise of an oscillator of van der Pol makes a ring of the depth 1/D."""
    term = DampingTerm(1, 1, 0.1, q=((1, 2),))
    system = System([1.0], [1.0], [-0.1], [2e-4], damping_terms=(term,))
    assert "thin ring" in PhaseSpace().refusal(system, parse_observable("q1", 1))


@pytest.mark.parametrize("contacts", [(), both(20.0, mass=1), (Contact(1, "right", 1e5, 0.1),)])
def test_exact_densities_by_another_weight_than_their_own(contacts, monkeypatch):
    """Condition (8): u = exp(−∫ c/D dH). The weight that is u itself would hide the equation."""
    system, weight = by_energy([1.0, 0.5, 0.2], [0.3], contacts), oscillator.weighted

    def other(o, top):
        return o if o.fall else replace(o, fall=0.6 * weight(o, top).psi)

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
