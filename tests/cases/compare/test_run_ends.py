"""A run ends with what there is: defaults missed narrowly are noted, Ctrl-C loses no answer."""

import json
from dataclasses import dataclass, replace

import h5py
import numpy as np
import pytest

from averaging.nonintegrable import NonIntegrable
from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.text import rendered
from fpk.answer.certificate import Measured
from fpk.answer.density import certify_density
from fpk.answer.method import Method, Plan
from fpk.answer.names import parse_observable


@pytest.fixture(scope="module")
def scene():
    loaded = load_scene("fig3a")
    few = {"observables": (parse_observable("q2", 2),), "curves": loaded.curves[:2]}
    return replace(loaded, **few, expect=None)


@dataclass(frozen=True)
class Coarse(NonIntegrable):
    """Finite elements whose stated error is never below ``floor``, of a shifted density."""

    floor: float = 1.2e-10
    shift: float = 0.0

    def prepare(self, system):
        plan = super().prepare(system)

        def stated(d):
            return certify_density(
                d.observable,
                tuple(nodes + self.shift for nodes in d.panels),
                lambda x: d.pdf(x - self.shift),
                lambda x: d.pointwise(x - self.shift),
                measured=Measured(max(self.floor, d.l1_error), 0.0, 0.0, 0.0, 0.0),
                tol=self.tol_for(system),
            )

        def solve(observables, progress):
            result = plan.solve(observables, progress)
            return replace(result, method=self, densities=tuple(map(stated, result.densities)))

        return Plan(plan.refusal, solve)


EXACT = method_for("exact")


@pytest.mark.parametrize(("floor", "tol"), [(1.2e-10, 1e-9), (3e-7, 1e-6)])
def test_a_default_that_is_missed_is_a_note(scene, floor, tol):
    outcome = run_scene(scene, [EXACT, Coarse(floor=floor)], relax=True)
    assert not outcome.problems and all(map(len, outcome.curves))
    (note,) = outcome.curves[0].notes
    assert f"nonintegrable/fem: certified to {tol:.0e}," in note
    digest = digest_of(outcome)
    assert digest["notes"] == [note]
    shown = note.replace("nonintegrable/fem", "energy averaging, finite elements")
    assert shown in rendered("run.txt", {"digest": digest})


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


def test_a_tolerance_that_simulations_do_not_take_is_said(fpk):
    few = ("--of", "q2", "--method", "nonintegrable/closed-form", "--method", "montecarlo")
    status, out, _ = fpk("run", "fig3a", "--tol", "1e-6", "--seconds", "0.3", "--json", *few)
    (note,) = json.loads(out)["notes"]
    assert status in (0, 1) and "--tol 1e-06 is for the solvers" in note


def test_nothing_is_said_of_simulations_where_there_is_none(fpk):
    status, out, _ = fpk("run", "fig3a", "--tol", "1e-6", "--no-simulation", "--json")
    assert status == 0 and not json.loads(out)["notes"]


@dataclass(frozen=True)
class Interrupting(NonIntegrable):
    """Presses Ctrl-C while it solves."""

    def prepare(self, system):
        def solve(observables, progress):
            raise KeyboardInterrupt

        return Plan(lambda observable: None, solve)


def test_control_c_ends_a_run_with_the_answers_that_there_are(scene):
    methods = [EXACT, Interrupting(), NonIntegrable(solver="quadrature")]
    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, methods)
    first, second = run_scene(scene, methods, partial=True).curves
    assert [d for _, d in first] == ["exact"] and not len(second)
    (problem,) = first.problems
    assert "nonintegrable/fem failed: not finished: the program was interrupted" in problem


def test_the_fields_of_a_curve_are_saved_before_the_next_one(fpk, monkeypatch, tmp_path):
    """The second curve ends the process at once; what was saved then is on disk."""
    calls, solve = [], Method.solve

    def dying(method, *arguments, **settings):
        calls.append(method)
        if len(calls) == 2:
            raise SystemExit(130)
        return solve(method, *arguments, **settings)

    monkeypatch.setattr(Method, "solve", dying)
    monkeypatch.setattr("cases.compare.routes.all_methods", lambda **settings: (EXACT,))
    fpk("run", "fig3a", "--out", tmp_path)
    with h5py.File(tmp_path / "result.nc") as file:
        assert len(calls) == 2 and np.all(np.isfinite(file["p_q2"][0, 0]))


def test_control_c_is_answered_and_leaves_what_there_is(fpk, monkeypatch, tmp_path):
    methods = EXACT, Interrupting()
    monkeypatch.setattr("cases.compare.routes.all_methods", lambda **settings: methods)
    status, out, err = fpk("run", "fig3a", "--out", tmp_path, "--json")
    assert status == 1 and err.startswith("fpk: stopped; what there is follows")
    assert [m["applies"] for m in json.loads(out)["methods"]] == [True, False]
    assert (tmp_path / "result.nc").exists() and (tmp_path / "report.html").exists()
