"""Hard cases: everything stays right where the scene is at its worst; and the checks can fail."""

from dataclasses import replace

import hard_battery
import hard_meshes
import hard_scenes
import hard_simulations
import numpy as np
import pytest
from hard_battery import Check, HardCase, in_units, mirrored
from hard_scenes import plain_elements
from page import page_text
from systems import damping_at

from averaging.energy_process import energy_process
from cases.scene.scene import load_scene
from fpk.system.system import System


def tiered(cases, slow, names):
    """The cases as parameters, those that are ``slow`` marked so."""
    marks = {True: [pytest.mark.slow], False: []}
    return [
        pytest.param(case, marks=marks[slow(case)], id=name)
        for case, name in zip(cases, names, strict=True)
    ]


CURVES = hard_scenes.CURVES
SCENES = tiered(
    CURVES,
    lambda case: case[0].name in hard_scenes.SLOW_SCENES,
    [f"{scene.name} {curve.label}" for scene, curve in CURVES],
)
MAKERS = (*hard_meshes.CASES, *hard_simulations.CASES)
OTHERS = tiered(
    MAKERS,
    lambda case: case in (*hard_meshes.SLOW, *hard_simulations.SLOW),
    [f"{k} {getattr(case, 'func', case).__name__}" for k, case in enumerate(MAKERS)],
)


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
    right = hard_battery.energy_density

    def wrong(system, solver, observable="H", **settings):
        answer = right(system, solver, observable, **settings)
        if solver != "fem":
            return answer
        return replace(answer, pdf=lambda H: 1.001 * answer.pdf(H))

    monkeypatch.setattr(hard_battery, "energy_density", wrong)
    checks, _, _ = hard_battery.solver_checks(system, hard_battery.TOL)
    failing = [c.what for c in checks if not c.holds]
    assert failing == ["finite elements: true error within the stated one"]


def test_an_error_that_does_not_fall_is_noticed(monkeypatch):
    system = load_scene("one-mass").system
    closed = hard_battery.energy_density(system, "closed-form")
    shifted = replace(closed, pdf=lambda H: closed.pdf(H * 1.001))
    assert hard_battery.refinement_check(system, closed).holds
    assert not hard_battery.refinement_check(system, shifted).holds


def test_units_are_those_of_the_equation_of_motion():
    # H of the rescaled state is the rescaled H; the relaxation time is the rescaled one.
    system = load_scene("limit-cycle").system
    factors = {"mass": 2.0, "length": 3.0, "time": 5.0}
    other = in_units(system, **factors)
    q, p = np.array([0.7, -0.9]), np.array([0.3, 0.2])
    velocity = factors["length"] / factors["time"]
    moved = q * factors["length"], p * factors["mass"] * velocity
    energy = factors["mass"] * velocity**2
    np.testing.assert_allclose(other.hamiltonian(*moved), energy * system.hamiltonian(q, p))
    np.testing.assert_allclose(
        damping_at(other, *moved), factors["mass"] / factors["time"] * damping_at(system, q, p)
    )
    # Noise: 2 D/m² dt is a velocity squared.
    np.testing.assert_allclose(
        np.diag(other.noise_matrix) / other.mass**2 * factors["time"],
        velocity**2 * np.diag(system.noise_matrix) / system.mass**2,
    )


def test_the_mirror_swaps_the_sides():
    system = load_scene("unequal-sides").system
    q = np.array([0.4, 1.3])
    assert mirrored(system).potential(-q) == system.potential(q)
    assert mirrored(system).potential(q) != system.potential(q)


def test_plain_elements_solve_an_easy_case():
    system = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.16], [0.01, 0.02])
    closed = hard_battery.energy_density(system, "closed-form")
    error, minimum = plain_elements(energy_process(system), closed)
    # Cells of 0.02 energy scales: third order, (0.02)³ and a factor below one.
    assert error < 8e-6
    assert minimum > -1e-6


def test_the_page_shows_what_fails():
    case = HardCase("a | b", "why", "ours", "certified", [Check("x", False, "2")])
    assert case.failures == ("x: 2",)
    text = page_text([case])
    assert "a \\| b" in text and "0 of 1 hold" in text
