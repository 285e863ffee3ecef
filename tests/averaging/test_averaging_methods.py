"""Exact, Gaussian and averaged densities against each other and against direct integrals."""

from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np
import pytest
from averaging_systems import TWO_MASSES, both, exact_system, fig6, integral
from scipy.integrate import quad
from scipy.linalg import eigvalsh
from scipy.special import gamma as gamma_function

from averaging.energy_process import closed_form_density, compatibility, energy_process
from averaging.gaussian import Linear
from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from averaging.weyl import WeylIntegrals, weyl_table, weyl_tail
from cases.scene.scene import load_scene
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import stationary_covariance
from fpk.system.system import System

SOLVERS = ("fem", "quadrature", "closed-form")
ALL = ("q1", "q2", "p1", "p2", "H", "q2,p2")


def solved(method, system, *names):
    observables = [parse_observable(name, system.n) for name in names]
    return method.solve(system, observables).densities


FULL_D = np.array([[0.05, 0.02], [0.02, 0.08]])
GYRO = np.array([[0.0, 0.3], [-0.3, 0.0]])


@pytest.mark.parametrize(
    "damping, noise, h",
    [
        ([0.2, 0.4], [0.1, 0.2], 2.0),
        (3.0 * FULL_D, FULL_D, 3.0),
        (3.0 * FULL_D + GYRO, FULL_D, 3.0),
    ],
)
def test_condition_8_is_accepted(damping, noise, h):
    system = System([1.0, 2.0], [1.0, 1.0], damping, noise)
    assert compatibility(system) == pytest.approx([h], rel=1e-14)
    # For a linear system (7) can be checked: its covariance is that of exp(−h H).
    covariance = stationary_covariance(system)
    np.testing.assert_allclose(
        covariance[:2, :2], np.linalg.inv(system.stiffness_matrix) / h, rtol=1e-9
    )


@pytest.mark.parametrize(
    "damping, noise",
    [
        ([0.2, 0.41], [0.1, 0.2]),
        ([0.2, 0.4 * (1.0 + 1e-9)], [0.1, 0.2]),
        (3.0 * np.diag(np.diag(FULL_D)), FULL_D),
        (3.0 * FULL_D, np.diag(np.diag(FULL_D))),
        ([0.2, 0.0], [0.1, 0.2]),
        ([0.0, 0.0], [0.1, 0.2]),
        ([0.2, 0.4], [0.0, 0.0]),
    ],
)
def test_condition_8_is_refused(damping, noise):
    system = System([1.0, 2.0], [1.0, 1.0], damping, noise)
    with pytest.raises(NotApplicable, match=r"\(8\)"):
        compatibility(system)
    assert Exact().refusal(system, parse_observable("q1", 2)) is not None
    with pytest.raises(NotApplicable):
        solved(Exact(), system, "q1")


CONTACTS = {
    "none": (),
    "both": both(10.0),
    "right": (Contact(2, "right", 10.0, 0.5),),
    "stiff": both(1e4),
    "zero clearance": both(10.0, 0.0),
    "mass 1": both(10.0, mass=0),
}


def tiered(combinations, default):
    """All of the combinations, those that are not in ``default`` marked slow."""
    return [
        pytest.param(*c, marks=() if c in default else pytest.mark.slow, id="-".join(c))
        for c in combinations
    ]


@cache
def exact_densities(contact, names):
    return solved(Exact(), exact_system(CONTACTS[contact]), *names)


def assert_exact(contact, solver, names):
    averaged = solved(
        NonIntegrable(solver=solver, tol=1e-11), exact_system(CONTACTS[contact]), *names
    )
    for one, two in zip(averaged, exact_densities(contact, names), strict=True):
        distance = l1_distance(one, two)
        assert distance < 1e-10, one.name
        assert distance <= one.l1_error + two.l1_error + 1e-12, one.name


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("solver", SOLVERS)
def test_averaging_is_exact_where_damping_and_noise_are_in_proportion(contact, solver):
    i = 1 if contact == "mass 1" else 2
    # The joint density with a contact mass integrated out takes a minute and is left out.
    assert_exact(contact, solver, (f"q{i}", "H", f"q{i},p{i}"))


@pytest.mark.parametrize(
    "contact, solver",
    tiered(
        [(c, s) for c in CONTACTS for s in SOLVERS],
        [("both", "fem"), ("right", "quadrature"), ("mass 1", "closed-form")],
    ),
)
def test_densities_with_a_contact_mass_integrated_out_are_exact_as_well(contact, solver):
    assert_exact(contact, solver, ("q2" if contact == "mass 1" else "q1", "p1", "p2"))


@pytest.mark.slow
def test_averaging_is_exact_with_two_contact_masses():
    system = exact_system(TWO_MASSES)
    averaged = solved(NonIntegrable(), system, "q1", "q2", "H")
    for one, two in zip(averaged, solved(Exact(), system, "q1", "q2", "H"), strict=True):
        assert l1_distance(one, two) < 1e-10


def test_averaging_is_not_exact_otherwise():
    # Fig. 6: c/D = 8 and 2. Without contact the exact density is the Gaussian one.
    system = fig6()
    names = ("q1", "q2", "p1", "H")
    averaged = solved(NonIntegrable(), system, *names)
    for one, two in zip(averaged, solved(Linear(), system, *names), strict=True):
        assert l1_distance(one, two) > 1e-3


@pytest.mark.parametrize("contact", CONTACTS)
def test_exact_density_of_the_contact_displacement_against_scipy(contact):
    system = exact_system(CONTACTS[contact])
    i = 0 if contact == "mass 1" else 1
    k = 1.0 / np.sum(1.0 / system.stiffness[: i + 1])

    def weight(q):
        return np.exp(-2.0 * (0.5 * k * q * q + float(system.contact_energy(i, q))))

    cuts = [-8.0, -0.5, 0.0, 0.5, 8.0]
    norm = sum(
        quad(weight, a, b, epsabs=1e-15, epsrel=1e-12, limit=200)[0] for a, b in pairwise(cuts)
    )
    (density,) = solved(Exact(), system, f"q{i + 1}")
    q = np.linspace(-1.2, 1.2, 49)
    expected = np.array([weight(x) for x in q]) / norm
    keep = (q > density.panels[0][0]) & (q < density.panels[0][-1])
    assert keep.sum() > 20
    np.testing.assert_allclose(density.at(q)[0][keep], expected[keep], rtol=1e-11)
    if contact == "both":
        (other,) = solved(Exact(), exact_system(both(10.0, 0.55)), "q2")
        assert l1_distance(density, other) > 1e-2


def test_without_contact_three_theories_agree():
    system = exact_system()
    sets = [solved(m, system, *ALL) for m in (Exact(), Linear(), NonIntegrable(tol=1e-11))]
    for exact, linear, averaged in zip(*sets, strict=True):
        assert l1_distance(exact, linear) < 1e-10, exact.name
        assert l1_distance(averaged, linear) < 1e-10, exact.name


@pytest.mark.parametrize("system", [fig6(), fig6(mass=(0.5, 3.0)), exact_system()])
def test_gaussian_density_of_the_energy(system):
    # H = ½ xᵀ G x: mean ½ tr(G Σ), variance ½ tr((G Σ)²).
    (density,) = solved(Linear(), system, "H")
    G = np.zeros((4, 4))
    G[:2, :2], G[2:, 2:] = system.stiffness_matrix, np.diag(1.0 / system.mass)
    GS = G @ stationary_covariance(system)
    mean, variance = 0.5 * np.trace(GS), 0.5 * np.trace(GS @ GS)
    assert density.moment(0).value == pytest.approx(1.0, abs=1e-12)
    assert density.moment(1).value == pytest.approx(mean, rel=1e-11)
    assert density.moment(2).value == pytest.approx(variance + mean**2, rel=1e-11)
    assert eigvalsh(system.stiffness_matrix)[0] > 0


def test_a_pair_in_one_proportion_has_no_joint_density():
    """Noise on one mode alone: q1 = 0.618 q2 at all times."""
    system = load_scene("silent-mode").system
    with pytest.raises(NotApplicable, match="no joint density"):
        Linear().solve(system, [parse_observable("q1,q2", 2)])
    assert Linear().refusal(system, parse_observable("q1,p1", 2)) is None


def test_gaussian_moments_are_those_of_the_covariance():
    system = fig6(mass=(0.5, 3.0))
    S = stationary_covariance(system)
    rows = {"q1": 0, "q2": 1, "p1": 2, "p2": 3}
    for name, i in rows.items():
        (density,) = solved(Linear(), system, name)
        assert density.moment(2).value == pytest.approx(S[i, i], rel=1e-12)
    for one, two in (("q1", "q2"), ("q1", "p2"), ("p1", "p2")):
        (density,) = solved(Linear(), system, f"{one},{two}")
        size = np.sqrt(S[rows[one], rows[one]] * S[rows[two], rows[two]])
        assert density.moment(1, 1).value == pytest.approx(
            S[rows[one], rows[two]], abs=1e-12 * size
        )


BACK = {
    "both": fig6(both(10.0)),
    "right, masses": fig6((Contact(2, "right", 10.0, 0.5),), mass=(0.5, 3.0)),
    "stiff": fig6(both(1e4)),
    "three masses": System(
        [1.0, 0.5, 2.0], [1.0, 2.0, 1.0], [0.1] * 3, [0.02] * 3, contacts=both(10.0)
    ),
    "one mass": System([2.0], [1.0], [0.1], [0.05], contacts=both(10.0, mass=0)),
}


@pytest.mark.parametrize(
    "name, solver",
    tiered(
        [(n, s) for n in BACK for s in SOLVERS],
        [("right, masses", "fem"), ("one mass", "quadrature")]
        + [(name, "closed-form") for name in BACK],
    ),
)
def test_kinetic_energy_is_shared_equally(name, solver):
    # E p_i²/m_i = E τ(H) for every i, with τ from the coefficients: σ² = 2 Σ(D_i/m_i) τ.
    system = BACK[name]
    process = energy_process(system)
    names = [f"p{i + 1}" for i in range(system.n)]
    *momenta, energy = solved(NonIntegrable(solver=solver), system, *names, "H")
    noise = np.sum(np.diag(system.noise_matrix) / system.mass)
    nodes = energy.panels[0]
    nodes = np.union1d(nodes, nodes[1] * 0.15 ** np.arange(1.0, 13.0))
    tau = integral(
        lambda H: energy.pdf(H) * (process.coefficients(H.ravel()).diffusion).reshape(H.shape),
        nodes,
    ) / (2.0 * noise)
    for density, m in zip(momenta, system.mass, strict=True):
        assert density.moment(0).value == pytest.approx(1.0, abs=1e-9)
        # An L1 error of 1e-10 with weights up to the last energy, some 10 mean energies.
        assert density.moment(2).value / m == pytest.approx(tau, rel=2e-9)
        assert density.moment(1).value == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", BACK)
@pytest.mark.parametrize("solver", ["fem", "closed-form"])
def test_joint_densities_have_their_marginals(name, solver):
    system = BACK[name]
    i = system.contact_masses[0] + 1
    joint, single = solved(NonIntegrable(solver=solver), system, f"q{i},p{i}", f"q{i}")
    assert single.moment(0).value == pytest.approx(1.0, abs=1e-9)
    low, high = single.panels[0][[0, -1]]
    for q in np.linspace(0.4 * low, 0.4 * high, 5):
        marginal = integral(lambda p, q=q: joint.pdf(np.full_like(p, q), p), joint.panels[1])
        expected = single.pdf(np.array([q]))[0]
        # At the far ends the density has fallen to where the L1 tolerance 1e-10 is a lot.
        assert marginal == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_displacements_without_contact_are_integrated_out():
    system = BACK["both"]
    joint, q1, q2 = solved(NonIntegrable(solver="closed-form"), system, "q1,q2", "q1", "q2")
    for q in (-0.6, 0.0, 0.35):
        over_q2 = integral(lambda y, q=q: joint.pdf(np.full_like(y, q), y), joint.panels[1])
        over_q1 = integral(lambda x, q=q: joint.pdf(x, np.full_like(x, q)), joint.panels[0])
        assert over_q2 == pytest.approx(q1.pdf(np.array([q]))[0], rel=1e-9)
        assert over_q1 == pytest.approx(q2.pdf(np.array([q]))[0], rel=1e-9)


@pytest.mark.parametrize("name", BACK)
def test_a_mirrored_system_has_a_mirrored_density(name):
    system = BACK[name]
    turned = System(
        system.mass,
        system.stiffness,
        system.damping,
        system.noise_intensity,
        contacts=tuple(
            Contact(
                c.mass,
                {"right": "left", "left": "right"}.get(c.side, c.side),
                c.stiffness,
                c.clearance,
            )
            for c in system.contacts
        ),
    )
    i = system.contact_masses[0] + 1
    q = np.linspace(-0.9, 0.9, 37)
    one, two = (solved(NonIntegrable(), s, f"q{i}")[0] for s in (system, turned))
    np.testing.assert_allclose(one.pdf(q), two.pdf(-q), rtol=0, atol=1e-9)
    skew = np.abs(one.pdf(q) - one.pdf(-q)).max()
    assert bool(skew < 1e-9) is (name != "right, masses")


@pytest.mark.parametrize("order", [0.0, 0.5, 1.0, 1.5, 2.5])
def test_weyl_integrals_of_an_exponential(order):
    # ∫_0^∞ e^(−a(E + x)) x^(ν−1) dx/Γ(ν) = a^(−ν) e^(−aE); the table continues u beyond its end.
    a = 4.0
    nodes = np.unique(np.concatenate([np.linspace(0.0, 6.0, 13), [0.0625, 0.07, 0.1]]))
    table = weyl_table(order, nodes, lambda H: np.exp(-a * H))
    energy = np.concatenate([np.linspace(0.0, 5.99, 301), [0.0625]])
    np.testing.assert_allclose(np.exp(table(energy)), a**-order * np.exp(-a * energy), rtol=1e-12)
    assert np.all(np.exp(table(np.array([6.01, 7.0]))) == 0.0)


@pytest.mark.parametrize("varying", [False, True])
def test_all_that_u_was_continued_by_is_in_the_error_of_the_table(varying: bool) -> None:
    """Of a u that falls ever more slowly the coarser table continues by less, which hid a part."""
    nodes, relative = np.linspace(0.0, 4.0, 9), 1e-3

    def u(energy):
        return (1.0 + np.asarray(energy)) ** -8.0

    solution: Any = SimpleNamespace(
        panels=nodes,
        process=SimpleNamespace(state_damping=varying),
        phase_space_density=u,
        phase_space_error=lambda energy: relative * u(energy),
    )
    weyl = WeylIntegrals(solution, 0.5)
    energy = nodes[-1] * (1.0 - np.array([1e-8, 1e-5, 1e-3, 1e-2]))
    rate = np.log(u(nodes[-2]) / u(nodes[-1]))
    share = 1.0 if varying else relative * (1.0 + 2.0 * 0.5 / rate)
    beyond = weyl_tail(0.5, energy, weyl.nodes[1], u)
    assert np.all(weyl(energy, "table") >= (1.0 - 1e-12) * share * beyond)


@pytest.mark.parametrize("order", [0.5, 1.0, 1.5, 2.5])
def test_weyl_integrals_of_a_power(order):
    # u = (c − H)^m, zero at the end c: Γ(m+1)/Γ(m+1+ν) (c − E)^(m+ν).
    nodes, m = np.linspace(0.0, 6.0, 7), 6
    table = weyl_table(order, nodes, lambda H: (6.0 - H) ** m)
    energy = np.linspace(0.0, 4.9, 101)
    expected = (
        gamma_function(m + 1.0) / gamma_function(m + 1.0 + order) * (6.0 - energy) ** (m + order)
    )
    # ln Ψ by degree 13 on unit panels, at a distance from the zero of 1.1 at least.
    np.testing.assert_allclose(np.exp(table(energy)), expected, rtol=1e-9)


THREE = (*TWO_MASSES, Contact(3, "both", 8.0, 0.4))


def three():
    return System([1.0] * 3, [1.0] * 3, [0.2] * 3, [0.1] * 3, contacts=THREE)


@pytest.mark.parametrize("n, tol", [(1, 1e-2), (2, 1e-3), (3, 1e-3), (3, 1e-4), (5, 1e-6)])
def test_the_stated_error_holds_up_to_where_the_mesh_ends(n, tol):
    """There all of p is what u was continued by beyond the last node."""
    system = System(np.ones(n), np.ones(n), np.full(n, 0.1), np.full(n, 0.05))  # temperature 1/2
    (density,) = solved(NonIntegrable(solver="fem", tol=tol), system, "p1")
    reach = density.panels[0][-1]
    p1 = reach * (1.0 - np.geomspace(1e-6, 0.5, 100))
    value, error = density.at(p1)
    assert np.all(np.abs(value - np.exp(-(p1**2)) / np.sqrt(np.pi)) <= error)


@pytest.mark.parametrize("method", [Exact(), Linear(), NonIntegrable(solver="closed-form")])
def test_the_stated_error_holds_where_the_density_underflows(method):
    system = System(np.ones(1), np.ones(1), np.full(1, 0.1), np.full(1, 0.05))  # temperature 1/2
    (density,) = solved(method, system, "p1")
    p1 = np.linspace(26.0, 27.5, 100)  # down to exp(−756)
    value, error = density.at(p1)
    reference = np.array([float(mpmath.exp(-(mpmath.mpf(x) ** 2))) for x in p1]) / np.sqrt(np.pi)
    assert reference[-1] == 0.0 < reference[0]
    assert np.all(np.abs(value - reference) <= error)


@pytest.mark.parametrize(
    "method, system, observable, reason",
    [
        (Exact(), fig6(both(10.0)), "q2", r"\(8\)"),
        (Exact(), exact_system(), "H1", "total energy only"),
        (NonIntegrable(), fig6(both(10.0)), "H2", "total energy only"),
        (NonIntegrable(), fig6(both(10.0)), "H,q1", "total energy only"),
        (NonIntegrable(), three(), "p1", "3 contact masses"),
        (NonIntegrable(), System([1.0], [1.0], [0.1], [0.0]), "q1", "no noise"),
        (NonIntegrable(), System([1.0], [1.0], [0.0], [0.1]), "q1", "nothing is damped"),
        (Linear(), fig6(both(10.0)), "q1", "has contacts"),
        (Linear(), fig6(), "H1", "total energy only"),
        (Linear(), System([1.0], [1.0], [0.0], [0.1]), "q1", "not damped"),
        (Linear(), System([1.0], [1.0], [0.1], [0.0]), "q1", "no noise"),
    ],
)
def test_a_refusal_gives_its_reason(method, system, observable, reason):
    asked = parse_observable(observable, system.n)
    given = method.refusal(system, asked)
    assert given is not None
    with pytest.raises(AssertionError):
        assert method.refusal(exact_system(), parse_observable("q1", 2)) is not None
    with pytest.raises(NotApplicable, match=reason) as caught:
        method.solve(system, [asked])
    assert str(caught.value) == given and "\n" not in given


@pytest.mark.parametrize("field, value", [("solver", "magic"), ("tol", 0.0), ("tol", 1e-13)])
def test_a_bad_choice_is_named(field, value):
    with pytest.raises(InvalidInput, match=rf"^{field} = "):
        NonIntegrable(**{field: value})


def test_refinement_tightens_the_tolerance():
    assert NonIntegrable(tol=1e-8).refined().tol == pytest.approx(1e-9)
    assert NonIntegrable(tol=1e-12).refined().tol == 1e-12
    coarse, fine = (
        solved(method, fig6(both(10.0)), "H")[0]
        for method in (NonIntegrable(tol=1e-5), NonIntegrable(tol=1e-5).refined())
    )
    assert fine.l1_error < coarse.l1_error
    system = fig6(both(10.0))
    reference = closed_form_density(system)
    (exact,) = solved(NonIntegrable(solver="closed-form"), system, "H")
    assert l1_distance(fine, exact) <= fine.l1_error + reference.l1_error


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("exponent", [1.0, 1.46, 1.5, 2.57])
def test_the_energy_of_one_mass_that_always_touches_is_certified(exponent, solver):
    # Without clearance p(H) is a series in a fractional power of H at H = 0.
    stop = Contact(1, "left", 1.5, 0.0, law="power", exponent=exponent)
    system = System([1.7], [1.0], [0.33], [0.032], contacts=(stop,))
    (density,) = solved(NonIntegrable(solver=solver, tol=1e-8), system, "H")
    assert density.certificate.certified, density.certificate.failures
    (closed,) = solved(Exact(tol=1e-8), system, "H")
    assert l1_distance(density, closed) <= density.l1_error + closed.l1_error
