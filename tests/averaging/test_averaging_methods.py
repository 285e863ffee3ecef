"""Exact, Gaussian and averaged densities against each other and against direct integrals."""

import mpmath
import numpy as np
import pytest
from asked import assert_known, assert_refusal, noise_proportional, solved
from systems import TWO_MASSES, both, chain, exact_system, fig6

from averaging import Exact, Integrable, Linear, NonIntegrable
from averaging.energy_process import compatibility
from averaging.modal.analysis import modal_analysis
from cases.scene.scene import load_scene
from fpk import Contact, DampingTerm, System
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
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
