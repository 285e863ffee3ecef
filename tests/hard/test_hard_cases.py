"""Hard cases: everything stays right where the scene is at its worst; and the checks can fail."""

from dataclasses import replace

import hard_meshes
import hard_scenes
import hard_simulations
import pytest
from hard_scenes import Check, HardCase, plain_elements
from page import page_text

from averaging.energy_process import energy_process
from cases.scene.scene import load_scene
from fpk.system.system import System


def tiered(case, name, *, slow):
    return pytest.param(case, marks=[pytest.mark.slow] if slow else [], id=name)


SCENES = [
    tiered(of, f"{of[0].name} {of[1].label}", slow=of[0].name in hard_scenes.SLOW_SCENES)
    for of in hard_scenes.CURVES
]
OTHERS = [
    tiered(case, f"{k} {getattr(case, 'func', case).__name__}", slow=case in module.SLOW)
    for module in (hard_meshes, hard_simulations)
    for k, case in enumerate(module.CASES)
]


@pytest.mark.parametrize("of", SCENES)
def test_hard_scene_holds(of):
    case = hard_scenes.curve_case(*of)
    assert not case.failures
    assert len(case.checks) >= 8


def test_every_hard_scene_says_why():
    scenes = hard_scenes.hard_scenes()
    assert len(scenes) == 17
    assert all(s.source.startswith("Hard: ") for s in scenes)
    assert len(SCENES) + len(OTHERS) > 40


@pytest.mark.parametrize("case", OTHERS)
def test_hard_meshes_limits_and_simulations_hold(case):
    assert not case().failures


def test_a_wrong_density_is_noticed(monkeypatch):
    system = load_scene("stiff-stops").system
    right = hard_scenes.energy_density

    def wrong(system, solver, observable="H", **settings):
        answer = right(system, solver, observable, **settings)
        if solver != "fem":
            return answer
        return replace(answer, pdf=lambda H: 1.001 * answer.pdf(H))

    monkeypatch.setattr(hard_scenes, "energy_density", wrong)
    checks, _, _ = hard_scenes.solver_checks(system, hard_scenes.TOL)
    failing = [c.what for c in checks if not c.holds]
    assert failing == ["finite elements: true error within the stated one"]


def test_an_error_that_does_not_fall_is_noticed(monkeypatch):
    system = load_scene("one-mass").system
    closed = hard_scenes.energy_density(system, "closed-form")
    shifted = replace(closed, pdf=lambda H: closed.pdf(H * 1.001))
    assert hard_scenes.refinement_check(system, closed).holds
    assert not hard_scenes.refinement_check(system, shifted).holds


def test_plain_elements_solve_an_easy_case():
    system = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.16], [0.01, 0.02])
    closed = hard_scenes.energy_density(system, "closed-form")
    error, minimum = plain_elements(energy_process(system), closed)
    # Cells of 0.02 energy scales: third order, (0.02)³ and a factor below one.
    assert error < 8e-6
    assert minimum > -1e-6


def test_the_page_shows_what_fails():
    case = HardCase("a | b", "why", "ours", "certified", [Check("x", False, "2")])
    assert case.failures == ("x: 2",)
    text = page_text([case])
    assert "a \\| b" in text and "0 of 1 hold" in text
