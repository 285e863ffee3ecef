"""An averaged number without one of the full system beside it says when to doubt it."""

import json

import pytest

import fpk as face
from cases.compare.doubt import averaging_notes
from cases.compare.routes import method_for
from cases.scene.scene import load_scene

NOT_KNOWN = "averaging error not known here"
FRAME = """[system]
mass = [1.0, 1.0]
stiffness = [1.0, 1.0]
damping = [0.03, 0.03]
noise_intensity = [0.01]
noise_gain = [[1.0], [1.0]]
[[contact]]
mass = 2
side = "right"
stiffness = 10.0
clearance = 1.0
[observe]
densities = ["q2"]
"""
"""Two storeys on a shaken base, the roof beside a neighbour."""


@pytest.fixture
def frame(tmp_path):
    path = tmp_path / "frame.toml"
    path.write_text(FRAME)
    return path


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
    record = json.loads(fpk(command, frame, *options, "--json")[1])
    (words,) = record["averaging_notes"]
    assert f": {NOT_KNOWN}; without contacts" in words and words.endswith("doubt it")


def test_what_is_exact_or_full_says_nothing(fpk):
    for method in ("exact", "nonintegrable"):
        call = ("density", "fig3a", "--method", method, "--of", "q2", "--at", "0")
        status, out, _ = fpk(*call)
        assert status == 0 and NOT_KNOWN not in out
        assert json.loads(fpk(*call, "--json")[1])["averaging_notes"] == []


def test_reports_and_python_say_it_too(frame, fpk, tmp_path):
    assert fpk("run", frame, *ONE, "--out", tmp_path)[0] == 0
    assert (tmp_path / "report.html").read_text().count(NOT_KNOWN) >= 1
    answers = face.solve(load_scene(frame).system, ["q2"], methods=["nonintegrable"])
    (words,) = answers.averaging_notes
    assert words.startswith(f"q2: {NOT_KNOWN}") and NOT_KNOWN in answers._repr_html_()
