"""A run says what is wrong, and blames no answer for what another one is wrong about."""

import json
from dataclasses import dataclass, replace

import pytest

from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.text import rendered, verdict_of
from fpk.answer.certificate import Measured
from fpk.answer.density import certify_density
from fpk.answer.method import Plan
from fpk.answer.names import parse_observable


def shifted(density, shift, tol):
    """The density moved by ``shift``, certified where ``tol`` allows its error."""
    measured = Measured(density.l1_error, 0.0, 0.0, 0.0, 0.0)
    panels = tuple(nodes + shift for nodes in density.panels)
    pdf, pointwise = density.pdf, density.pointwise
    return certify_density(
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


UNDAMPED = """[system]
mass = [1.0]
stiffness = [1.0]
damping = [0.0]
noise_intensity = [0.05]
[[passage]]
limit = "H=0.3"
times = [10.0]
"""
"""Under noise alone E H = D t: H first passes 0.3 after 0.3/D = 6 in the mean (Dynkin)."""
ASKED = '[observe]\ndensities = ["{}"]\n'
UNANSWERED = "no stationary density: some motion is not damped"


def outcome_of(path, text, *methods):
    path.write_text(text)
    outcome = run_scene(load_scene(path), [method_for(name) for name in methods])
    return outcome, digest_of(outcome)


def test_a_question_in_time_is_answered_where_nothing_is_stationary(tmp_path):
    """That no stationary density exists is said once where one is asked for, and fails no check."""
    path = tmp_path / "undamped.toml"
    for text, notes in ((UNDAMPED + ASKED.format("q1"), [UNANSWERED]), (UNDAMPED, [])):
        outcome, digest = outcome_of(path, text, "exact", "linear", "phase-space")
        assert not outcome.problems and verdict_of(digest).endswith("every certificate holds")
        assert [note.split(":")[:2] for note in digest["notes"]] == [n.split(":") for n in notes]
        shown = rendered("run.txt", {"digest": digest, "details": False})
        assert shown.count("not damped") == len(notes)
        (answer,) = digest["passages"][0]["answers"]
        assert answer["mean"] == pytest.approx(6.0, abs=answer["mean_error"])


def test_a_density_that_exists_and_no_route_gives_is_a_problem_where_it_is_asked_for(tmp_path):
    path, damped = tmp_path / "damped.toml", UNDAMPED.replace("[0.0]", "[0.1]")
    outcome, _ = outcome_of(path, damped + ASKED.format("H"), "phase-space")
    (problem,) = outcome.problems
    assert problem.startswith("H: no route gives its stationary density; ")
    # Not asked for: the default densities of a scene of questions in time.
    outcome, _ = outcome_of(path, damped, "phase-space")
    assert not outcome.problems and outcome.curves[0].answered


def test_commands_on_a_system_without_a_stationary_state(fpk, tmp_path):
    path = tmp_path / "undamped.toml"
    path.write_text(UNDAMPED + ASKED.format("q1"))
    status, out, err = fpk("run", path, "--method", "phase-space")
    assert (status, err) == (0, "") and "every certificate holds" in out
    status, _, err = fpk("run", path, "--of", "q1", "--no-simulation")
    assert status == 1 and err.count("\n") == 1 and err.count("not damped") == 1
    status, _, err = fpk("export", path, "--out", tmp_path / "p.nc")
    assert status == 2 and err.count("\n") == 1
    status, out, _ = fpk("check", path)
    assert status == 0 and out.count("not damped") == 1
    assert "in time  H=0.3 from rest: fpk run says which methods answer" in out
    record = json.loads(fpk("check", path, "--json")[1])
    assert record["applies"] == [] and "not damped" in record["stationary_refusal"]
    assert record["questions"] == ["H=0.3 from rest"]


@pytest.mark.slow  # the simulation of ten thousand paths, and the equation for a displacement
def test_first_passage_of_an_undamped_displacement(fpk, tmp_path):
    """Mean 10.805 and P(T <= 10) = .577353, by the backward equation solved outside."""
    path = tmp_path / "undamped.toml"
    path.write_text(UNDAMPED.replace("H=0.3", "q1=0.8") + ASKED.format("q1"))
    status, out, err = fpk("run", path, "--json")
    record = json.loads(out)
    assert (status, record["problems"], len(record["notes"])) == (0, [], 1), err
    answers = {a["route"]: a for a in record["passages"][0]["answers"]}
    assert set(answers) == {"phase-space", "montecarlo"}
    solved = answers["phase-space"]
    assert solved["mean"] == pytest.approx(10.805, abs=5e-4 + solved["mean_error"])
    assert solved["failure"][0] == pytest.approx(0.577353, abs=5e-7 + solved["failure_error"][0])
