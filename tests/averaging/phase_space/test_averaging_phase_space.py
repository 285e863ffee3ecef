"""The unreduced equation against exact densities, exact moments and identities."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import fpk
from averaging.gaussian import Linear
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import LEAF, expand, inverse_by_quarters
from averaging.phase_space.equation.frame import (
    Reference,
    contact_frame,
    gaussian_start,
    gibbs_reference,
)
from averaging.phase_space.marginals import marginal, moments
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.refinement import least_distance
from averaging.theory import Exact
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import gauss_grid, integral
from fpk.system.linear import stationary_covariance

FIG6 = {"mass": [1, 1], "stiffness": [1, 1], "damping": [0.08, 0.04]}
STOP = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)


def common(contacts, *, mass=(1.0, 1.0), turn=0.0):
    """Damping and noise in one proportion, T = ¼: the density is Gibbs's, Eq. (7).

    ``turn`` adds an antisymmetric part to the damping, which does no work.
    """
    n = len(mass)
    damping = 0.08 * np.eye(n) + turn * (np.eye(n, k=1) - np.eye(n, k=-1))
    return fpk.System(list(mass), [1.0] * n, damping, [0.02] * n, contacts=contacts)


def stop(mass=2, side="both", stiffness=10.0, clearance=0.5, **law):
    return (fpk.Contact(mass=mass, side=side, stiffness=stiffness, clearance=clearance, **law),)


GIBBS = {
    "two-sided": common(stop()),
    "one-sided": common(stop(side="right", clearance=0.2)),
    "left, first mass": common(stop(mass=1, side="left", clearance=0.3)),
    "unequal sides": common((*stop(side="right"), *stop(side="left", clearance=0.2))),
    "two stops on a side": common(stop(side="right") + stop(side="right", clearance=0.8)),
    "no clearance": common(stop(clearance=0.0)),
    "hardly any clearance": common(stop(clearance=1e-7)),
    "bilinear": common(stop(law="bilinear")),
    "cubic": common(stop(law="power", exponent=3.0)),
    "unequal masses": common(stop(), mass=(2.0, 0.5)),
    "gyroscopic": common(stop(), turn=0.05),
    "one mass": common(stop(mass=1), mass=(1.0,)),
    "three masses": common(stop(mass=2), mass=(1.0, 1.0, 1.0)),
}


def wrong(frame, factor):
    """The reference of a Gibbs state with a temperature that is off by ``factor``."""
    right = gibbs_reference(frame)
    return Reference(right.slope, right.offset, factor * right.covariance, right.weight / factor)


def true_error(expansion, exact):
    panels, pdf = marginal(expansion, exact.observable)
    mesh, grids = gauss_grid(panels)
    return integral(np.abs(pdf(*mesh) - exact(*mesh)), grids)


QUICK = [("one mass", 0.75, 1e-6), ("one mass", 1.3, 1e-4), ("two-sided", 0.75, 1e-3)]


@pytest.mark.parametrize(
    ("name", "factor", "tol"),
    [
        pytest.param(
            name,
            factor,
            tol,
            marks=[] if (name, factor, tol) in QUICK else pytest.mark.slow,
        )
        for name in GIBBS
        for factor, tol in ((0.75, 1e-3), (0.75, 1e-6), (1.3, 1e-4), (1.3, 1e-6))
    ],
)
def test_gibbs_is_found_within_the_stated_error_from_a_wrong_temperature(name, factor, tol):
    system = GIBBS[name]
    names = ["q1", "p1"] if system.n == 1 else ["q1", "q2", "p2"]
    observables = [parse_observable(o, system.n) for o in names]
    exact = Exact().solve(system, observables).densities
    method = PhaseSpace(tol=tol, reference=wrong(contact_frame(system), factor))
    for density, right in zip(method.solve(system, observables).densities, exact, strict=True):
        assert density.certificate.certified, density.certificate.failures
        assert l1_distance(density, right) <= density.l1_error + right.l1_error <= 2.0 * tol
        x = np.linspace(*density.panels[0][[0, -1]], 501)
        p, stated = density.at(x)
        assert np.all(np.abs(p - right(x)) <= stated + right.at(x)[1])


@pytest.mark.parametrize("factor", [0.77, pytest.param(1.3, marks=pytest.mark.slow)])
def test_the_expansion_converges_to_gibbs_about_a_wrong_temperature(factor):
    # Without a refit: e^(−(1/T − 1/T_ref) H) is no polynomial of any degree.
    system = GIBBS["two-sided"]
    frame = contact_frame(system)
    (exact,) = Exact().solve(system, [parse_observable("q2", 2)]).densities
    errors = [
        true_error(
            expand(frame, wrong(frame, factor), Degrees(N, 6, N + 4)),
            exact,
        )
        for N in (10, 14, 18, 22)
    ]
    assert all(b < a for a, b in pairwise(errors))
    assert errors[-1] < min(0.02 * errors[0], 5e-7)


def test_moments_of_a_linear_system_are_those_of_the_lyapunov_equation():
    # Unequal temperatures: probability circulates, and no Gibbs state is the answer.
    system = fpk.System(**FIG6, noise_intensity=[0.01, 0.02])
    frame = contact_frame(system)
    expansion = expand(frame, gibbs_reference(frame), Degrees(8, 6, 8))
    order = [*frame.order, *(2 + i for i in frame.order)]
    exact = stationary_covariance(system)[np.ix_(order, order)]
    assert moments(expansion)[1] == pytest.approx(exact, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize(
    "name",
    [
        "q2",
        "q1,q2",
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("q1", "p1", "p2", "p1,p2", "q2,p2", "q1,p2")
        ),
    ],
)
def test_densities_of_a_linear_system_are_gaussian(name):
    system = fpk.System(**FIG6, noise_intensity=[0.01, 0.02])
    observable = parse_observable(name, 2)
    (exact,) = Linear().solve(system, [observable]).densities
    (density,) = PhaseSpace(tol=1e-9).solve(system, [observable]).densities
    assert density.certificate.certified, density.certificate.failures
    assert l1_distance(density, exact) <= density.l1_error + exact.l1_error
    assert density.l1_error < 1e-9


def test_a_stop_without_clearance_that_is_a_spring_is_one():
    # Wojtkiewicz and Bergman (2000): K = [[2, −1], [−1, 2]], c = 0.4, D = 0.2.
    spring = stop(stiffness=1.0, clearance=0.0, law="bilinear")
    system = fpk.System([1, 1], [1, 1], [0.4, 0.4], [0.2, 0.2], contacts=spring)
    observables = [parse_observable("q1,q2", 2), parse_observable("q2", 2)]
    result = PhaseSpace(tol=1e-6).solve(system, observables)
    joint, single = result.densities
    assert result.settings["E q2²"] == pytest.approx(1.0 / 3.0, abs=1e-6)
    value, error = joint.at(np.zeros(1), np.zeros(1))
    # p(q, v) at rest is this times 1/(2π T) of the velocities, T = ½.
    assert value[0] / np.pi == pytest.approx(0.175493437951547, abs=error[0] + 1e-12)
    assert single.certificate.certified and joint.certificate.certified


@pytest.mark.parametrize("side", [pytest.param("both", marks=pytest.mark.slow), "right"])
def test_identities_hold_within_their_error(side):
    system = fpk.System(**FIG6, noise_intensity=[0.01, 0.02], contacts=stop(side=side))
    result = PhaseSpace(tol=1e-3).solve(system, [parse_observable("q2", 2)])
    assert len(result.identities) == 5
    for identity in result.identities:
        assert abs(identity.z) <= 1.0, identity
        assert identity.error < 2e-3
    heat = [v for k, v in result.settings.items() if k.startswith("net power")]
    # What one mass gives the other takes, but for what the balance of power is off by.
    power = result.identities[0]
    assert sum(heat) == pytest.approx(power.expected - power.value, abs=1e-15)
    assert abs(heat[0]) > 1e-3


def test_the_tolerances_of_a_vibro_impact_system_hold_against_a_finer_solution():
    system = fpk.System(**FIG6, noise_intensity=[0.01, 0.02], contacts=(STOP,))
    observables = [parse_observable(o, 2) for o in ("q2", "q1", "p2")]
    result = PhaseSpace(tol=5e-4).solve(system, observables)
    coarse = PhaseSpace(tol=3e-3).solve(system, observables).densities
    for a, b in zip(result.densities, coarse, strict=True):
        assert a.certificate.certified and b.certificate.certified
        assert l1_distance(a, b) <= a.l1_error + b.l1_error <= 3.5e-3
    # The same of another implementation, with other functions of q2: 0.184758.
    assert result.settings["E q2²"] == pytest.approx(0.184758, abs=2e-5)


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (common(stop(1) + stop(2)), "2 masses meet stops"),
        (common((), mass=(1.0,) * 4), "4 masses have 8 coordinates"),
        (fpk.System([1, 1], [1, 1], [0.1, 0.1], [0.0, 0.0]), "needs damping and noise"),
    ],
)
def test_what_the_expansion_does_not_hold_for_is_refused(system, words):
    with pytest.raises(NotApplicable, match=words):
        PhaseSpace().prepare(system)


def test_a_density_of_an_energy_is_refused():
    plan = PhaseSpace().prepare(GIBBS["two-sided"])
    assert "not of energies" in plan.refusal(parse_observable("H", 2))
    assert plan.refusal(parse_observable("q1,p2", 2)) is None


def test_errors_between_two_stops_on_a_side_fall_with_the_degrees():
    # The panel between them is narrow, but the density there is no polynomial of a fixed degree.
    system = GIBBS["two stops on a side"]
    frame, observable = contact_frame(system), parse_observable("q2", 2)
    (exact,) = Exact().solve(system, [observable]).densities
    errors = []
    for degrees in (Degrees(17, 6, 18), Degrees(25, 7, 22), Degrees(25, 7, 34)):
        e = expand(frame, wrong(frame, 1.3), degrees)
        panels, pdf = marginal(e, observable)
        mesh, grids = gauss_grid(list(map(np.union1d, panels, exact.panels)))
        errors.append(integral(np.abs(pdf(*mesh) - exact.pdf(*mesh)), grids))
    assert errors[1] < 0.2 * errors[0] and errors[2] < 0.5 * errors[1]


@pytest.mark.parametrize("name", GIBBS)
def test_the_start_is_gibbs_where_damping_and_noise_are_in_one_proportion(name):
    frame = contact_frame(GIBBS[name])
    found, right = gaussian_start(frame), gibbs_reference(frame)
    for a, b in zip(vars(found).values(), vars(right).values(), strict=True):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("side", [pytest.param("both", marks=pytest.mark.slow), "right"])
def test_the_start_has_about_the_variances_of_unlike_baths(side):
    stops = stop(side=side, stiffness=7.5, clearance=0.2)
    damping, noise = [0.119, 0.034], [0.010, 0.046]
    system = fpk.System([0.5, 1.7], [1.7, 1.2], damping, noise, contacts=stops)
    frame = contact_frame(system)
    (density,) = PhaseSpace(tol=2e-2).solve(system, [parse_observable("p2", 2)]).densities
    mesh, grids = gauss_grid(density.panels)
    right = integral(mesh[0] ** 2 * density.pdf(*mesh), grids) / system.mass[1]
    # A linear force for that of the stop: within a third, where Gibbs is off by a factor.
    assert gaussian_start(frame).covariance[0, 0] == pytest.approx(right, rel=0.33)
    assert gibbs_reference(frame).covariance[0, 0] < 0.5 * right


def test_a_motion_that_noise_drives_and_nothing_damps_has_no_start():
    # The damping is of one mode of the springs alone.
    _, modes = np.linalg.eigh([[2.0, -1.0], [-1.0, 1.0]])
    damping = 0.1 * np.outer(modes[:, 1], modes[:, 1])
    frame = contact_frame(fpk.System([1, 1], [1, 1], damping, [0.1, 0.1]))
    with pytest.raises(np.linalg.LinAlgError, match="no stationary state"):
        gaussian_start(frame)


def test_a_variance_that_is_not_positive_is_no_answer():
    # As where an expansion diverges: E v² of the contact mass is S₁₁ (1 + √2 ∫ u₂).
    frame = contact_frame(GIBBS["two-sided"])
    right = expand(frame, gibbs_reference(frame), Degrees(8, 3, 8))
    levels = list(right.levels)
    levels[2] = levels[2].copy()
    levels[2][0] = -2.0 * right.levels[0][0, : levels[2].shape[1]]
    wrong_sign = replace(right, levels=tuple(levels))
    for pair in ((right, wrong_sign), (wrong_sign, right)):
        with pytest.raises(np.linalg.LinAlgError, match="variance"):
            least_distance(*pair)


def test_a_tolerance_out_of_reach_gives_the_best_answer_that_work_allows():
    system = fpk.System(**FIG6, noise_intensity=[0.01, 0.02], contacts=(STOP,))
    (one,), (other,) = (
        PhaseSpace(tol=tol, work=1e11).solve(system, [parse_observable("q2", 2)]).densities
        for tol in (1e-5, 1e-9)
    )
    for density, tol in ((one, "1e-05"), (other, "1e-09")):
        limit, missed = density.certificate.failures
        assert "operations, at most 1e+11" in limit and missed.endswith(f"tolerance {tol}")
    assert one.l1_error == other.l1_error < 1e-4


@pytest.mark.parametrize("size", [1, LEAF, LEAF + 1, 4 * LEAF + 3])
def test_the_inverse_by_quarters_is_the_inverse(size):
    rng = np.random.default_rng(20261123)
    A = rng.normal(size=(size, size)) / np.sqrt(size) - 3.0 * np.eye(size)
    assert inverse_by_quarters(A, range(0, size, 7)) @ A == pytest.approx(np.eye(size), abs=1e-12)


def drawn(rng, *, coldest=0.3):
    """Two masses of random size, damping and noise with a stop on one of them.

    Noise is 0.2 to 0.6 times the damping, and for each mass down to ``coldest`` times that.
    """
    contact = fpk.Contact(
        mass=int(rng.integers(1, 3)),
        side=str(rng.choice(["both", "left", "right"])),
        stiffness=float(10.0 ** rng.uniform(-1.0, 1.5)),
        clearance=float(rng.uniform(0.1, 0.6)),
        law=str(rng.choice(["hertz", "bilinear"])),
    )
    damping = rng.uniform(0.03, 0.2, 2)
    noise = rng.uniform(coldest, 1.0, 2) * damping * rng.uniform(0.2, 0.6)
    mass, stiffness = rng.uniform(0.5, 2.0, (2, 2))
    return fpk.System(mass, stiffness, damping, noise, contacts=(contact,)), contact
