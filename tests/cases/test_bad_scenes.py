"""What cannot be used is refused in one line: file, key, value and what would be right."""

import os
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cases.errors import BadInput
from cases.scene import load_scene

TERM = "[[damping_term]]\nj = 1\ncoefficient = 0.1\n"
BAD = [  # what is replaced, by what, and what the line must say
    ('title = "A scene"', 'titel = "A scene"', ["titel", '"A scene"', 'did you mean "title"']),
    ("stiffness       = [1", "stifness = [1", ["system.stifness", 'did you mean "stiffness"']),
    ("mass            = [1.0, 1.0]", "mass = [1.0]", ["system.stiffness", "1 entries"]),
    ("mass            = [1.0, 1.0]", "mass = [1.0, -1.0]", ["system.mass", "-1.0", "positive"]),
    ("mass            = [1.0, 1.0]", "mass = [1.0, true]", ["system.mass[2] = true", "number"]),
    ("mass            = [1.0, 1.0]", 'mass = "heavy"', ["system.mass", '"heavy"', "list"]),
    ("mass            = [1.0, 1.0]", "mass = []", ["system.mass = []", "at least 1"]),
    ("[0.08, 0.04]", "[0.08, -0.04]", ["system.damping", "does not dissipate"]),
    ("[0.08, 0.04]", "[[0.1, 0.0], [0.1]]", ["system.damping", "equal length"]),
    ("[0.08, 0.04]", "[[0.1, 0.3], [0.3, 0.1]]", ["system.damping", "does not dissipate"]),
    ("[0.01, 0.02]", "[[1, 2], [2, 1]]", ["noise_intensity", "positive semidefinite"]),
    ("[0.01, 0.02]", "[[1, 0.5], [0.2, 1]]", ["noise_intensity", "symmetric"]),
    ("[0.01, 0.02]", "[0.01]", ["noise_intensity", "2 entries"]),
    ("clearance = 0.5", "clearance = nan", ["contact[1].clearance = nan", "finite"]),
    ("clearance = 0.5", "clearance = inf", ["contact[1].clearance = inf", "finite"]),
    ("clearance = 0.5", "clearance = -0.5", ["contact[1].clearance = -0.5", ">= 0"]),
    ("clearance = 0.5", "clearance = 1e300", ["contact[1].clearance = 1e+300", "1e100"]),
    ("clearance = 0.5", "clearance = " + "9" * 400, ["contact[1].clearance", "digits"]),
    ("clearance = 0.5", "clearance = " + "9" * 5000, ["TOML"]),
    ("clearance = 0.5", "", ["contact[1].clearance is missing"]),
    ("clearance = 0.5", "clearance = 0.5\nclearance = 1", ["TOML", "line 15"]),
    ('side      = "both"', 'side = "Left"', ["contact[1].side", '"Left"', '"left"']),
    ("mass      = 2", "mass = 3", ["contact[1].mass = 3", "1 to 2"]),
    ("mass      = 2", "mass = 0", ["contact[1].mass = 0", "counted from 1"]),
    ("mass      = 2", "mass = 2.0", ["contact[1].mass = 2.0", "whole number"]),
    ("mass      = 2", 'mass = 2\nlaw = "hooke"', ["contact[1].law", '"hooke"', "hertz"]),
    ("mass      = 2", 'mass = 2\nlaw = "power"', ["contact[1].exponent", ">= 1"]),
    ("mass      = 2", "mass = 2\nexponent = 3", ["contact[1].exponent", "leave it out"]),
    ("[[contact]]", "[contact]", ["contact", "[[contact]]"]),
    ("[system]", "[sistem]", ["sistem", 'did you mean "system"']),
    ('"q2", "H"]', '"q2", "x2"]', ["observe.densities[2]", '"x2"', "q1..q2"]),
    ('"q2", "H"]', '"q2", "q3"]', ["observe.densities[2]", '"q3"', "q1..q2"]),
    ('"q2", "H"]', '"q2", "q2"]', ["observe.densities[2]", "twice"]),
    ("[observe]", "[vary]\nsystem.mass = [1]\n[observe]", ["vary.system.mass", "known"]),
    ("[observe]", "[vary]\ncontact.clearance = [-1]\n[observe]", ["vary.contact.clearance[1]"]),
    ("[observe]", "[[damping_term]]\ni = 1\n[observe]", ["damping_term[1].j is missing"]),
    ("[observe]", "[damping_term]\ni = 1\n[observe]", ["damping_term", "[[damping_term]]"]),
    ("[observe]", f"{TERM}i = 3\n[observe]", ["damping_term[1].i = 3", "use 1 to 2"]),
    ("[observe]", f"{TERM}i = 0\n[observe]", ["damping_term[1].i = 0", "counted from 1"]),
    ("[observe]", f"{TERM}i = 1\nq = {{ 3 = 2 }}\n[observe]", ["damping_term[1].q.3", "1 to 2"]),
    ("[observe]", f"{TERM}i = 1\nq = {{ 1 = 0 }}\n[observe]", ["damping_term[1].q.1 = 0", "power"]),
    ("[observe]", f"{TERM}i = 1\nv = {{ 1 = 0.5 }}\n[observe]", ["damping_term[1].v.1", "whole"]),
    ("[observe]", f"{TERM}i = 1\nenergy = -1\n[observe]", ["damping_term[1].energy = -1"]),
    ("[observe]", f"{TERM}i = 1\nenergy = 5\n[observe]", ["damping_term[1] = 10", "degree", "8"]),
    ("[observe]", f"{TERM}i = 1\nc = 5\n[observe]", ["damping_term[1].c", "known: i, j"]),
    ("[observe]", "[observe", ["TOML", "line 16"]),
    ("[observe]", "[expect]\nnon_gausian = 1\n[observe]", ["did you mean", "non_gaussian"]),
    ("[observe]", "[expect]\nof = 'p1'\n[observe]", ["expect.of", '"p1"', "q2, H"]),
    ("[observe]", "[expect]\nbetter = ['integrable', 'exact']\n[observe]", ["expect.better[2]"]),
    ("[observe]", "[expect]\nbetter = ['integrable']\n[observe]", ["expect.better", "at least 2"]),
    ("[observe]", "[expect]\nacceptable = ['x']\n[observe]", ["expect.acceptable[1]", '"x"']),
    ("[observe]", "[expect]\nclearance_rule = 0\n[observe]", ["clearance_rule = 0", "> 0"]),
    ("[observe]", "[expect]\nnon_gaussian = {}\n[observe]", ["exactly one of above"]),
    ("[observe]", "[expect]\nnon_gaussian = { beside = 1 }\n[observe]", ["beside", "known: above"]),
    ("[observe]", "[expect]\nnon_gaussian = { above = 1 }\n[observe]", ["[vary]"]),
    ("[observe]", "[expect]\nnonintegrable_better_with = 'B'\n[observe]", ["larger", "smaller"]),
    ("[observe]", "x = " + "[" * 5000 + "\n[observe]", ["nested too deeply"]),
]


def test_the_scene_itself_is_good(tmp_path, scene_text):
    path = tmp_path / "good.toml"
    path.write_text(scene_text)
    assert load_scene(str(path)).system.n == 2


@pytest.mark.parametrize(("old", "new", "words"), BAD, ids=[w[0][:24] + n[-12:] for _, n, w in BAD])
def test_a_bad_scene_is_refused_in_one_line(old, new, words, tmp_path, scene_text, fpk):
    assert len(BAD) >= 20
    assert scene_text.count(old) == 1
    path = tmp_path / "bad.toml"
    path.write_text(scene_text.replace(old, new))
    status, out, err = fpk("show", path)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1 and err.startswith("fpk: ") and "Traceback" not in err
    assert len(err) < 500
    for word in ["bad.toml", *words]:
        assert word in err


def _loop(path):
    path.symlink_to(path.name)


FILES = {
    "a folder": (lambda path: path.mkdir(), "is a folder"),
    "missing": (lambda path: None, "No such file"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "not UTF-8": (lambda path: path.write_bytes(b'title = "\xff"'), "not UTF-8"),
    "huge": (lambda path: path.write_bytes(b"#" * (2 << 20)), "1 MiB"),
    "symlink loop": (_loop, "cannot be read"),
    "a pipe": (os.mkfifo, "not a regular file"),
    "a NUL byte": (lambda path: path.write_bytes(b"\0"), "TOML"),
}


@pytest.mark.parametrize("kind", FILES)
def test_what_is_no_scene_file_is_refused(kind, tmp_path, fpk):
    make, words = FILES[kind]
    path = tmp_path / "odd.toml"
    make(path)
    status, out, err = fpk("show", path)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1 and "odd.toml" in err and words in err


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads everything")
def test_an_unreadable_file_is_refused(tmp_path, fpk):
    path = tmp_path / "odd.toml"
    path.touch(mode=0)
    assert fpk("show", path)[0] == 2


def test_names_that_are_no_paths(fpk):
    status, _, err = fpk("show", "fig6")
    assert status == 2 and 'did you mean "fig6' in err
    assert fpk("show", "no\nsuch\0scene.toml")[2].count("\n") == 1


def test_no_traceback_in_a_process_of_its_own(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("[system]\nmass = 1\n")
    command = [sys.executable, "-c", "from cases.cli import main; main()", "show", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1


VALUES = st.one_of(
    st.integers(), st.floats(), st.booleans(), st.text(max_size=8), st.just("{}"), st.just("[[]]")
)


def _loads_or_refuses(path, content):
    path.write_bytes(content)
    try:
        load_scene(str(path))
    except BadInput as error:
        assert "\n" not in str(error) and "any.toml" in str(error)


FUZZ = settings(
    max_examples=500, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@FUZZ
@given(content=st.binary(max_size=300))
def test_any_bytes_load_or_are_refused(content, tmp_path):
    _loads_or_refuses(tmp_path / "any.toml", content)


@FUZZ
@given(data=st.data())
def test_any_mutated_scene_loads_or_is_refused(data, tmp_path, scene_text):
    lines = scene_text.splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(lines) - 1))
        key = lines[i].partition("=")[0]
        kind = data.draw(st.sampled_from(["value", "delete", "double", "swap", "cut"]))
        if kind == "value":
            value = data.draw(VALUES)
            lines[i] = f"{key} = {str(value).lower() if isinstance(value, bool) else value}"
        elif kind == "delete":
            lines[i] = ""
        elif kind == "double":
            lines[i] += "\n" + lines[i]
        elif kind == "swap":
            j = data.draw(st.integers(0, len(lines) - 1))
            lines[i], lines[j] = lines[j], lines[i]
        else:
            lines[i] = lines[i][: data.draw(st.integers(0, len(lines[i])))]
    _loads_or_refuses(tmp_path / "any.toml", "\n".join(lines).encode("utf-8", "surrogatepass"))
