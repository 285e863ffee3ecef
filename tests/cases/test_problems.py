"""A run says what is wrong, and blames no answer for what another one is wrong about."""

import json
from dataclasses import dataclass, replace

import pytest

from averaging.exact import Exact
from averaging.nonintegrable import NonIntegrable
from cases.comparison.routes import method_for
from cases.comparison.run import run_scene
from cases.scene.scene import load_scene
from fpk.certificate import Measured
from fpk.density import certified_density
from fpk.method import Plan
from fpk.observable import parse_observable


def shifted(density, shift, tol):
    """The density moved by ``shift``, certified where ``tol`` allows its error."""
    measured = Measured(density.l1_error, 0.0, 0.0, 0.0, 0.0)
    panels = tuple(nodes + shift for nodes in density.panels)
    pdf, pointwise = density.pdf, density.pointwise
    return certified_density(
        density.observable,
        panels,
        lambda x, *p: pdf(x - shift, *p),
        lambda x, *p: pointwise(x - shift, *p),
        measured=measured,
        tol=tol,
    )


@dataclass(frozen=True)
class Wrong(Exact):
    """The exact solution of another system, its error stated as if it were right.

    ``judged_by`` is the tolerance of the shifted answer.
    """

    judged_by: float = 1e-6

    def prepare(self, system):
        plan = super().prepare(system)

        def solve(observables, progress):
            result = plan.solve(observables, progress)
            densities = tuple(shifted(d, 0.1, self.judged_by) for d in result.densities)
            return replace(result, densities=densities)

        return Plan(plan.refusal, solve)


@pytest.fixture(scope="module")
def scene():
    loaded = load_scene("fig3a")
    few = {"observables": (parse_observable("q2", 2),), "curves": loaded.curves[:1]}
    return replace(loaded, **few, expect=None)


@pytest.fixture(scope="module")
def right():
    return (NonIntegrable(), method_for("montecarlo", paths=4096, relaxations=20.0))


def test_an_answer_that_is_not_certified_is_the_one_in_doubt(scene, right):
    outcome = run_scene(scene, [Wrong(judged_by=1e-16), *right])
    differing = [p for p in outcome.problems if "differ" in p]
    assert len(differing) == 2
    assert all("exact is not certified" in p and "no finding against" in p for p in differing)
    assert any("no finding against montecarlo" in p for p in differing)


def test_a_wrong_answer_is_named_where_two_independent_ones_agree(scene, right):
    outcome = run_scene(scene, [Wrong(), *right])
    differing = [p for p in outcome.problems if "differ" in p]
    assert len(differing) == 2 == len(outcome.problems)
    (of_sample,) = [p for p in differing if "exact and montecarlo" in p]
    assert "montecarlo agrees with nonintegrable/fem" in of_sample


def test_two_answers_alone_blame_neither(scene, right):
    (problem,) = run_scene(scene, [Wrong(), right[1]]).problems
    assert "exact and montecarlo differ" in problem and "agrees" not in problem


def test_a_run_in_which_nothing_applies_is_no_success(fpk, scene_text, tmp_path):
    path = tmp_path / "quiet.toml"
    path.write_text(scene_text.replace("[0.01, 0.02]", "[0.0, 0.0]"))
    status, out, err = fpk("run", path)
    assert status == 1 and "no route applies" in err and "every check holds" not in out
    status, out, err = fpk("run", path, "--json")
    assert status == 1 and any("no route applies" in p for p in json.loads(out)["problems"])
