"""What cannot be used is refused in one line: file, key, value and what would be right."""

import os
import subprocess
import sys

import pytest

from cases.scene.errors import LONGEST, BadInput, misspelt
from cases.scene.scene import load_scene

TERM = "[[damping_term]]\nj = 1\ncoefficient = 0.1\n"
BAD = [  # what is replaced, by what, and what the line must say
    ('title = "A scene"', 'titel = "A scene"', ["titel", '"A scene"', 'did you mean "title"']),
    ("stiffness       = [1", "stifness = [1", ["system.stifness", 'did you mean "stiffness"']),
    ("stiffness       = [1", "stiffness_cubic = [1]\nstiffness = [1", ["known: mass", "scene.md"]),
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
    ("[observe]", "[observe]\nexceedance = [0.5]", ["observe.exceedance", "must be a table"]),
    ("[observe]", "[observe]\nexceedance.q2 = 0.5", ["observe.exceedance.q2", "must be a list"]),
    ("[observe]", "[observe]\nexceedance.q2 = []", ["observe.exceedance.q2", "at least 1"]),
    ("[observe]", "[observe]\nexceedance.q2 = [1, nan]", ["exceedance.q2[2] = nan", "finite"]),
    ("[observe]", "[observe]\nexceedance.q2 = [1, 1.0]", ["exceedance.q2[2] = 1.0", "twice"]),
    ("[observe]", "[observe]\nexceedance.q1 = [1]", ['"q1"', "add it to observe.densities"]),
    ("[observe]", "[observe]\nexceedance.x2 = [1]", ["observe.exceedance", '"x2"', "q1..q2"]),
    ("[observe]", '[observe]\nexceedance."q2,p2" = [1]', ["observe.exceedance", '"q2,p2"', "pair"]),
    ("[observe]", '[observe]\nexceedance."a\\nb" = [1]', ["observe.exceedance", "q1..q2"]),
    ("[observe]", '[observe]\nexceedance."a\\nb" = [nan]', ["observe.exceedance"]),
    ("[observe]", "[observe]\nexceedence.q2 = [1]", ["did you mean", '"exceedance"']),
    ("[observe]", f"[observe]\nexceedance.q2 = {[*range(13)]}", ["exceedance.q2", "most 12"]),
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
    ("[observe]", f"{TERM}i = 1\nenergy = 5\n[observe]", ["damping_term[1].degree = 10", "8"]),
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
    ("[observe]", "x = " + "[" * 40 + "]" * 40 + "\n[observe]", ["nested too deeply"]),
    ("[observe]", "[observe." + "a." * 40 + "a]\n[observe]", ["nested too deeply"]),
    ("[observe]", "a = { b = [true, 1979-05-27] }\n[observe]", ["{b = [true, 1979-05-27]}"]),
    ('"A scene"', '"A \\u001b[31m scene"', ["title", "U+001B", "leave it out"]),
    ('"A scene"', '"A \\u0000 scene"', ["title", "U+0000", "leave it out"]),
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


MEANT = [  # a word, the names there are, and the one that it is a misspelling of
    *((word, ["mass", "stiffness"], "stiffness") for word in ("stifness", "stiffnes", "siffness")),
    *((word, ["mass", "stiffness"], "stiffness") for word in ("stiffnses", "Stiffness")),
    *(
        (word, ["stiffness", "noise_gain"], None)
        for word in ("stiffness_cubic", "noise_correlation")
    ),
    ("damper", ["damping"], None),
    ("median", ["mean", "rms"], None),
    ("rm", ["rms"], "rms"),
    ("--dt", ["--at", "--tol"], None),
    ("--tme", ["--time"], "--time"),
    ("p", ["q", "v"], None),
]


@pytest.mark.parametrize(("word", "known", "meant"), MEANT, ids=[w for w, _, _ in MEANT])
def test_a_hint_is_for_a_misspelt_word_only(word, known, meant):
    assert misspelt(word, known) == meant


def test_no_hint_is_given_for_a_word_of_another_meaning(tmp_path, scene_text, fpk):
    path = tmp_path / "bad.toml"
    for key, remedy in (("noise_correlation", "here are known"), ("noise_gian", "did you mean")):
        path.write_text(scene_text.replace("[system]", f"[system]\n{key} = 1.0"))
        _, _, err = fpk("check", path)
        assert f"system.{key} = 1.0" in err and remedy in err
        assert ("did you mean" in err) == (key == "noise_gian")
    for given, hint in ((["run", "fig6a", "--secods", "1"], "--seconds"), (["densty"], "density")):
        assert f"Did you mean '{hint}'?" in fpk(*given)[2]
    for given in (["density", "fig6a", "--dz", "1"], ["run", "fig6a", "--paths", "1"]):
        assert "Did you mean" not in fpk(*given)[2]


def _loop(path):
    path.symlink_to(path.name)


FILES = {
    "a folder": (lambda path: path.mkdir(), "is a folder"),
    "missing": (lambda path: None, "No such file"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "not UTF-8": (lambda path: path.write_bytes(b'title = "\xff"'), "not UTF-8"),
    "huge": (lambda path: (path.touch(), os.truncate(path, 100 << 20)), "at most 1048576 (1 MiB)"),
    "endless": (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
    "UTF-16": (lambda path: path.write_text("title = 1", encoding="utf-16"), "save the file as"),
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
    assert err.count("\n") == 1 and err.count("odd.toml") == 1 and words in err


HOURS = {  # what took the parser, or this program's own reading, a time of n² or all the stack
    "a key of parts": "a." * 400_000 + "a = 1",
    "quoted parts": '",".' * 200_000 + '"" = 1',
    "a table of parts": "[" + "a." * 400_000 + "a]",
    "escapes": 'x = "' + '\\"' * 400_000,
    "quotes": "x = " + '"""' * 300_000,
    "tables within": "[a.b.c.d.e.f.g.h.i.j]\n" + "k.l.m.n.o.p.q = { a = 1 }\n",
}


@pytest.mark.parametrize("kind", HOURS)
def test_what_would_take_hours_is_refused_at_once(kind, tmp_path):
    path = tmp_path / "odd.toml"
    path.write_text(HOURS[kind])
    with pytest.raises(BadInput, match=r"nested too deeply|is not valid TOML"):
        load_scene(str(path))


def test_dots_in_text_are_no_keys_and_a_byte_order_mark_is_none(tmp_path, scene_text):
    path = tmp_path / "good.toml"
    dots = "a." * 50
    text = scene_text.replace("A scene", dots).replace("[system]", f"# {dots}\n[system]")
    path.write_text("\ufeff" + text, encoding="utf-8")
    scene = load_scene(str(path))
    assert scene.title == dots and scene.text == text
    path.write_text("\ufeff\ufeff" + text, encoding="utf-8")
    with pytest.raises(BadInput, match="line 1, column 1"):
        load_scene(str(path))


def test_nothing_but_the_scene_is_opened(tmp_path, scene_text):
    """No key of a scene names a file, and no text in it is taken for one or run."""
    words = "../../etc/passwd; __import__('os').system('true') $(true) file:///etc/passwd"
    path = tmp_path / "path.toml"
    path.write_text(scene_text.replace("A scene", words).replace("tests", words))
    load_scene(str(path))
    seen, watching = [], True

    def hook(event, arguments):
        watched = ("open", "exec", "compile", "import", "os.system", "subprocess.Popen", "socket")
        if watching and event.startswith(watched):
            seen.append((event, str(arguments[0])))

    sys.addaudithook(hook)
    try:
        scene = load_scene(str(path))
    finally:
        watching = False
    assert seen == [("open", str(path))] and scene.title == words


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads everything")
def test_an_unreadable_file_is_refused(tmp_path, fpk):
    path = tmp_path / "odd.toml"
    path.touch(mode=0)
    assert fpk("show", path)[0] == 2


def test_names_that_are_no_paths(fpk):
    status, _, err = fpk("show", "fig6")
    assert status == 2 and 'did you mean "fig6' in err
    assert fpk("show", "no\nsuch\0scene.toml")[2].count("\n") == 1
    for name in (
        "",
        " ",
        ".",
        "/",
        "~",
        "a" * 5000,
        "a/" * 3000 + ".toml",
        "/dev/zero",
        "\x1b[31m",
    ):
        status, out, err = fpk("show", name)
        assert (status, out) == (2, "") and err.count("\n") == 1 and len(err) < LONGEST + 10
        assert err.startswith("fpk: ") and err[:-1].isprintable()


NONSENSE = [
    *(("--tol", text) for text in ("", "nan", "inf", "-1", "0", "1", "1e400", "1e-300", "x")),
    *(("--seed", text) for text in ("", "-1", "1.5", "nan", "x", str(2**64), "9" * 5000)),
    *(("--threads", text) for text in ("-1", "0", "x", "9" * 400)),
    *(("--of", text) for text in ("", "Q2", "q0", "q3", "q2,q2", "q2\nx", "q" * 5000, "q²", "q٢")),
    *(("--at", text) for text in ("", "0:1:5", "0:1:0", "nan", "1e999", "0:1", ",", "9" * 5000)),
    *(("--method", text) for text in ("", "Exact", "a\nb", "x" * 5000)),
    *(("--solver", text) for text in ("", "FEM", "a\nb", "x" * 5000)),
]


@pytest.mark.parametrize(("option", "text"), NONSENSE, ids=[f"{o} {t[:12]}" for o, t in NONSENSE])
def test_an_option_without_sense_is_one_line(option, text, fpk):
    given = {"--method": "montecarlo", "--of": "q2", "--at": "0", option: text}
    status, out, err = fpk("density", "fig6a", *(word for pair in given.items() for word in pair))
    assert (status, out) == (2, "") and err.count("\n") == 1 and len(err) < LONGEST + 10
    assert err.startswith("fpk: ") and option.strip("-") in err and err[:-1].isprintable()


def test_no_traceback_in_a_process_of_its_own(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("[system]\nmass = 1\n")
    command = [
        sys.executable,
        "-c",
        "from cases.command.cli import main; main()",
        "show",
        str(path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1
