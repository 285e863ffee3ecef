"""Exact, Gaussian and averaged densities against each other and against direct integrals."""

from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
from asked import solved
from processes import integral
from scipy.special import gamma as gamma_function
from systems import TWO_MASSES, both, chain, exact_system, fig6

from averaging import Exact, Linear, NonIntegrable
from averaging.energy_process import compatibility
from averaging.weyl import WeylIntegrals, weyl_table, weyl_tail
from cases.scene.scene import load_scene
from fpk import Contact, System
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.linear import stationary_covariance

SOLVERS = ("fem", "quadrature", "closed-form")
FULL_D = np.array([[0.05, 0.02], [0.02, 0.08]])
GYRO = np.array([[0.0, 0.3], [-0.3, 0.0]])


def tiered(combinations, default):
    """All of the combinations, those that are not in ``default`` marked slow."""
    return [
        pytest.param(*c, marks=() if c in default else pytest.mark.slow, id="-".join(c))
        for c in combinations
    ]


@pytest.mark.parametrize(
    "damping, noise, h",
    [
        ([0.2, 0.4], [0.1, 0.2], 2.0),
        (3.0 * FULL_D + GYRO, FULL_D, 3.0),
        ([0.2, 0.4 * (1.0 + 1e-9)], [0.1, 0.2], None),
        (3.0 * np.diag(np.diag(FULL_D)), FULL_D, None),
        (3.0 * FULL_D, np.diag(np.diag(FULL_D)), None),
        ([0.2, 0.0], [0.1, 0.2], None),
        ([0.0, 0.0], [0.1, 0.2], None),
        ([0.2, 0.4], [0.0, 0.0], None),
    ],
)
def test_condition_8(damping, noise, h):
    system = System([1.0, 2.0], [1.0, 1.0], damping, noise)
    if h is None:
        with pytest.raises(NotApplicable, match=r"\(8\)"):
            compatibility(system)
        with pytest.raises(NotApplicable):
            solved(Exact(), system, "q1")
        return
    assert compatibility(system) == pytest.approx([h], rel=1e-14)
    # For a linear system (7) can be checked: its covariance is that of exp(−h H).
    expected = np.linalg.inv(system.stiffness_matrix) / h
    np.testing.assert_allclose(stationary_covariance(system)[:2, :2], expected, rtol=1e-9)


CONTACTS = {
    "none": (),
    "both": both(10.0),
    "right": (Contact(2, "right", 10.0, 0.5),),
    "stiff": both(1e4),
    "zero clearance": both(10.0, 0.0),
    "mass 1": both(10.0, mass=1),
}


@pytest.mark.parametrize(
    "contact, solver",
    tiered(
        [(c, s) for c in CONTACTS for s in SOLVERS],
        [("stiff", "fem"), ("right", "quadrature"), ("mass 1", "closed-form")],
    ),
)
def test_averaging_is_exact_where_damping_and_noise_are_in_proportion(contact, solver):
    system, i = exact_system(CONTACTS[contact]), 1 if contact == "mass 1" else 2
    # The joint density with a contact mass integrated out takes a minute and is left out.
    names = f"q{i}", "H", f"q{i},p{i}", f"q{3 - i}", "p1", "p2"
    averaged = solved(NonIntegrable(solver, tol=1e-11), system, *names)
    for one, two in zip(averaged, solved(Exact(), system, *names), strict=True):
        distance = l1_distance(one, two)
        assert distance < 1e-10, one.name
        assert distance <= one.l1_error + two.l1_error + 1e-12, one.name


def test_gaussian_densities_have_the_moments_of_the_covariance():
    system = fig6(mass=(0.5, 3.0))
    S = stationary_covariance(system)
    rows = {"q1": 0, "q2": 1, "p1": 2, "p2": 3}
    for name, i in rows.items():
        (density,) = solved(Linear(), system, name)
        assert density.moment(2).value == pytest.approx(S[i, i], rel=1e-12)
    for one, two in (("q1", "q2"), ("q1", "p2"), ("p1", "p2")):
        (density,) = solved(Linear(), system, f"{one},{two}")
        size, exact = (
            np.sqrt(S[rows[one], rows[one]] * S[rows[two], rows[two]]),
            S[rows[one], rows[two]],
        )
        assert density.moment(1, 1).value == pytest.approx(exact, abs=1e-12 * size)
    # H = ½ xᵀ G x: mean ½ tr(G Σ), variance ½ tr((G Σ)²).
    (density,) = solved(Linear(), system, "H")
    G = np.zeros((4, 4))
    G[:2, :2], G[2:, 2:] = system.stiffness_matrix, np.diag(1.0 / system.mass)
    GS = G @ S
    mean, variance = 0.5 * np.trace(GS), 0.5 * np.trace(GS @ GS)
    for power, expected in enumerate((1.0, mean, variance + mean**2)):
        assert density.moment(power).value == pytest.approx(expected, rel=1e-11)


def test_a_pair_in_one_proportion_has_no_joint_density():
    """Noise on one mode alone: q1 = 0.618 q2 at all times."""
    system = load_scene("silent-mode").system
    with pytest.raises(NotApplicable, match="no joint density"):
        Linear().solve(system, [parse_observable("q1,q2", 2)])
    assert Linear().refusal(system, parse_observable("q1,p1", 2)) is None


THREE = [1.0, 0.5, 2.0], [1.0, 2.0, 1.0], [0.1] * 3, [0.02] * 3
BACK = {
    "both": fig6(both(10.0)),
    "right, masses": fig6((Contact(2, "right", 10.0, 0.5),), mass=(0.5, 3.0)),
    "stiff": fig6(both(1e4)),
    "three masses": System(*THREE, contacts=both(10.0)),
    "one mass": System([2.0], [1.0], [0.1], [0.05], contacts=both(10.0, mass=1)),
}


@pytest.mark.parametrize(
    "name, solver",
    tiered(
        [(n, s) for n in BACK for s in ("fem", "closed-form")],
        [("right, masses", "closed-form"), ("one mass", "fem")],
    ),
)
def test_joint_densities_have_their_marginals(name, solver):
    system = BACK[name]
    i = system.contact_masses[0] + 1
    joint, single = solved(NonIntegrable(solver=solver), system, f"q{i},p{i}", f"q{i}")
    assert single.moment(0).value == pytest.approx(1.0, abs=1e-9)
    low, high = single.panels[0][[0, -1]]
    for q in np.linspace(0.4 * low, 0.4 * high, 5):
        marginal = integral(lambda p, q=q: joint.pdf(np.full_like(p, q), p), joint.panels[1])
        # At the far ends the density has fallen to where the L1 tolerance 1e-10 is a lot.
        assert marginal == pytest.approx(single.pdf(np.array([q]))[0], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("order", [0.0, 0.5, 1.0, 2.5])
def test_weyl_integrals_of_an_exponential_and_of_a_power(order):
    # ∫_0^∞ e^(−a(E + x)) x^(ν−1) dx/Γ(ν) = a^(−ν) e^(−aE); the table continues u beyond its end.
    a, nodes = 4.0, np.unique(np.concatenate([np.linspace(0.0, 6.0, 13), [0.0625, 0.07, 0.1]]))
    table = weyl_table(order, nodes, lambda H: np.exp(-a * H))
    energy = np.concatenate([np.linspace(0.0, 5.99, 301), [0.0625]])
    np.testing.assert_allclose(np.exp(table(energy)), a**-order * np.exp(-a * energy), rtol=1e-12)
    assert np.all(np.exp(table(np.array([6.01, 7.0]))) == 0.0)
    # u = (c − H)^m, zero at the end c: Γ(m+1)/Γ(m+1+ν) (c − E)^(m+ν).
    m, energy = 6.0, np.linspace(0.0, 4.9, 101)
    table = weyl_table(order, np.linspace(0.0, 6.0, 7), lambda H: (6.0 - H) ** m)
    factor = gamma_function(m + 1.0) / gamma_function(m + 1.0 + order)
    # ln Ψ by degree 13 on unit panels, at a distance from the zero of 1.1 at least.
    expected = factor * (6.0 - energy) ** (m + order)
    np.testing.assert_allclose(np.exp(table(energy)), expected, rtol=1e-9)


@pytest.mark.parametrize("varying", [False, True])
def test_the_continuation_of_u_is_in_the_error_of_the_table(varying):
    """Of a u that falls ever more slowly the coarser table continues by less, which hid a part."""
    nodes, relative = np.linspace(0.0, 4.0, 9), 1e-3

    def u(energy):
        return (1.0 + np.asarray(energy)) ** -8.0

    solution = SimpleNamespace(
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


@pytest.mark.parametrize("n, tol", [(1, 1e-2), (3, 1e-4), (5, 1e-6)])
def test_the_stated_error_holds_up_to_where_the_mesh_ends(n, tol):
    """There all of p is the continuation of u beyond the last node."""
    (density,) = solved(NonIntegrable(solver="fem", tol=tol), chain(n), "p1")
    p1 = density.panels[0][-1] * (1.0 - np.geomspace(1e-6, 0.5, 100))
    value, error = density.at(p1)
    assert np.all(np.abs(value - np.exp(-(p1**2)) / np.sqrt(np.pi)) <= error)


@pytest.mark.parametrize("method", [Exact(), Linear(), NonIntegrable(solver="closed-form")])
def test_the_stated_error_holds_where_the_density_underflows(method):
    (density,) = solved(method, chain(1), "p1")
    p1 = np.linspace(26.0, 27.5, 100)  # down to exp(−756)
    value, error = density.at(p1)
    reference = np.array([float(mpmath.exp(-(mpmath.mpf(x) ** 2))) for x in p1]) / np.sqrt(np.pi)
    assert reference[-1] == 0.0 < reference[0]
    assert np.all(np.abs(value - reference) <= error)


TOUCHING = fig6(both(10.0))
ALL_TOUCH = chain(3, (*TWO_MASSES, Contact(3, "both", 8.0, 0.4)))
SILENT, UNDAMPED = (System([1.0], [1.0], [c], [D]) for c, D in ((0.1, 0.0), (0.0, 0.1)))


@pytest.mark.parametrize(
    "method, system, observable, reason",
    [
        (Exact(), TOUCHING, "q2", r"\(8\)"),
        (Exact(), exact_system(), "H1", "total energy only"),
        (NonIntegrable(), TOUCHING, "H2", "total energy only"),
        (NonIntegrable(), TOUCHING, "H,q1", "total energy only"),
        (NonIntegrable(), ALL_TOUCH, "p1", "3 contact masses"),
        (NonIntegrable(), SILENT, "q1", "no noise"),
        (NonIntegrable(), UNDAMPED, "q1", "nothing is damped"),
        (Linear(), TOUCHING, "q1", "has contacts"),
        (Linear(), fig6(), "H1", "total energy only"),
        (Linear(), UNDAMPED, "q1", "not damped"),
        (Linear(), SILENT, "q1", "no noise"),
    ],
)
def test_a_refusal_gives_its_reason(method, system, observable, reason):
    asked = parse_observable(observable, system.n)
    given = method.refusal(system, asked)
    with pytest.raises(NotApplicable, match=reason) as caught:
        method.solve(system, [asked])
    assert str(caught.value) == given and "\n" not in given


@pytest.mark.parametrize(
    ("exponent", "solver"),
    [
        (1.46, "fem"),
        (2.57, "quadrature"),
        *(pytest.param(e, s, marks=pytest.mark.slow) for e in (1.0, 1.5) for s in SOLVERS),
    ],
)
def test_the_energy_of_one_mass_that_always_touches_is_certified(exponent, solver):
    # Without clearance p(H) is a series in a fractional power of H at H = 0.
    stop = Contact(1, "left", 1.5, 0.0, law="power", exponent=exponent)
    system = System([1.7], [1.0], [0.33], [0.032], contacts=(stop,))
    (density,) = solved(NonIntegrable(solver=solver, tol=1e-8), system, "H")
    assert density.certificate.certified, density.certificate.failures
    (closed,) = solved(Exact(tol=1e-8), system, "H")
    assert l1_distance(density, closed) <= density.l1_error + closed.l1_error
