"""The solver scikit-fem: equal to the fast solvers on one mesh, within its estimate on its own."""

from dataclasses import replace

import numpy as np
import pytest

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from cases.scene.scene import load_scene, shipped_scenes
from cases.study.equations import energy_equation, modal_equation
from cases.study.orders import NEAR_THEORY
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_on_mesh
from fpk.solvers.operator import null_vectors, solve_by_scikit_fem

METHODS = ((NonIntegrable, "H"), (Integrable, "H1,H2"))
QUICK = ("fig6a", "stiff-stops")


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
        other = replace(system, damping=1.1 * system.damping)
        (wrong,) = method("fem").solve(other, [observable]).densities
        assert l1_distance(wrong, slow) > wrong.l1_error + slow.l1_error


@pytest.mark.parametrize(
    ("equation_of", "degree"),
    [
        (energy_equation, 1),
        (energy_equation, 4),
        (modal_equation, 2),
        pytest.param(modal_equation, 3, marks=pytest.mark.slow),
    ],
)
def test_orders_are_those_of_theory(equation_of, degree):
    equation = equation_of(load_scene("fig6b").system, "scikit-fem")
    ladder = equation.study(equation.elements(degree)).ladder()
    orders = np.array(ladder.verdicts["L1"].orders[-2:])
    assert ladder.verdicts["L1"].kind == "asymptotic"
    assert np.all(np.abs(orders - degree - 1) < NEAR_THEORY)
    assert all(level.honest for level in ladder.levels)


def test_it_is_taken_only_where_it_is_named(fpk):
    assert "scikit-fem" not in fpk("run", "fig8b", "--no-simulation", "--of", "H", "--details")[1]
    named = ("--method", "nonintegrable/scikit-fem", "--of", "H")
    assert "energy averaging" in fpk("run", "fig8b", *named)[1]


def test_the_round_off_of_all_elements_together_is_stated():
    # Of so many elements it is 1e-11: twice as much as what was stated.
    process = energy_process(load_scene("vanishing-damping").system)
    nodes = solve_by_scikit_fem(process, tol=1e-8).nodes
    while nodes.size < 600:
        nodes = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
    together = solve_on_mesh(process, nodes, 6, null_vectors=null_vectors)
    alone = solve_on_mesh(process, nodes, 6)
    x, w = panel_rule(nodes, 12)
    apart = float(np.sum(w * np.abs(together.density(x) - alone.density(x))))
    assert apart <= together.l1_error - alone.l1_error < 1e-10
