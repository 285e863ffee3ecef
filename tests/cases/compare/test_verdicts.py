"""What a run says is wrong and of whom, what it notes, and what it leaves when it is stopped."""

import json
from dataclasses import replace
from typing import get_args

import h5py
import numpy as np
import pytest
from made_answers import Coarse, DisplacedAveraging, Interrupting, Shifted
from systems import ONE_MASS

from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from cases.compare.claims import Verdict
from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene, shipped_scenes
from cases.show.digest import digest_of
from cases.show.text import render, verdict_of
from fpk.answer.method import Method
from fpk.answer.names import parse_observable

EXACT = Exact()
SAMPLED = method_for("montecarlo", paths=4096, relaxations=20.0)


@pytest.fixture(scope="module")
def scene():
    """Fig. 3(a), of two curves and q2 alone: exact, and energy averaging is exact, too."""
    loaded = load_scene("fig3a")
    few = {"observables": (parse_observable("q2", 2),), "curves": loaded.curves[:2]}
    return replace(loaded, **few, expect=None)


@pytest.fixture
def only(monkeypatch):
    """Let commands know these methods alone."""

    def know(*methods):
        monkeypatch.setattr("cases.compare.routes.all_methods", lambda **_: methods)

    return know


def test_a_wrong_answer_is_named_where_two_independent_ones_agree(scene):
    first = replace(scene, curves=scene.curves[:1])
    problems = run_scene(first, [Shifted(), NonIntegrable(), SAMPLED]).problems
    assert len(problems) == 2 and all("differ" in p for p in problems)
    (of_sample,) = [p for p in problems if "exact and montecarlo" in p]
    assert "montecarlo agrees with nonintegrable/fem" in of_sample
    (problem,) = run_scene(first, [Shifted(), SAMPLED]).problems  # two alone: neither is blamed
    assert "exact and montecarlo differ" in problem and "agrees" not in problem
    # An answer that is not certified is the one in doubt.
    methods = [Shifted(judged_by=1e-16), NonIntegrable(), SAMPLED]
    differing = [p for p in run_scene(first, methods).problems if "differ" in p]
    assert len(differing) == 2
    assert all("exact is not certified" in p and "no finding against" in p for p in differing)
    assert any("no finding against montecarlo" in p for p in differing)


UNDAMPED = f"""{ONE_MASS.format(1.0, 1.0, 0.0, 0.05)}
[[passage]]
limit = "H=0.3"
times = [10.0]
"""
"""Under noise alone E H = D t: H first passes 0.3 after 0.3/D = 6 in the mean (Dynkin)."""
ASKED = '[observe]\ndensities = ["{}"]\n'
UNANSWERED = "no stationary density: some motion is not damped"


def outcome_of(path, *methods):
    return run_scene(load_scene(path), [method_for(name) for name in methods])


def test_a_question_in_time_is_answered_where_nothing_is_stationary(written):
    """That no stationary density exists is said once where one is asked for, and fails no check."""
    for text, notes in ((UNDAMPED + ASKED.format("q1"), [UNANSWERED]), (UNDAMPED, [])):
        outcome = outcome_of(written(text), "exact", "linear", "phase-space")
        digest = digest_of(outcome)
        assert not outcome.problems and verdict_of(digest).endswith("every certificate holds")
        assert [note.split(":")[:2] for note in digest["notes"]] == [n.split(":") for n in notes]
        shown = render("run.txt", {"digest": digest, "details": False})
        assert shown.count("not damped") == len(notes)
        (answer,) = digest["passages"][0]["answers"]
        assert answer["mean"] == pytest.approx(6.0, abs=answer["mean_error"])


def test_a_density_that_exists_and_no_route_gives_is_a_problem_where_it_is_asked_for(written):
    damped = UNDAMPED.replace("[0.0]", "[0.1]")
    (problem,) = outcome_of(written(damped + ASKED.format("H")), "phase-space").problems
    assert problem.startswith("H: no route gives its stationary density; ")
    # Not asked for: the default densities of a scene of questions in time.
    outcome = outcome_of(written(damped), "phase-space")
    assert not outcome.problems and outcome.curves[0].answered


def test_commands_where_no_route_gives_a_stationary_density(
    fpk, answer, refusal, written, scene_text
):
    path = written(UNDAMPED + ASKED.format("q1"))
    status, out, err = fpk("run", path, "--method", "phase-space")
    assert (status, err) == (0, "") and "every certificate holds" in out
    status, _, err = fpk("run", path, "--of", "q1", "--no-simulation")
    assert status == 1 and err.count("\n") == 1 and err.count("not damped") == 1
    refusal("export", path, "--out", path.with_name("p.nc"))
    status, out, _ = fpk("check", path)
    assert status == 0 and out.count("not damped") == 1
    assert "in time  H=0.3 from rest: fpk run says which methods answer" in out
    record = answer("check", path)
    assert record["applies"] == [] and "not damped" in record["stationary_refusal"]
    assert record["questions"] == ["H=0.3 from rest"]
    quiet = written(scene_text.replace("[0.01, 0.02]", "[0.0, 0.0]"))
    status, out, err = fpk("run", quiet)
    assert status == 1 and "no route applies" in err and "every check holds" not in out
    status, out, err = fpk("run", quiet, "--json")
    assert status == 1 and any("no route applies" in p for p in json.loads(out)["problems"])


def test_a_default_that_is_missed_is_a_note(scene):
    outcome = run_scene(scene, [EXACT, Coarse(floor=3e-7)], relax=True)
    assert not outcome.problems and all(map(len, outcome.curves))
    (note,) = outcome.curves[0].notes
    assert "nonintegrable/fem: certified to 1e-06," in note
    digest = digest_of(outcome)
    assert digest["notes"] == [note]
    shown = note.replace("nonintegrable/fem", "energy averaging, finite elements")
    assert shown in render("run.txt", {"digest": digest})


@pytest.mark.parametrize(
    ("method", "relax", "words"),
    [
        (Coarse(), False, "exceeds the tolerance 1e-10"),  # a tolerance that was asked for
        (Coarse(floor=1.2e-4), True, "exceeds the tolerance 1e-10"),
        (Coarse(shift=1e-8), True, "differ by"),
    ],
)
def test_what_was_asked_for_and_what_contradicts_is_a_problem(scene, method, relax, words):
    outcome = run_scene(scene, [EXACT, method], relax=relax)
    assert any(words in problem for problem in outcome.problems)


def test_a_tolerance_that_simulations_do_not_take_is_said_where_there_are_some(fpk, answer):
    few = ("--of", "q2", "--method", "nonintegrable/closed-form")
    sampled = ("--method", "montecarlo", "--seconds", "0.3", "--json")
    status, out, _ = fpk("run", "fig3a", "--tol", "1e-6", *few, *sampled)
    (note,) = json.loads(out)["notes"]
    assert status in (0, 1) and "--tol 1e-06 is for the solvers" in note
    assert not answer("run", "fig3a", "--tol", "1e-6", *few)["notes"]


def test_control_c_ends_a_run_with_the_answers_that_there_are(scene, fpk, only, tmp_path):
    methods = [EXACT, Interrupting(), NonIntegrable(solver="quadrature")]
    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, methods)
    first, second = run_scene(scene, methods, partial=True).curves
    assert [d for _, d in first] == ["exact"] and not len(second)
    (problem,) = first.problems
    assert "nonintegrable/fem failed: not finished: the program was interrupted" in problem
    only(EXACT, Interrupting())
    status, out, err = fpk("run", "fig3a", "--out", tmp_path, "--json")
    assert status == 1 and err.startswith("fpk: stopped; what there is follows")
    assert [m["applies"] for m in json.loads(out)["methods"]] == [True, False]
    assert (tmp_path / "result.nc").exists() and (tmp_path / "report.html").exists()


def test_the_fields_of_a_curve_are_saved_before_the_next_one(fpk, only, monkeypatch, tmp_path):
    """The second curve ends the process at once; what was saved then is on disk."""
    calls, solve = [], Method.solve

    def dying(method, *arguments, **settings):
        calls.append(method)
        if len(calls) == 2:
            raise SystemExit(130)
        return solve(method, *arguments, **settings)

    monkeypatch.setattr(Method, "solve", dying)
    only(EXACT)
    fpk("run", "fig3a", "--out", tmp_path)
    with h5py.File(tmp_path / "result.nc") as file:
        assert len(calls) == 2 and np.all(np.isfinite(file["p_q2"][0, 0]))


KEYS = {"scene", "curves", "judged", "certificates", "problems", "claims", "seconds", "holds"}


def test_the_gate_holds_on_shipped_scenes(answer):
    record = answer("verify", "fig3c", "sdof", "--coarse", "--seed", 7)
    assert record.keys() == {"schema", "scenes", "holds", "claims", "seconds"} and record["holds"]
    assert [s["scene"] for s in record["scenes"]] == ["fig3c", "sdof"]
    for scene in record["scenes"]:
        assert scene.keys() == KEYS and scene["judged"] > 0 and scene["certificates"] > 0
    assert list(record["claims"]) == [v.replace(" ", "_") for v in get_args(Verdict)]
    assert record["claims"]["does_not_hold"] >= 2  # h = 10 and 20 of Fig. 3(c) are not Gaussian


def test_the_gate_fails_on_a_wrong_system_and_where_nothing_is_judged(fpk, only):
    only(EXACT, DisplacedAveraging())
    status, out, err = fpk("verify", "fig3a", "sdof")
    lines = out.splitlines()
    assert status == 1 and "differ by L1" in err and "FAIL" in lines[0]
    assert lines[0].startswith("fig3a") and lines[1].startswith("sdof")
    assert lines[-1] == "fails: fig3a, sdof" and sum("every scene" in x for x in lines) == 1
    only(NonIntegrable())
    status, _, err = fpk("verify", "fig6a")
    assert status == 1 and "no comparison was judged" in err


@pytest.mark.slow
def test_every_shipped_scene_holds(fpk):
    status, out, err = fpk("verify")
    assert (status, err) == (0, "")
    gated = [name for name, path in shipped_scenes().items() if path.parent.name != "hard"]
    assert all(any(x.startswith(name) for x in out.splitlines()) for name in gated)


def test_a_scene_whose_simulation_would_take_too_long_is_cut_and_says_so(fpk, monkeypatch):
    monkeypatch.setattr("cases.command.studies.VERIFY_SECONDS", 1e-3)
    status, out, err = fpk("verify", "sdof", "--json")
    assert status == 1 and not json.loads(out)["holds"]
    assert "simulation" in err and "the limit of 0.001 s came" in err
