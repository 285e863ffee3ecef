"""The solver scikit-fem: equal to the fast solvers on one mesh, within its estimate on its own."""

import numpy as np
import pytest

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.nonintegrable import NonIntegrable
from cases.scene.scene import load_scene, shipped_scenes
from cases.study.equations import energy_equation, modal_equation
from cases.study.orders import NEAR_THEORY, observed_orders
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_on_mesh
from fpk.solvers.operator import null_vectors, plane_null_function, solve_by_scikit_fem
from fpk.solvers.plane.solution import root_spaced_nodes, solve_plane_on_mesh

METHODS = ((NonIntegrable, "H"), (Integrable, "H1,H2"))
QUICK = ("fig6a", "vanderpol", "stiff-stops", "chain-50")


@pytest.mark.parametrize("degree", [1, 2, 5])
def test_on_one_mesh_it_is_the_solution_of_the_fast_solver(degree):
    process = energy_process(load_scene("fig6b").system)
    nodes = np.unique([*np.linspace(0.0, 4.0, 9), *process.nonsmooth])
    fast = solve_on_mesh(process, nodes, degree)
    slow = solve_on_mesh(process, nodes, degree, null_vectors=null_vectors)
    x = np.linspace(0.05, 3.9, 50)
    np.testing.assert_allclose(slow.density(x), fast.density(x), rtol=1e-10)
    process = modal_analysis(load_scene("vanderpol").system).process((0, 1))
    mesh = root_spaced_nodes(10.0 * np.array(process.energy_scales), 4)
    quick = solve_plane_on_mesh(process, mesh, degree)
    other = solve_plane_on_mesh(process, mesh, degree, solved=plane_null_function)
    grid = [np.linspace(0.01, 9.0, 20) * scale for scale in process.energy_scales]
    p = quick.density(grid[0][:, None], grid[1])
    np.testing.assert_allclose(
        other.density(grid[0][:, None], grid[1]), p, atol=1e-10 * np.abs(p).max()
    )


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in QUICK)) for n in shipped_scenes()]
)
def test_it_answers_every_shipped_scene_within_its_stated_error(name):
    system = load_scene(name).system
    for method, of in METHODS if system.n > 1 else METHODS[:1]:
        observable, answers = parse_observable(of, system.n), []
        for solver in ("fem", "scikit-fem"):
            try:
                answers += method(solver).solve(system, [observable]).densities
            except (NotApplicable, NotCertified) as reason:
                answers.append(str(reason))
        fast, slow = answers
        if isinstance(fast, str):
            assert slow == fast
            continue
        assert slow.certificate.certified, slow.certificate.failures
        assert l1_distance(fast, slow) <= fast.l1_error + slow.l1_error
        other = method("fem").solve(system.__class__(
            system.mass, system.stiffness, 1.1 * system.damping, system.noise_intensity,
            system.noise_gain, system.contacts, system.damping_terms,
        ), [observable]).densities[0]  # fmt: skip
        assert l1_distance(other, slow) > other.l1_error + slow.l1_error


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_orders_of_one_energy_are_those_of_theory(degree):
    equation = energy_equation(load_scene("fig6b").system, "scikit-fem")
    ladder = equation.study(equation.elements(degree)).ladder()
    orders = np.array(ladder.verdicts["L1"].orders[-2:])
    assert ladder.verdicts["L1"].kind == "asymptotic" and np.all(
        np.abs(orders - degree - 1) < NEAR_THEORY
    )
    assert all(level.honest for level in ladder.levels)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_orders_of_two_energies_are_those_of_theory(degree):
    equation = modal_equation(load_scene("fig6b").system, "scikit-fem")
    setting, found = equation.elements(degree), []
    for _ in range(4):
        found.append(setting.solve().density)
        setting = setting.refined()
    grid = [np.linspace(0.0, end, 200) for end in equation.ends]
    exact = equation.reference(grid[0][:, None], grid[1])
    errors = [np.abs(p(grid[0][:, None], grid[1]) - exact).mean() for p in found]
    assert abs(observed_orders(2.0 ** -np.arange(4.0), errors)[-1] - degree - 1) < 2.0 * NEAR_THEORY


def test_what_it_cannot_meet_is_not_certified():
    process = modal_analysis(load_scene("limit-cycle").system).process((0, 1))
    answer = solve_by_scikit_fem(process, tol=1e-9, degree=2)
    assert not answer.certificate.certified
    assert "exceeds the tolerance" in answer.certificate.failures[0]


@pytest.mark.parametrize("method", [NonIntegrable, Integrable])
def test_it_is_refined_from_its_own_default(method):
    at_first, finer = method("scikit-fem"), method("scikit-fem").refined()
    assert finer.tol == 0.1 * at_first.wanted(load_scene("fig8b").system)
    assert finer.refined().tol == 0.1 * finer.tol


def test_it_is_taken_only_where_it_is_named(fpk):
    assert "scikit-fem" not in fpk("run", "fig8b", "--no-simulation", "--details")[1]
    named = ("--method", "nonintegrable/scikit-fem")
    assert "energy averaging" in fpk("run", "fig8b", *named)[1]
    answer = fpk("density", "fig8b", "--method", "integrable", "--of", "H1,H2", "--at", "1 x 1",
                 "--solver", "scikit-fem", "--json")  # fmt: skip
    assert answer[0] == 0 and '"solver": "scikit-fem"' in answer[1]


@pytest.mark.parametrize(
    ("name", "more"), [("two-contact-masses", 1000), ("vanishing-damping", 600)]
)
def test_the_round_off_of_all_elements_together_is_stated(name, more):
    # Of so many elements it is 3e-12 and 1e-11, more than half of what was stated or twice as much.
    process = energy_process(load_scene(name).system)
    nodes = solve_by_scikit_fem(process, tol=1e-8).nodes
    while nodes.size < more:
        nodes = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
    together = solve_on_mesh(process, nodes, 6, null_vectors=null_vectors)
    alone = solve_on_mesh(process, nodes, 6)
    x, w = panel_rule(nodes, 12)
    apart = float(np.sum(w * np.abs(together.density(x) - alone.density(x))))
    assert apart <= together.l1_error - alone.l1_error < 1e-10
