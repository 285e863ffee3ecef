"""The unreduced equation with damping terms, against exact densities and identities."""

from dataclasses import replace

import numpy as np
import pytest
from asked import ask, assert_near, assert_refused
from systems import by_energy
from test_averaging_phase_space import assert_exact_from, stop, wrong
from test_averaging_phase_space_dynamics import assert_sums

import fpk
from averaging.nonintegrable import NonIntegrable
from averaging.phase_space.method import PhaseSpace
from averaging.theory import Exact
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable

Term = fpk.DampingTerm


def idle(i, j, c, q):
    """Terms with c_ij = −c_ji, which do no work."""
    return Term(i, j, c, q=q), Term(j, i, -c, q=q)


KNOWN = {
    "two-sided": by_energy([2.0, 4.0], [0.02], stop(1), mass=(2.0,)),
    "one-sided": by_energy([2.0, 4.0], [0.02], stop(1, "right", clearance=0.2)),
    "limit cycle": by_energy([-1.0, 6.0], [0.02], stop(1)),
    "square of the energy": by_energy([2.0, 0.0, 4.0], [0.02], stop(1, "left", clearance=0.2)),
    "idle, by the contact mass": by_energy(
        [3.0], [0.02] * 2, stop(1), mass=(2.0, 0.5), terms=idle(2, 1, 0.1, ((1, 2),))
    ),
    "two masses": by_energy([2.0, 0.5], [0.02, 0.03]),
    "idle, by an odd power": by_energy([3.0], [0.02, 0.02], terms=idle(1, 2, 0.1, ((1, 1),))),
}
TOL = {"idle, by the contact mass": 1e-3}


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=[pytest.mark.slow] * (i > 4)) for i, k in enumerate(KNOWN)]
)
def test_the_exact_density_is_found_within_the_stated_error(name):
    system = KNOWN[name]
    # What does no work does not change the density.
    works = tuple(t for t in system.damping_terms if t.i == t.j)
    exact = replace(system, damping_terms=works)
    about = wrong(system, 1.2 if system.n > 1 else 0.8)
    assert_exact_from(about, system, TOL.get(name, 1e-2), like=exact, most=1.1)


def test_the_power_and_the_virial_of_a_force_are_in_balance():
    # q f = 0.3 q² v² and more: its mean is not 0.
    squares = Term(1, 1, 0.3, q=((1, 2),)), Term(1, 1, 0.3, v=((1, 2),))
    terms = (Term(1, 1, 0.3, q=((1, 1),), v=((1, 1),)), *squares)
    system = fpk.System([1.0], [1.0], [0.1], [0.05], damping_terms=terms)
    result = PhaseSpace(tol=1e-2).solve(system, [parse_observable("q1", 1)])
    assert all(abs(identity.z) <= 1.0 for identity in result.identities)


def test_averaging_of_one_mass_errs_by_the_square_of_the_damping():
    """Damping by q²: the energy process (24) is the limit of light damping; half of it, a quarter.

    Of light damping: what is of fourth order is some hundredths, and the stated errors add.
    """
    observable, distances = [parse_observable("q1", 1)], []
    for share in (0.4, 0.2):
        term = Term(1, 1, share, q=((1, 2),))
        system = fpk.System(
            [1.0], [1.0], [0.1 * share], [0.2 * share], contacts=stop(1), damping_terms=(term,)
        )
        (full,) = PhaseSpace(tol=1e-3).solve(system, observable).densities
        assert full.certificate.certified
        (averaged,) = NonIntegrable().solve(system, observable).densities
        distances.append((l1_distance(averaged, full), full.l1_error))
    (first, first_error), (second, second_error) = distances
    assert first / second == pytest.approx(
        4.0, rel=0.1 + first_error / first + second_error / second
    )


def test_sums_over_the_spectrum_and_crossings_are_exact():
    system = KNOWN["one-sided"]
    assert_sums(system, 1e-2)
    a = np.linspace(-0.8, 0.8, 5)
    exact = ask(Exact(), "crossings", system, 0, a)
    assert_near(ask(PhaseSpace(), "crossings", system, 0, a, tol=1e-3), exact)


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (by_energy([0.1, -1.0], [0.02]), "the energy grows for ever"),
        (
            by_energy([1.0, 0.0, 0.0, 0.0, 1.0], [0.02] * 3, stop(2, "right")),
            "too high a degree: a finer solution needs",
        ),
    ],
)
def test_terms_that_cannot_be_solved_are_refused(system, words):
    assert_refused(NotApplicable, words, PhaseSpace(work=1e11).prepare, system)
