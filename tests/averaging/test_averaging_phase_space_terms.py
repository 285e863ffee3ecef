"""The unreduced equation with damping terms, against exact densities, identities and simulation."""

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest

import fpk
from averaging.exact import Exact
from averaging.nonintegrable import NonIntegrable
from averaging.phase_space import refinement
from averaging.phase_space.damping import reach, stages_to
from averaging.phase_space.degrees import Degrees
from averaging.phase_space.elimination import expanded
from averaging.phase_space.frame import contact_frame, gibbs_reference, reference_of
from averaging.phase_space.identities import force_means
from averaging.phase_space.marginals import marginal
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import ladders
from cases.comparison.compare import compared
from fpk.density import gauss_grid, integral, l1_distance
from fpk.errors import NotApplicable
from fpk.method import silent
from fpk.moments import gaussian_moment
from fpk.observable import parse_observable
from sim.montecarlo import MonteCarlo

Term = fpk.DampingTerm


def stop(mass, side="both", clearance=0.5):
    return (fpk.Contact(mass=mass, side=side, stiffness=10.0, clearance=clearance),)


def by_energy(rate, noise, contacts=(), *, mass=(1.0, 1.0, 1.0), terms=()):
    """c_i = D_i Σ rate_e H^e: the density is exp(−∫ Σ rate_e H^e dH), Eqs. (7), (8)."""
    n, (constant, *others) = len(noise), rate
    by_h = [
        Term(i + 1, i + 1, c * D, energy=e)
        for e, c in enumerate(others, start=1)
        for i, D in enumerate(noise)
    ]
    damping = [constant * D for D in noise]
    return fpk.System(
        mass[:n], [1.0] * n, damping, noise, contacts=contacts, damping_terms=(*by_h, *terms)
    )


def idle(*places):
    """Terms with c_ij = −c_ji, which do no work: (i, j, coefficient, powers of q, energy)."""
    return tuple(
        Term(a, b, sign * c, q=q, energy=e)
        for i, j, c, q, e in places
        for a, b, sign in ((i, j, 1.0), (j, i, -1.0))
    )


ONE_MASS = {
    "without stops": by_energy([2.0, 4.0], [0.02]),
    "two-sided": by_energy([2.0, 4.0], [0.02], stop(1), mass=(2.0,)),
    "one-sided": by_energy([2.0, 4.0], [0.02], stop(1, "right", 0.2)),
    "limit cycle": by_energy([-1.0, 6.0], [0.02], stop(1)),
    "square of the energy": by_energy([2.0, 0.0, 4.0], [0.02], stop(1, "left", 0.2)),
}
TWO_MASSES = {
    "by energy": (by_energy([2.0, 0.5], [0.02, 0.03]), 1e-2),
    "idle, mirrored": (
        by_energy([3.0], [0.02, 0.03], stop(2), terms=idle((1, 2, 0.1, ((1, 2),), 0))),
        1e-3,
    ),
    "idle, by an odd power": (
        by_energy([3.0], [0.02, 0.02], stop(1), terms=idle((1, 2, 0.1, ((1, 1),), 0))),
        1e-2,
    ),
    "idle, by the contact mass": (
        by_energy([3.0], [0.02, 0.02], stop(1), mass=(2.0, 0.5), terms=idle((2, 1, 0.1, ((1, 2),), 0))),
        1e-4,
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def one_thread(monkeypatch):
    """Tests run side by side, one on each core."""
    monkeypatch.setattr(refinement, "usable_cores", lambda: 1)


def wrong(system, factor):
    """The reference of a Gibbs state with a temperature that is off by ``factor``."""
    frame = contact_frame(system)
    right = gibbs_reference(frame)
    return reference_of(frame, right.slope, right.offset, factor * right.covariance)


def holds(system, tol, *, factor):
    """Solve to ``tol`` and compare with the exact densities."""
    observables = [parse_observable(f"{c}{i + 1}", system.n) for c in "qp" for i in range(system.n)]
    # What does no work does not change the density.
    works = tuple(t for t in system.damping_terms if t.i == t.j)
    exact = Exact().solve(replace(system, damping_terms=works), observables).densities
    result = PhaseSpace(tol=tol, reference=wrong(system, factor)).solve(system, observables)
    for density, right in zip(result.densities, exact, strict=True):
        assert density.certificate.certified, density.certificate.failures
        assert l1_distance(density, right) <= density.l1_error + right.l1_error <= 1.1 * tol
        x = np.linspace(*density.panels[0][[0, -1]], 501)
        p, stated = density.at(x)
        assert np.all(np.abs(p - right(x)) <= stated + right.at(x)[1])
    assert all(abs(identity.z) <= 1.0 for identity in result.identities)
    heat = [v for k, v in result.settings.items() if k.startswith("net power")]
    power = result.identities[0]
    assert sum(heat) == pytest.approx(power.expected - power.value, abs=1e-14)


@pytest.mark.parametrize(("tol", "factor"), [(1e-2, 0.8), (1e-3, 1.25)])
@pytest.mark.parametrize("name", ONE_MASS)
def test_one_mass_damped_by_its_energy_is_found_within_the_stated_error(name, tol, factor):
    holds(ONE_MASS[name], tol, factor=factor)


@pytest.mark.parametrize("name", TWO_MASSES)
def test_two_masses_are_found_within_the_stated_error(name):
    holds(*TWO_MASSES[name], factor=1.2)
