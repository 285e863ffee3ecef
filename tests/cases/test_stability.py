"""Hard cases: the quick ones as ``fpk verify --hard`` runs them, and that the checks can fail."""

from dataclasses import replace

import numpy as np
import pytest

from averaging.energy_process import energy_process
from cases.scene import load_scene
from cases.stability import battery, lines, motion, noiseless
from cases.stability.case import Check, HardCase
from cases.stability.plain import plain_elements
from cases.stability.run import GROUPS, hard_cases, hard_line, hard_record, hard_table
from cases.stability.scenes import curve_case, hard_scenes
from cases.summary import plain
from fpk.system import System
from fpk.units import in_units, mirrored

QUICK = [
    "bistable",
    "chain-10",
    "clearances",
    "damping-range",
    "near-resonance",
    "never-reached",
    "noise-range",
    "one-mass",
    "silent-mode",
    "spread-scales",
    "stiff-stops",
    "unequal-sides",
    "vanishing-damping",
]
CASES = [(scene, curve) for s in QUICK for scene in [load_scene(s)] for curve in scene.curves]


@pytest.mark.parametrize(("scene", "curve"), CASES, ids=[f"{s.name} {c.label}" for s, c in CASES])
def test_hard_scene_holds(scene, curve):
    case = curve_case(scene, curve)
    assert not case.failures
    assert len(case.checks) >= 8


def test_every_hard_scene_says_why():
    scenes = hard_scenes()
    assert len(scenes) == 17
    assert all(s.source.startswith("Hard: ") for s in scenes)


@pytest.mark.parametrize(
    "case", [lines.rigid_limit, lines.degrees, lines.gradings, lines.short_end, lines.far_end]
)
def test_hard_meshes_and_limits_hold(case):
    assert not case().failures


@pytest.mark.parametrize(
    "case", [noiseless.no_noise, motion.one_trajectory, motion.too_long_a_step]
)
def test_hard_simulations_hold(case):
    assert not case().failures


@pytest.mark.slow
def test_every_hard_case_holds():
    found = list(hard_cases())
    assert len(found) > 40
    assert [f for c in found for f in c.failures] == []


def test_a_wrong_density_is_noticed(monkeypatch):
    system = load_scene("stiff-stops").system
    right = battery.energy_density

    def wrong(system, solver, observable="H", **settings):
        found = right(system, solver, observable, **settings)
        if solver != "fem":
            return found
        return replace(found, pdf=lambda H: 1.001 * found.pdf(H))

    monkeypatch.setattr(battery, "energy_density", wrong)
    checks, _, _ = battery.solver_checks(system, battery.TOL)
    failing = [c.what for c in checks if not c.holds]
    assert failing == ["finite elements: true error within the stated one"]


def test_an_error_that_does_not_fall_is_noticed(monkeypatch):
    system = load_scene("one-mass").system
    closed = battery.energy_density(system, "closed-form")
    shifted = replace(closed, pdf=lambda H: closed.pdf(H * 1.001))
    assert battery.refinement_check(system, closed).holds
    assert not battery.refinement_check(system, shifted).holds


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
        other.damping_at(*moved), factors["mass"] / factors["time"] * system.damping_at(q, p)
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
    closed = battery.energy_density(system, "closed-form")
    error, minimum = plain_elements(energy_process(system), closed)
    # Cells of 0.02 energy scales: third order, (0.02)³ and a factor below one.
    assert error < 8e-6
    assert minimum > -1e-6


def test_table_and_record_tell_what_fails():
    case = HardCase("a | b", "why", "plain", "ours", "certified", (Check("x", False, "2"),), 0.1)
    assert "1 FAIL" in hard_line(case)
    assert "a \\| b" in hard_table([case])
    record = hard_record([case])
    assert record["holds"] is False
    assert record["cases"][0]["failures"] == plain(["x: 2"])
    assert len(GROUPS) == 3
