"""Exact, Gaussian and averaged densities against integrals; the averaged process, Eq. (25)."""

import mpmath
import numpy as np
import pytest
from asked import assert_known, assert_refusal, noise_proportional, refusal, solved
from systems import TWO_MASSES, both, chain, exact_system, fig6

from averaging import Exact, Integrable, Linear, NonIntegrable
from averaging.energy_process import compatibility, energy_process
from averaging.modal.analysis import modal_analysis
from averaging.zero_flux import solve_by_quadrature
from cases.scene.scene import load_scene
from fpk import Contact, DampingTerm, System
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_stationary
from fpk.system.linear import stationary_covariance

SOLVERS = ("fem", "quadrature", "closed-form")
FULL_D = np.array([[0.05, 0.02], [0.02, 0.08]])
GYRO = np.array([[0.0, 0.3], [-0.3, 0.0]])


TURN = tuple(DampingTerm(i + 1, 2 - i, 0.3 * (1 - 2 * i), q=((1, 1),)) for i in range(2))
"""Turns without working, which leaves the density alone, unless it depends on velocities."""
DRAGGED = tuple(DampingTerm(t.i, t.j, t.coefficient, v=((1, 1),)) for t in TURN)


@pytest.mark.parametrize(
    "damping, noise, terms, h",
    [
        ([0.2, 0.4], [0.1, 0.2], (), 2.0),
        (3.0 * FULL_D + GYRO, FULL_D, (), 3.0),
        ([0.2, 0.4 * (1.0 + 1e-9)], [0.1, 0.2], (), None),
        (3.0 * np.diag(np.diag(FULL_D)), FULL_D, (), None),
        ([0.2, 0.0], [0.1, 0.2], (), None),
        ([0.0, 0.0], [0.1, 0.2], (), None),
        ([0.2, 0.4], [0.0, 0.0], (), None),
        ([0.1, 0.2], [0.1, 0.2], TURN, 1.0),
        ([0.1, 0.2], [0.1, 0.2], DRAGGED, None),
        ([0.1, 0.2], [0.1, 0.2], (DampingTerm(1, 1, 0.1, energy=1),), None),
        ([-0.05, 0.02], [0.1, 0.1], (DampingTerm(1, 1, 0.1, q=((1, 2),)),), None),
    ],
)
def test_condition_8(damping, noise, terms, h):
    system = System([1.0, 2.0], [1.0, 1.0], damping, noise, damping_terms=terms)
    if h is None:
        with pytest.raises(NotApplicable, match=r"\(8\)"):
            compatibility(system)
        return
    assert compatibility(system) == pytest.approx([h], rel=1e-14)
    if not terms:
        # For a linear system (7) can be checked: its covariance is that of exp(−h H).
        expected = np.linalg.inv(system.stiffness_matrix) / h
        np.testing.assert_allclose(stationary_covariance(system)[:2, :2], expected, rtol=1e-9)


FED = noise_proportional(-50.0, 100.0, scale=0.1)
"""Fed below H = ½, damped above."""
PROPORTION = {
    "stiff": exact_system(both(1e4)),
    "right": exact_system((Contact(2, "right", 10.0, 0.5),)),
    "mass 1": exact_system(both(10.0, mass=1)),
    "zero clearance": exact_system(both(10.0, 0.0)),
    "fed": FED,
    "fed, with a stop": noise_proportional(-0.5, 1.0, both(10.0)),
}


@pytest.mark.parametrize(
    "name, solver",
    [
        ("stiff", "fem"),
        ("right", "quadrature"),
        ("mass 1", "closed-form"),
        *(("fed", s) for s in SOLVERS),
        *(pytest.param("zero clearance", s, marks=pytest.mark.slow) for s in SOLVERS),
        *(pytest.param("fed, with a stop", s, marks=pytest.mark.slow) for s in SOLVERS),
    ],
)
def test_averaging_is_exact_where_damping_and_noise_are_in_proportion(name, solver):
    system, i = PROPORTION[name], 1 if name == "mass 1" else 2
    # The joint density with a contact mass integrated out takes a minute and is left out.
    names = f"q{i}", "H", f"q{i},p{i}", f"q{3 - i}", "p1", "p2"
    averaged = solved(NonIntegrable(solver, tol=1e-11), system, *names)
    for one, two in zip(averaged, solved(Exact(), system, *names), strict=True):
        distance = l1_distance(one, two)
        assert distance < 1e-10, one.name
        assert distance <= one.l1_error + two.l1_error + 1e-12, one.name


def test_a_pair_in_one_proportion_has_no_joint_density():
    """Noise on one mode alone: q1 = 0.618 q2 at all times."""
    system = load_scene("silent-mode").system
    with pytest.raises(NotApplicable, match="no joint density"):
        Linear().solve(system, [parse_observable("q1,q2", 2)])
    assert Linear().refusal(system, parse_observable("q1,p1", 2)) is None


@pytest.mark.parametrize("growth", [0.0, 0.5])
@pytest.mark.parametrize("n, tol", [(1, 1e-2), (3, 1e-4), (5, 1e-6)])
def test_the_stated_error_holds_up_to_where_the_mesh_ends(n, tol, growth):
    """There all of p is the continuation of u beyond the last node; ln u = −2 H − ``growth`` H²."""
    terms = [DampingTerm(i + 1, i + 1, 0.1 * growth, energy=1) for i in range(n)]
    system = chain(n, damping_terms=terms)
    (density,), (exact,) = (
        solved(method, system, "p1") for method in (NonIntegrable(solver="fem", tol=tol), Exact())
    )
    p1 = density.panels[0][-1] * (1.0 - np.geomspace(1e-6, 0.5, 100))
    value, error = exact.at(p1)
    assert_known(density, [p1], value, rounding=error)


@pytest.mark.parametrize("method", [Exact(), Linear(), NonIntegrable(solver="closed-form")])
def test_the_stated_error_holds_where_the_density_underflows(method):
    (density,) = solved(method, chain(1), "p1")
    p1 = np.linspace(26.0, 27.5, 100)  # down to exp(−756)
    reference = np.array([float(mpmath.exp(-(mpmath.mpf(x) ** 2))) for x in p1]) / np.sqrt(np.pi)
    assert reference[-1] == 0.0 < reference[0]
    assert_known(density, [p1], reference)


TOUCHING = fig6(both(10.0))
ALL_TOUCH = chain(3, (*TWO_MASSES, Contact(3, "both", 8.0, 0.4)))
STILL = 0.1 * np.outer(*(2 * [np.linalg.inv(modal_analysis(fig6()).mode_shapes)[1]]))
"""Damping or noise on mode 2 alone: c = M T⁻ᵀ diag(0, 1) T⁻¹ M."""
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
        (Integrable(), System([1, 1], [1, 1], [0.1, 0.1], STILL), "q1", "mode 1 .* no noise"),
        (Integrable(), SILENT, "H1", "mode 1 .* no noise"),
        (Integrable(), System([1, 1], [1, 1], STILL, [0.1, 0.1]), "q1", "mode 1 .* not damped"),
        (Integrable(), fig6(), "H,H1", "both must be modal energies"),
        (Integrable(), fig6(), "p1,H", "both must be modal energies"),
        (Integrable("fem"), fig6(), "q2", "use closed-form"),
        (Integrable("quadrature"), fig6(), "q1,p1", "use closed-form"),
    ],
)
def test_a_refusal_gives_its_reason(method, system, observable, reason):
    assert_refusal(method, system, observable, reason)


@pytest.mark.parametrize(("exponent", "solver"), [(1.46, "fem"), (2.57, "quadrature")])
def test_the_energy_of_one_mass_that_always_touches_is_certified(exponent, solver):
    # Without clearance p(H) is a series in a fractional power of H at H = 0.
    stop = Contact(1, "left", 1.5, 0.0, law="power", exponent=exponent)
    system = System([1.7], [1.0], [0.33], [0.032], contacts=(stop,))
    (density,) = solved(NonIntegrable(solver=solver, tol=1e-8), system, "H")
    assert density.certificate.certified, density.certificate.failures
    (closed,) = solved(Exact(tol=1e-8), system, "H")
    assert l1_distance(density, closed) <= density.l1_error + closed.l1_error


def cycle(n, noise, contacts=()):
    """Van der Pol's damping −0.05 + 0.1 q₁² of the first mass."""
    return System(
        np.ones(n),
        np.ones(n),
        [-0.05, *[0.02] * (n - 1)],
        np.full(n, noise),
        contacts=contacts,
        damping_terms=(DampingTerm(1, 1, 0.1, q=((1, 2),)),),
    )


@pytest.mark.parametrize(
    "n, stiff, noise",
    [
        (1, True, 0.1),
        (2, False, 0.001),
        (2, True, 0.01),
        pytest.param(1, True, 0.001, marks=pytest.mark.slow),
    ],
)
def test_limit_cycles_are_found_wherever_they_are(n, stiff, noise):
    system = cycle(n, noise, (Contact(n, "both", 10.0, 0.5),) if stiff else ())
    process = energy_process(system)
    # What the quadratures of one mass with contact leave open adds up over 100 nats and more.
    tol = 1e-8 if n == 1 and stiff else 1e-9
    fem = solve_stationary(process, tol=tol)
    direct = solve_by_quadrature(process, tol=tol)
    nodes = np.unique([*fem.nodes, *direct.nodes[direct.nodes < fem.nodes[-1]]])
    x, w = panel_rule(nodes, 16)
    p, s = fem.density(x), np.exp(direct.log_density(x))
    assert fem.certificate.certified and direct.l1_error < tol
    assert np.sum(w * np.abs(p - s)) <= fem.l1_error + direct.l1_error


def test_the_limit_cycle_of_one_mass_is_a_gaussian_of_the_energy():
    # ⟨q² v²⟩ = H²/2 for k = m = 1: u = exp(−(H − 1)²/(2 s²)), s² = D/0.05, cut at H = 0.
    noise = 1e-4
    system = cycle(1, noise)
    width = np.sqrt(noise / 0.05)
    x = np.array([0.8, 0.95, 1.0, 1.1])
    expected = np.exp(-(((x - 1.0) / width) ** 2) / 2.0) / np.sqrt(2.0 * np.pi) / width
    for solver in ("fem", "quadrature"):
        H = solved(NonIntegrable(solver), system, "H")[0]
        # e^−250 of the mass of the Gaussian lies below 0.
        np.testing.assert_allclose(H.at(x)[0], expected, rtol=1e-9)
        assert H.at(np.array([1e-3]))[0] < 1e-100


def test_energies_of_two_levels_are_weighed_against_each_other():
    # α(H) = (H − ½)(H − 2)(H − 4)/D, fed twice: p = exp(−∫α)/Z, with hundreds of nats between.
    D, c = 0.01, np.poly([0.5, 2.0, 4.0])[::-1]
    terms = tuple(DampingTerm(1, 1, c[e], energy=e) for e in range(1, 4))
    system = System([1.0], [1.0], [c[0]], [D], damping_terms=terms)
    levels = np.polynomial.polynomial.polyint(c / D)

    def exponent(H):
        return -np.polynomial.polynomial.polyval(H, levels)

    top = max(exponent(0.5), exponent(4.0))
    assert exponent(0.5) - exponent(2.0) > 50.0

    def weight(H):
        return np.exp(exponent(H) - top)

    x, w = panel_rule(np.linspace(0.0, 7.0, 281), 20)
    norm = np.sum(w * weight(x))
    H = np.array([0.3, 0.5, 0.7, 2.0, 3.9, 4.1])
    # A tolerance that the round-off of α, a sum of powers up to H³, does not reach over 300 nats.
    for solver in ("closed-form", "fem", "quadrature"):
        method = NonIntegrable(solver, tol=1e-9)
        density = solved(method, system, "H")[0]
        exact = weight(H) / norm
        assert_known(density, [H], exact, rounding=1e-11 * exact)


def test_what_has_no_stationary_density_is_refused_with_the_reason():
    def one(damping, noise, *terms, contacts=()):
        return System([1], [1], [damping], [noise], contacts=contacts, damping_terms=terms)

    driving, odd = DampingTerm(1, 1, -0.1, q=((1, 2),)), DampingTerm(1, 1, 0.1, q=((1, 1),))
    stopped = one(0.1, 0.1, driving, contacts=both(10.0, mass=1))
    for solver, system, name, reason in (
        ("fem", one(0.1, 0.1, driving), "H", "grows for ever"),
        ("quadrature", stopped, "H", "grows for ever"),
        ("fem", one(0.0, 0.1, odd), "q1", ""),  # without contact it does nothing
        ("fem", one(0.1, 0.0, DampingTerm(1, 1, 0.1, energy=1)), "q1", "no noise"),
        ("closed-form", cycle(1, 0.1), "H", "fem and quadrature"),
    ):
        given = refusal(NonIntegrable(solver), system, name)
        assert given and reason in given
    assert NonIntegrable("fem").refusal(cycle(1, 0.1), parse_observable("H", 1)) is None


@pytest.mark.parametrize("contacts", [(), (Contact(1, "both", 10.0, 0.3),)], ids=["free", "stop"])
def test_terms_that_cancel_to_round_off_leave_it_in_the_stated_error(contacts):
    """c11 gains a (1 + 5e-15) q1² and −a q1²: what is left is 5e-15 a q1², known to no digit."""

    def density(solver, *coefficients):
        terms = tuple(DampingTerm(1, 1, c, q=((1, 2),)) for c in coefficients)
        return solved(NonIntegrable(solver), chain(2, contacts, damping_terms=terms), "H")[0]

    large = 1e6 * (1.0 + 5e-15)
    for solver in ("fem", "quadrature"):
        both, one = density(solver, large, -1e6), density(solver, large - 1e6)
        assert both.l1_error >= l1_distance(both, one) - one.l1_error
