"""When to doubt an averaged number; the full equation as its judge, within bounds of its work."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_answers import displaced

import fpk as face
from averaging import Linear
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from averaging.phase_space.method import UNASKED_WORK, PhaseSpace
from cases.compare.answers import Answers
from cases.compare.doubt import averaging_notes, rms_ratios
from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.facts import theories
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import natural_modes
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

NOT_KNOWN = "averaging error not known here"


@pytest.fixture
def frame(written, scene_text):
    """Two storeys on a shaken base, the roof beside a neighbour."""
    for old, new in (
        ("[0.08, 0.04]", "[0.03, 0.03]"),
        ("[0.01, 0.02]", "[0.01]\nnoise_gain = [[1.0], [1.0]]"),
        ('"both"', '"right"'),
        ("clearance = 0.5", "clearance = 1.0"),
        ('["q2", "H"]', '["q2"]'),
    ):
        scene_text = scene_text.replace(old, new)
    return written(scene_text)


def note(scene, *methods, in_time=False):
    routes = [method_for(*name.split("/")).route for name in methods]
    notes = averaging_notes(load_scene(scene).system, [("x", routes, in_time)])
    return "".join(notes).removeprefix("x: ")


def test_there_is_a_note_where_averaging_errs_and_nothing_full_is_beside(frame):
    words = note(frame, "nonintegrable")
    assert words.startswith(NOT_KNOWN) and words.endswith(": doubt it")
    assert note(frame, "nonintegrable", "montecarlo") == ""
    assert note("fig3a", "nonintegrable") == ""  # (8) holds: it is exact
    assert NOT_KNOWN in note("fig3a", "nonintegrable", in_time=True)
    assert "doubt" not in note("sdof", "nonintegrable", in_time=True)
    assert note("fig6a", "integrable").endswith("a stop at 0.62 rms is left out: doubt it")
    assert note("vanderpol", "nonintegrable") == NOT_KNOWN  # no measure with damping terms


ONE = ("--method", "nonintegrable/closed-form")
CALLS = [
    ("show",),
    ("density", "--method", "nonintegrable", "--of", "q2", "--at", "0,1"),
    ("crossings", "--method", "nonintegrable", "--of", "q2", "--at", "1"),
    ("passage", "--method", "nonintegrable", "--limit", "H=3", "--times", "10"),
    ("transient", "--method", "nonintegrable", "--of", "H", "--times", "1", "--at", "0.1"),
    ("relaxation", "--method", "nonintegrable"),
    ("run", "--of", "q2", *ONE),
    ("sweep", "--vary", "contact[1].clearance=1,2", "--quantity", "rms(q2)"),
]


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call[0])
def test_every_command_says_it_in_text_and_json(call, frame, fpk, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    command, *options = call
    status, out, _ = fpk(command, frame, *options)
    assert status == 0 and out.count(NOT_KNOWN) == 1 and "energy averaging gives" in out
    (words,) = json.loads(fpk(command, frame, *options, "--json")[1])["averaging_notes"]
    assert f": {NOT_KNOWN}; without contacts" in words and words.endswith("doubt it")


def test_what_is_exact_says_nothing_and_reports_and_python_say_it_too(frame, fpk, answer, tmp_path):
    for method in ("exact", "nonintegrable"):
        call = ("density", "fig3a", "--method", method, "--of", "q2", "--at", "0")
        assert NOT_KNOWN not in fpk(*call)[1] and answer(*call)["averaging_notes"] == []
    assert fpk("run", frame, *ONE, "--out", tmp_path)[0] == 0
    assert (tmp_path / "report.html").read_text().count(NOT_KNOWN) >= 1
    answers = face.solve(load_scene(frame).system, ["q2"], methods=["nonintegrable"])
    (words,) = answers.averaging_notes
    assert words.startswith(f"q2: {NOT_KNOWN}") and NOT_KNOWN in answers._repr_html_()


def storeys(n, *, zeta=0.02):
    """Equal storeys on a shaken base, Rayleigh damping of ratio ``zeta`` in the first two modes."""
    ones = np.ones(n)
    bare = System(ones, ones, ones, ones)
    _, (first, second, *_) = natural_modes(bare)
    damping = 2.0 * zeta * (first * second * np.eye(n) + bare.stiffness_matrix) / (first + second)
    return System(ones, ones, damping, 0.01 * np.ones((n, n)))


def rms(method, system, name):
    (density,) = method.solve(system, [parse_observable(name, system.n)]).densities
    return density.rms()


def test_one_temperature_is_exact():
    """c/D is 4 for both masses: one temperature, by (8)."""
    system = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.02, 0.01])
    ratios, spread, damping = rms_ratios(system)
    assert [*ratios, spread] == pytest.approx([1.0] * 5, abs=1e-12)
    # Modes (1, φ) and (φ, -1) over √(1 + φ²) with φ = (1 + √5)/2 and ω = 1/φ, φ; c = 0.12, 0.04, 0.
    phi = (1.0 + 5.0**0.5) / 2.0
    first = (0.12 - 2.0 * 0.04 * phi + 0.04 * phi**2) / (1.0 + phi**2) / (2.0 / phi)
    second = (0.12 * phi**2 + 2.0 * 0.04 * phi + 0.04) / (1.0 + phi**2) / (2.0 * phi)
    assert damping == pytest.approx(max(first, second), rel=1e-12)


@pytest.mark.parametrize("n", [2, 5])
def test_the_ratio_is_that_of_the_two_methods(n):
    """Energy averaging of a shaken frame without contacts, over the Gaussian: 0.56 of 2, 0.20 of 5.

    Of light damping the ratio follows from the temperatures of the modes, which the load Σ_i φ_im
    of the base sets: θ_m = (Σ_i φ_im)² D/c_m.
    """
    system, name = storeys(n), f"q{n}"
    ratios, spread, _ = rms_ratios(system)
    ratio = rms(NonIntegrable(), system, name).value / rms(Linear(), system, name).value
    assert ratios[n - 1] == pytest.approx(ratio, rel=1e-9) and ratio < 0.6
    shapes, omega = natural_modes(system)
    c = np.diag(shapes.T @ system.damping @ shapes)
    theta = shapes.sum(axis=0) ** 2 * 0.01 / c
    own = shapes[-1] ** 2 / omega**2
    expected = np.sqrt(0.01 * n / c.sum() * np.sum(own) / np.sum(theta * own))
    assert ratio == pytest.approx(expected, rel=0.01)
    assert spread == pytest.approx(theta.max() / theta.min(), rel=0.2)  # couplings are left out


@pytest.mark.parametrize(("damping", "noise"), [([0.0], [0.1]), ([0.1], [0.0])])
def test_no_measure_where_it_would_mean_nothing(damping, noise):
    with pytest.raises(NotApplicable):
        rms_ratios(System([1.0], [1.0], damping, noise))


TOL = 1e-2
"""L1 error of the judge in these tests: two small solutions of weak contact meet it."""
JUDGE = PhaseSpace(tol=TOL)
SAMPLING = MonteCarlo(paths=4096, relaxations=20.0, seed=3)
STIFF = (Contact(mass=2, side="both", stiffness=1e4, clearance=0.1),)
REFERENCES = ("phase-space", "montecarlo")
WEAK = load_scene("fig8a")
"""Fig. 8(a): weak contact, q2 alone."""


def run(system, *methods):
    curves = (replace(WEAK.curves[0], system=system),)
    return run_scene(replace(WEAK, curves=curves), methods)


def test_theories_and_simulation_are_held_against_the_full_equation():
    outcome = run_scene(WEAK, [JUDGE, NonIntegrable(), Integrable(), SAMPLING])
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


def test_a_simulation_of_another_system_does_not_pass():
    """At the same tolerance stops ten percent off are seen."""
    stops = tuple(replace(c, stiffness=1.0) for c in WEAK.system.contacts)
    stiff = replace(WEAK.system, contacts=stops)
    results = [run(stiff, JUDGE), run(displaced(stiff), SAMPLING)]
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


def test_a_bound_of_the_work_leaves_it_out_or_certifies_what_is_reached_and_fails_nothing():
    """Two small solutions know little of a stiff stop and light damping."""
    D, c = WEAK.system.noise_intensity, WEAK.system.damping
    light = replace(WEAK.system, contacts=STIFF, damping=0.01 * c, noise_intensity=0.01 * D)
    outcome = run(light, PhaseSpace(work=1.0), NonIntegrable())
    (refusal,) = [r for r in outcome.curves[0].refused if r.route.method == "phase-space"]
    assert not refusal.failed and "an L1 error of" in refusal.reason
    assert "operations" in refusal.reason and not outcome.problems
    (curve,) = run_scene(load_scene("fig8b"), [PhaseSpace(work=1.0)]).curves
    density, (note,) = curve["q2"], curve.notes
    assert "phase-space: certified to" in note and density.certificate.certified
    assert PhaseSpace.tol < density.l1_error <= 1e-2
