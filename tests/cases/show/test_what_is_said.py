"""What texts, reports and JSON say of the equation solved, of routes that give up, of tails."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from averaging import Integrable, NonIntegrable
from averaging.phase_space.method import PhaseSpace
from cases.compare.doubt import TAIL_FACTOR, tails_off
from cases.compare.routes import method_for
from cases.scene.scene import load_scene
from fpk.answer.certificate import Measured, certify, tolerance
from fpk.answer.method import ROUTES
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable

IN_TIME = '[[passage]]\nlimit = "H=0.4"\ntimes = [5.0, 20.0]\n'


@pytest.fixture
def scene(tmp_path, scene_text):
    path = tmp_path / "scene.toml"
    path.write_text(scene_text.replace("[observe]", IN_TIME + "[observe]"))
    return path


def test_a_run_says_which_equation_each_route_solves_and_what_is_not_known(
    scene, fpk, tmp_path, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "120")
    out = tmp_path / "out"
    averaged = ("--no-simulation", "--method", "nonintegrable", "--out", out)
    status, text, _ = fpk("run", scene, *averaged)
    assert status == 0 and text.count("equation solved") == 2
    assert "full" not in {
        word for row in text.splitlines() if "solved" in row for word in row.split()
    }
    lines = text.splitlines()
    k = next(k for k, line in enumerate(lines) if "P(T ≤ 5)" in line)
    head, row = lines[k], lines[k + 1]
    assert "equation" in head and "P(T ≤ 20)" in head and row.count("averaged") == 1
    page = (out / "report.html").read_text()
    assert "of an averaged equation: energy averaging" in page and "P(T ≤ 5)" in page
    assert "the averaging error is unknown" in page.partition('id="quantities"')[0]
    assert "Rms q2" in page and "impact rate, " in page and "by t = 5, " in page
    record = json.loads(fpk("run", scene, *averaged[:3], "--json")[1])
    assert {row["solves"] for row in record["quantities"]} == {"averaged"}
    assert record["averaging_unknown"] == ["q2", "H", "H=0.4 from rest"]


def test_a_route_that_gives_up_is_named_with_its_reason(scene, fpk, tmp_path, monkeypatch):
    def out_of_reach(*_, **__):
        raise NotApplicable("an error of 0.5 was reached: out of reach")

    monkeypatch.setattr(PhaseSpace, "solve", out_of_reach)
    out = tmp_path / "out"
    status, text, _ = fpk("run", scene, "--no-simulation", "--out", out)
    words = "an error of 0.5 was reached: out of reach"
    assert status == 0 and f"full FPK equation: gave up (q2): {words}" in text
    first, rest = (out / "report.html").read_text().split('id="quantities"')
    assert f"full FPK equation gave up on q2: {words}" in first and f"gave up: {words}" in rest
    record = json.loads(fpk("run", scene, "--no-simulation", "--json")[1])
    (row,) = (m for m in record["methods"] if not m["applies"] and m["gave_up"])
    assert (row["method"], row["reason"], row["failed"]) == ("phase-space", words, False)


def test_a_default_tolerance_that_is_missed_is_loosened_as_in_a_run(scene, fpk, monkeypatch):
    question = "passage", scene, "--method", "nonintegrable", "--limit", "H=0.4"
    asked = []

    def passage(self, *arguments, tol, **how):
        asked.append(tol)
        answer = own(self, *arguments, tol=tol, **how)
        measured = replace(answer.certificate, l1_error=3e-5)
        known = {k: v for k, v in vars(measured).items() if k in Measured.__dataclass_fields__}
        stated = certify(Measured(**{**known, "failures": ()}), tol=tolerance(tol, 1e-5))
        return replace(answer, certificate=stated)

    own = NonIntegrable.passage
    monkeypatch.setattr(NonIntegrable, "passage", passage)
    status, text, _ = fpk(*question)
    assert (status, asked) == (0, [None, 1e-4])
    assert "# certified to 1e-04, as the default tolerance could not be met" in text
    assert fpk(*question, "--tol", "1e-5")[0] == 1


def test_a_tail_that_is_off_by_a_factor_is_found_and_one_that_is_right_is_not():
    system = load_scene("fig6a").system
    observable = parse_observable("q2", system.n)
    averaged = Integrable().solve(system, [observable]).densities[0]
    full, theory = ROUTES["exact", "closed-form"], Integrable().route
    std = averaged.std().value
    for factor, off in ((1.0, False), (0.75, True)):
        narrow = replace(
            averaged, pdf=lambda q, s=factor * std: stats.norm.pdf(q, scale=s), l1_error=1e-12
        )
        rows = list(tails_off({full: narrow, theory: averaged}))
        assert bool(rows) == off
    (row,) = rows
    level = abs(row["level"]) / std
    assert row["probability"] == pytest.approx(1e-6, rel=1e-6)
    assert row["ratio"] == pytest.approx(stats.norm.sf(level) / 1e-6, rel=1e-6)
    assert row["ratio"] > TAIL_FACTOR and row["reference"] == "exact"
    assert np.isfinite(row["error"]) and method_for("exact").route == full
