"""An averaged number without one of the full system beside it says when to doubt it."""

import json

import numpy as np
import pytest

import fpk as face
from averaging import Linear, NonIntegrable
from cases.compare.doubt import averaging_notes, rms_ratios
from cases.compare.routes import method_for
from cases.scene.scene import load_scene
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.linear import natural_modes
from fpk.system.system import System

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
