"""The solution of the full equation as the judge of ``fpk run``, within bounds of its work."""

from dataclasses import replace

import pytest
from made_answers import displaced

from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from averaging.phase_space.method import UNASKED_WORK, PhaseSpace
from cases.compare.answers import Answers
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.facts import theories
from fpk.numeric.errors import NotApplicable
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

TOL = 1e-2
"""L1 error of the judge in these tests: two small solutions of weak contact meet it."""
JUDGE = PhaseSpace(tol=TOL)
SAMPLING = MonteCarlo(paths=4096, relaxations=20.0, seed=3)
STIFF = (Contact(mass=2, side="both", stiffness=1e4, clearance=0.1),)
REFERENCES = ("phase-space", "montecarlo")


@pytest.fixture(scope="module")
def scene():
    """Fig. 8(a): weak contact, q2 alone."""
    return load_scene("fig8a")


def run(scene, system, *methods):
    curves = (replace(scene.curves[0], system=system),)
    return run_scene(replace(scene, curves=curves), methods)


def test_theories_and_simulation_are_held_against_the_full_equation(scene):
    outcome = run_scene(scene, [JUDGE, NonIntegrable(), Integrable(), SAMPLING])
    (answers,) = outcome.curves
    stated = answers["q2", "phase-space"].l1_error
    assert not outcome.problems and stated <= TOL
    pairs = {(c.a.label, c.b.label): c for c in answers.comparisons}
    for theory in ("nonintegrable/fem", "integrable/closed-form"):
        c = pairs["phase-space", theory]
        assert (c.measures, c.band) == ("averaging", None)
        # What theory and judge state, and what their tables add to that.
        assert stated <= c.error <= stated + 1e-6
    simulation = pairs["phase-space", "montecarlo"]
    assert simulation.measures == "sampling" and simulation.holds
    # Chance exceeds its expectation in the band, and the error of the judge is part of it.
    assert simulation.band > answers["q2", "montecarlo"].l1_error + stated
    # Averaging errors are shown by the answer that is known best.
    record = digest_of(outcome)
    rows = record["errors"][0]["averaging"]
    best = min(answers["q2", name].l1_error for name in REFERENCES)
    assert {row["theory"] for row in rows} == {"nonintegrable", "integrable"}
    assert all(row["reference"] in REFERENCES and row["error"] <= best + 1e-6 for row in rows)
    assert any(i["method"] == "phase-space" for i in record["identities"])


def test_a_simulation_of_another_system_does_not_pass(scene):
    """At the same tolerance stops ten percent off are seen."""
    stops = tuple(replace(c, stiffness=1.0) for c in scene.system.contacts)
    stiff = replace(scene.system, contacts=stops)
    results = [run(scene, stiff, JUDGE), run(scene, displaced(stiff), SAMPLING)]
    answers = Answers(stiff, tuple(r for outcome in results for r in outcome.curves[0].results))
    assert any("phase-space and montecarlo differ" in p for p in answers.problems)


def test_it_is_bounded_in_its_work_and_every_other_method_taken_as_it_is():
    system = load_scene("fig6a").system
    assert NonIntegrable().unasked(system) == NonIntegrable()
    alone, shared = (PhaseSpace(tol=1e-9).unasked(system, share=s) for s in (1.0, 0.25))
    assert alone.tol == PhaseSpace.tol and alone.work == UNASKED_WORK
    assert shared.work == 0.25 * UNASKED_WORK
    assert PhaseSpace(tol=0.05).unasked(system).accepted == 0.05


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        (load_scene("fig3a").system, "exact has the same density"),
        (System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02]), "linear has the same density"),
        (System([1] * 3, [1] * 3, [0.1] * 3, [0.01, 0.02, 0.03], contacts=STIFF), "by its name"),
        (load_scene("three-mass").system, "2 masses meet stops"),
    ],
)
def test_it_is_left_out_where_it_gains_nothing_or_takes_long(system, reason):
    with pytest.raises(NotApplicable, match=reason):
        PhaseSpace().unasked(system)


def test_what_is_left_out_is_shown_with_its_reason():
    for name, words in (("fig3a", "exact has the same density"), ("fig6a", None)):
        (row,) = [t for t in theories(load_scene(name)) if t["method"] == "phase-space"]
        assert row["applies"] and (row["left_out"] is words or words in row["left_out"])


def test_a_bound_of_the_work_leaves_it_out_or_certifies_what_is_reached_and_fails_nothing(scene):
    """Two small solutions know little of a stiff stop and light damping."""
    D, c = scene.system.noise_intensity, scene.system.damping
    light = replace(scene.system, contacts=STIFF, damping=0.01 * c, noise_intensity=0.01 * D)
    outcome = run(scene, light, PhaseSpace(work=1.0), NonIntegrable())
    (refusal,) = [r for r in outcome.curves[0].refused if r.route.method == "phase-space"]
    assert not refusal.failed and "an L1 error of" in refusal.reason
    assert "operations" in refusal.reason and not outcome.problems
    (curve,) = run_scene(load_scene("fig8b"), [PhaseSpace(work=1.0)]).curves
    density, (note,) = curve["q2"], curve.notes
    assert "phase-space: certified to" in note and density.certificate.certified
    assert PhaseSpace.tol < density.l1_error <= 1e-2
