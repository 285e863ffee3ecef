"""The unreduced equation with damping terms, against exact densities, identities and simulation."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from test_averaging_phase_space_errors import solutions, understated

import fpk
from averaging.nonintegrable import NonIntegrable
from averaging.phase_space.densities import force_means
from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.chain import chain_of, damping_degree, levels_per_stage
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import expand
from averaging.phase_space.equation.frame import contact_frame, gibbs_reference, make_reference
from averaging.phase_space.method import PhaseSpace
from averaging.theory import Exact
from fpk.answer.density import l1_distance
from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.damping import gaussian_moment

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
        1e-2,
    ),
    "idle, by an odd power": (
        by_energy([3.0], [0.02, 0.02], terms=idle((1, 2, 0.1, ((1, 1),), 0))),
        1e-2,
    ),
    "idle, by the contact mass": (
        by_energy(
            [3.0], [0.02] * 2, stop(1), mass=(2.0, 0.5), terms=idle((2, 1, 0.1, ((1, 2),), 0))
        ),
        1e-3,
    ),
}


def wrong(system, factor):
    """The reference of a Gibbs state with a temperature that is off by ``factor``."""
    frame = contact_frame(system)
    right = gibbs_reference(frame)
    return make_reference(frame, right.slope, right.offset, factor * right.covariance)


def assert_within_stated_error(system, tol, *, factor):
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


@pytest.mark.parametrize(
    ("tol", "factor"), [(1e-2, 0.8), pytest.param(1.5e-3, 1.25, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", ONE_MASS)
def test_one_mass_damped_by_its_energy_is_found_within_the_stated_error(name, tol, factor):
    assert_within_stated_error(ONE_MASS[name], tol, factor=factor)


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=[pytest.mark.slow] * ("contact" not in x)) for x in TWO_MASSES],
)
def test_two_masses_are_found_within_the_stated_error(name):
    assert_within_stated_error(*TWO_MASSES[name], factor=1.2)


@pytest.mark.parametrize("contacts", [pytest.param((), marks=pytest.mark.slow), stop(1)])
def test_averaging_of_one_mass_errs_by_the_square_of_the_damping(contacts):
    """Damping by q²: the energy process (24) is the limit of light damping; half of it, a quarter.

    Of light damping: what is of fourth order is some hundredths, and the stated errors add.
    """
    observable, distances = [parse_observable("q1", 1)], []
    for share in (0.4, 0.2):
        term = Term(1, 1, share, q=((1, 2),))
        system = fpk.System(
            [1.0], [1.0], [0.1 * share], [0.2 * share], contacts=contacts, damping_terms=(term,)
        )
        (full,) = PhaseSpace(tol=1e-3).solve(system, observable).densities
        assert full.certificate.certified
        (averaged,) = NonIntegrable().solve(system, observable).densities
        distances.append((l1_distance(averaged, full), full.l1_error))
    (first, first_error), (second, second_error) = distances
    assert first / second == pytest.approx(
        4.0, rel=0.1 + first_error / first + second_error / second
    )


def test_means_of_forces_are_gaussian_moments_in_a_gaussian_state():
    # No noise at all levels but 0: the expansion is its reference, q = y and x Gaussian.
    terms = (
        Term(1, 2, 0.3, q=((1, 2), (2, 1)), v=((2, 1),)),
        Term(2, 2, 0.2, v=((1, 2),), energy=1),
        Term(2, 1, -0.4, q=((2, 2),)),
    )
    constant = fpk.System([2.0, 0.5], [1.0, 2.0], [0.1, 0.2], [0.04, 0.08])
    system = replace(constant, damping_terms=terms)
    frame = contact_frame(constant)
    T = 0.4  # D_i/c_i
    e = expand(frame, gibbs_reference(frame), Degrees(10, 8, 10))
    damped = replace(e, basis=replace(e.basis, frame=contact_frame(system)))
    mean_power, mean_virial, _ = force_means(damped)
    C = np.linalg.inv(constant.stiffness_matrix) * T
    V = np.diag(T / constant.mass)
    energy = 2.0 * T  # E H of two masses
    power = np.zeros(2)
    power[0] = 0.3 * gaussian_moment(C, (2, 1)) * gaussian_moment(V, (1, 2))
    # E H^1 X over E X for X of degree 4 is 2 T + 2 T.
    power[1] = 0.2 * gaussian_moment(V, (2, 2)) * (energy + 2.0 * T)
    power[1] -= 0.4 * gaussian_moment(C, (0, 2)) * gaussian_moment(V, (1, 1))
    assert mean_power == pytest.approx(power[list(frame.order)], rel=1e-10, abs=1e-12)
    # Odd in the velocities, but for v_2 v_2 of the first.
    virial = np.array([0.3 * gaussian_moment(C, (3, 1)) * V[1, 1], 0.0])
    assert mean_virial == pytest.approx(virial[list(frame.order)], rel=1e-10, abs=1e-12)


@pytest.mark.parametrize(
    ("powers", "apart", "stages"),
    [
        ({"q": ((1, 2),)}, 0, 1),
        ({"q": ((2, 1),)}, 1, 2),
        ({"v": ((1, 2),)}, 2, 2),
        ({"q": ((1, 2), (2, 1)), "energy": 1}, 3, 3),
    ],
)
def test_stages_are_as_wide_as_the_terms_of_other_coordinates_need(powers, apart, stages):
    constant = fpk.System([1, 1], [1, 1], [0.1, 0.1], [0.1, 0.1], contacts=stop(1))
    frame = contact_frame(replace(constant, damping_terms=(Term(1, 1, 0.1, **powers),)))
    assert damping_degree(frame) == apart
    assert levels_per_stage(frame) == stages
    b = basis(frame, gibbs_reference(frame), Degrees(7, 3, 8))
    chain = chain_of(b)
    held = [
        set(chain.space.level[(chain.places[:, 0] >= s.start) & (chain.places[:, 0] < s.stop)])
        for s in map(chain.span, range(chain.top + 1))
    ]
    assert held[0] == {0} and held[1] == set(range(1, stages + 1))
    assert sorted(n for levels in held for n in levels) == list(range(8))


def test_sums_over_the_spectrum_of_one_mass_damped_by_its_energy_are_exact():
    # As with constant damping: ∫ S dω is the variance of q, ∫ ω² S dω that of the velocity.
    system, count = ONE_MASS["one-sided"], 160
    w = np.tan((np.arange(count) + 0.5) * 0.5 * np.pi / count)
    answer = PhaseSpace().spectrum(system, (Coordinate("q", 0),), w, tol=1e-2, progress=silent)
    assert answer.certificate.certified
    weight = np.pi / count * (1.0 + w**2)
    observables = [parse_observable(o, 1) for o in ("q1", "p1")]
    q, p = Exact().solve(system, observables).densities
    for power, variance in (
        (0, q.moment(2).value - q.moment(1).value ** 2),
        (2, p.moment(2).value),
    ):
        error = weight @ (w**power * answer.errors)
        assert weight @ (w**power * answer.values) == pytest.approx(variance, abs=error)


def test_crossings_of_one_mass_damped_by_its_energy_are_exact():
    system, a = ONE_MASS["two-sided"], np.linspace(-0.8, 0.8, 5)
    exact = Exact().crossings(system, (Coordinate("q", 0),), a, tol=None, progress=silent)
    answer = PhaseSpace().crossings(system, (Coordinate("q", 0),), a, tol=1e-3, progress=silent)
    assert answer.certificate.certified
    assert np.all(np.abs(answer.values - exact.values) <= answer.errors + exact.errors)


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
    with pytest.raises(NotApplicable, match=words):
        PhaseSpace(work=1e11).prepare(system)


def drawn(rng, n):
    """``n`` masses with one to three damping terms; some feed energy in at small displacements."""
    contacts = ()
    if rng.random() < 0.7:
        side = str(rng.choice(["both", "right"])) if n == 1 else "both"
        clearance = float(rng.uniform(0.1, 0.6))
        contacts = stop(int(rng.integers(1, n + 1)), side, clearance)
    damping = rng.uniform(0.03, 0.2, n)
    noise = rng.uniform(0.3, 1.0, n) * damping * rng.uniform(0.2, 0.6)
    terms = []
    for _ in range(rng.integers(1, 4)):
        i, j, a, b = (int(k) for k in rng.integers(1, n + 1, 4))
        c = float(rng.uniform(0.02, 0.3))
        kind = rng.integers(0, 5)
        if kind == 0:
            terms.append(Term(i, i, c, v=((a, 2),)))
        elif kind == 1:
            terms.append(Term(i, i, 0.5 * c, energy=1))
        elif kind == 2:
            terms.append(Term(i, j, 0.2 * c, q=((a, 1),), v=((b, 1),)))
            terms.append(Term(i, i, c, q=((a, 2),)))
        else:
            terms.append(Term(i, i, c, q=((a, 2),)))
            damping[i - 1] *= float(rng.choice([1.0, -0.3]))
    mass, stiffness = rng.uniform(0.5, 2.0, (2, n))
    return fpk.System(
        mass, stiffness, damping, noise, contacts=contacts, damping_terms=tuple(terms)
    )


@pytest.mark.slow
def test_errors_of_random_systems_are_within_the_stated_ones_of_a_finer_solution():
    seen = 0
    for n, systems, most, work in ((1, 16, 6, 1e11), (2, 4, 3, 2e11)):
        observables = [parse_observable(f"{c}{i + 1}", n) for c in "qp" for i in range(n)]
        for seed in range(systems):
            system = drawn(np.random.default_rng([20261126, n, seed]), n)
            found = solutions(system, work, observables=observables, threads=1)
            *coarser, finest = islice(found, most)
            seen += len(coarser) * len(observables)
            assert not understated(coarser, finest), (n, seed)
    assert seen > 100
