"""What cannot be used is refused in one line: file, key, value and what would be right."""

import os
import sys

import numpy as np
import pytest

from cases.scene.errors import BadInput, misspelt
from cases.scene.points import parse_points
from cases.scene.scene import load_scene, shipped_scenes
from fpk.answer.names import observable_name

TERM = "[[damping_term]]\nj = 1\ncoefficient = 0.1\n"
MODULATION = "[modulation]\ntimes = [0, 10]\nfactor = "
UNITS = '[units]\nlength = "mm"\nmass = "kg"\n'
BAD = [  # what is replaced, by what, and what the line must say
    ('title = "A scene"', 'titel = "A scene"', ["titel", '"A scene"', 'did you mean "title"']),
    ("stiffness       = [1", "stifness = [1", ["system.stifness", 'did you mean "stiffness"']),
    ("stiffness       = [1", "stiffness_cubic = [1]\nstiffness = [1", ["known: mass", "scene.md"]),
    ("mass            = [1.0, 1.0]", "mass = [1.0]", ["system.stiffness", "1 entry, one per mass"]),
    ("mass            = [1.0, 1.0]", "mass = [1.0, true]", ["system.mass[2] = true", "number"]),
    ("mass            = [1.0, 1.0]", 'mass = "heavy"', ["system.mass", '"heavy"', "list"]),
    ("mass            = [1.0, 1.0]", "mass = []", ["system.mass = []", "at least 1"]),
    ("[0.08, 0.04]", "[0.08, -0.04]", ["system.damping", "does not dissipate"]),
    ("[0.08, 0.04]", "[[0.1, 0.0], [0.1]]", ["system.damping", "equal length"]),
    ("[0.01, 0.02]", "[[1, 2], [2, 1]]", ["noise_intensity", "positive semidefinite"]),
    ("[0.01, 0.02]", "[[1, 0.5], [0.2, 1]]", ["noise_intensity", "symmetric"]),
    ("clearance = 0.5", "clearance = nan", ["contact[1].clearance = nan", "finite"]),
    ("clearance = 0.5", "clearance = 1e300", ["contact[1].clearance = 1e+300", "1e100"]),
    ("clearance = 0.5", "clearance = " + "9" * 400, ["contact[1].clearance", "digits"]),
    ("clearance = 0.5", "clearance = " + "9" * 5000, ["TOML"]),
    ("clearance = 0.5", "", ["contact[1].clearance is missing"]),
    ("clearance = 0.5", "clearance = 0.5\nclearance = 1", ["TOML", "line 15"]),
    ('side      = "both"', 'side = "Left"', ["contact[1].side", '"Left"', '"left"']),
    ("mass      = 2", "mass = 3", ["contact[1].mass = 3", "1 to 2"]),
    ("mass      = 2", 'mass = 2\nlaw = "hooke"', ["contact[1].law", '"hooke"', "hertz"]),
    ("mass      = 2", 'mass = 2\nlaw = "power"', ["contact[1].exponent", ">= 1"]),
    ("mass      = 2", "mass = 2\nexponent = 3", ["contact[1].exponent", "leave it out"]),
    ("[[contact]]", "[contact]", ["contact", "[[contact]]"]),
    ("[system]", "[sistem]", ["sistem", 'did you mean "system"']),
    ('"q2", "H"]', '"q2", "q3"]', ["observe.densities[2]", '"q3"', "q1..q2"]),
    ('"q2", "H"]', '"q2", "q2"]', ["observe.densities[2]", "twice"]),
    ("[observe]", "[observe]\nexceedance = [0.5]", ["observe.exceedance", "must be a table"]),
    ("[observe]", "[observe]\nexceedance.q2 = [1, 1.0]", ["exceedance.q2[2] = 1.0", "twice"]),
    ("[observe]", "[observe]\nexceedance.q1 = [1]", ['"q1"', "add it to observe.densities"]),
    ("[observe]", '[observe]\nexceedance."q2,p2" = [1]', ["observe.exceedance", '"q2,p2"', "pair"]),
    ("[observe]", '[observe]\nexceedance."a\\nb" = [nan]', ["observe.exceedance"]),
    ("[observe]", f"[observe]\nexceedance.q2 = {[*range(13)]}", ["exceedance.q2", "most 12"]),
    ("[observe]", "[vary]\nsystem.mass = [1]\n[observe]", ["vary.system.mass", "known"]),
    ("[observe]", "[[damping_term]]\ni = 1\n[observe]", ["damping_term[1].j is missing"]),
    ("[observe]", f"{TERM}i = 3\n[observe]", ["damping_term[1].i = 3", "use 1 to 2"]),
    ("[observe]", f"{TERM}i = 1\nq = {{ 1 = 0 }}\n[observe]", ["damping_term[1].q.1 = 0", "power"]),
    ("[observe]", f"{TERM}i = 1\nv = {{ 1 = 0.5 }}\n[observe]", ["damping_term[1].v.1", "whole"]),
    ("[observe]", f"{TERM}i = 1\nenergy = 5\n[observe]", ["damping_term[1].degree = 10", "8"]),
    ("[observe]", f"{TERM}i = 1\nc = 5\n[observe]", ["damping_term[1].c", "known: i, j"]),
    ("[observe]", "[observe", ["TOML", "line 16"]),
    ("[observe]", "[expect]\nof = 'p1'\n[observe]", ["expect.of", '"p1"', "q2, H"]),
    ("[observe]", "[expect]\nbetter = ['integrable', 'exact']\n[observe]", ["expect.better[2]"]),
    ("[observe]", "[expect]\nbetter = ['integrable']\n[observe]", ["expect.better", "at least 2"]),
    ("[observe]", "[expect]\nclearance_rule = 0\n[observe]", ["clearance_rule = 0", "> 0"]),
    ("[observe]", "[expect]\nnon_gaussian = {}\n[observe]", ["exactly one of above"]),
    ("[observe]", "[expect]\nnon_gaussian = { above = 1 }\n[observe]", ["[vary]"]),
    ("[observe]", "[expect]\nnonintegrable_better_with = 'B'\n[observe]", ["larger", "smaller"]),
    ("[observe]", "x = " + "[" * 5000 + "\n[observe]", ["nested too deeply"]),
    ("[observe]", "a = { b = [true, 1979-05-27] }\n[observe]", ["{b = [true, 1979-05-27]}"]),
    ("[observe]", '[units]\nlength = "mm"\nmass = "kg"\n[observe]', ["units.time is missing"]),
    ("[observe]", f'{UNITS}time = "mm"\n[observe]', ["units", "something else"]),
    ("[observe]", f'{UNITS}time = "m/s"\n[observe]', ["units.time", "letters"]),
    ("[observe]", f'{UNITS}tiem = "s"\n[observe]', ["units.tiem", 'did you mean "time"']),
    ("[observe]", f'{UNITS}time = "s"\nforce = "N"\n[observe]', ["units.force", "here are known"]),
    ("[observe]", f"{MODULATION}[0.5, -0.9]\n[observe]", ["modulation.factor", "negative"]),
    ("[observe]", f"{MODULATION}[1.0]\n[observe]", ["modulation.factor", "one per time"]),
    ('"A scene"', '"A \\u001b[31m scene"', ["title", "U+001B", "leave it out"]),
    ("limit      =", "limt =", ["passage[1].limt", 'did you mean "limit"']),
    ('"H=1.5"', '"H=-1"', ["passage[1].limit", '"H=-1"', "> 0"]),
    ('"H=1.5"', "1.5", ["passage[1].limit = 1.5", "text in quotes"]),
    ("[1, 2.5]", "[2.5, 1]", ["passage[1].times = [2.5, 1", "ascend"]),
    ("[1, 2.5]", "[-1, 1]", ["passage[1].times", "0 or later"]),
    ("{ at_most = 0.1 }", "0.1", ["passage[1].rate_error = 0.1", "table"]),
    ('"q1=0.1,p2=0.2"', '"q1=10"', ["passage[2].start", "within the limit"]),
    ('"H1=0.4,H2=0.6"', '"q1>0.1"', ["passage[2].start", "within the limit q1>0.1"]),
    ('"H1=0.4,H2=0.6"', '"v2<0.5"', ["passage[2].start", "within the limit v2<0.5"]),
    ('"H1=0.4,H2=0.6"', '"H>1"', ["passage[2].limit", "use H=1.5"]),
    ('"H1=0.4,H2=0.6"', '"v1=-1"', ["passage[2].limit", "must be > 0"]),
    ('"q1=0.1,p2=0.2"', '"H=-1"', ["passage[2].start", "negative"]),
    ('"integrable"', '"exact"', ["passage[2].theory", '"nonintegrable"']),
    ('theory = "integrable"', "failure_error = { below = 1 }", ["passage[2].times is missing"]),
    ('of    = "q2"', 'of = "q2,p2"', ["transient[1].of", "one coordinate"]),
    ("times = [1.0]", "times = [0.0, 1.0]", ["transient[1].times", "> 0"]),
    ('"noise=0.5"', '"noise=-1"', ["transient[1].start", "negative"]),
    ("[[transient]]", "[[passage]]\nlimit='H=1'\n" * 4 + "[[transient]]", ["passage", "at most 4"]),
]
QUESTIONS = """
[[passage]]
limit      = "H=1.5"
times      = [1, 2.5]
rate_error = { at_most = 0.1 }

[[passage]]
limit  = "H1=0.4,H2=0.6"
start  = "q1=0.1,p2=0.2"
theory = "integrable"

[[transient]]
of    = "q2"
start = "noise=0.5"
times = [1.0]
"""


@pytest.mark.parametrize(("old", "new", "words"), BAD, ids=[w[0][:24] + n[-12:] for _, n, w in BAD])
def test_a_bad_scene_is_refused_in_one_line(old, new, words, written, scene_text, refusal):
    good = scene_text + QUESTIONS
    assert good.count(old) == 1
    err = refusal("show", written(good.replace(old, new)))
    assert len(err) < 500 and all(word in err for word in ("any.toml", *words)), err


def test_questions_are_read_and_shipped_scenes_in_time_ask_something(written, scene_text):
    scene = load_scene(written(scene_text + QUESTIONS))
    energy, either = scene.passages
    (transient,) = scene.transients
    assert (energy.name, energy.times) == ("H=1.5 from rest", (1.0, 2.5))
    assert energy.theory == "nonintegrable" and tuple(energy.rate_error) == ("at_most", 0.1)
    assert (either.name, either.times) == ("H1=0.4 or H2=0.6 from q1=0.1,p2=0.2", ())
    assert (observable_name(transient.of), str(transient.start)) == ("q2", "noise=0.5")
    scenes = [load_scene(n) for n, path in shipped_scenes().items() if path.parent.name == "time"]
    assert len(scenes) >= 4
    for scene in scenes:
        assert scene.passages or scene.transients, scene.name
        assert all(p.rate_error or p.failure_error for p in scene.passages[:1]), scene.name


MEANT = [  # a word, the names there are, and the one that it is a misspelling of
    *((word, "stiffness") for word in ("stifness", "siffness", "stiffnses", "Stiffness")),
    *((word, None) for word in ("stiffness_cubic", "noise_correlation", "damper", "median", "v")),
    ("rm", "rms"),
    ("--tme", "--time"),
    ("--dt", None),
]


@pytest.mark.parametrize(("word", "meant"), MEANT, ids=[w for w, _ in MEANT])
def test_a_hint_is_for_a_misspelt_word_only(word, meant):
    known = ["mass", "stiffness", "noise_gain", "damping", "mean", "rms", "--at", "--time", "q"]
    assert misspelt(word, known) == meant


FILES = {
    "a folder": (lambda path: path.mkdir(), "is a folder"),
    "missing": (lambda path: None, "No such file"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "not UTF-8": (lambda path: path.write_bytes(b'title = "\xff"'), "not UTF-8"),
    "huge": (lambda path: (path.touch(), os.truncate(path, 100 << 20)), "at most 1048576 (1 MiB)"),
    "endless": (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
    "UTF-16": (lambda path: path.write_text("title = 1", encoding="utf-16"), "save the file as"),
    "symlink loop": (lambda path: path.symlink_to(path.name), "cannot be read"),
    "a pipe": (os.mkfifo, "not a regular file"),
    "a NUL byte": (lambda path: path.write_bytes(b"\0"), "TOML"),
}


@pytest.mark.parametrize("kind", FILES)
def test_what_is_no_scene_file_is_refused(kind, tmp_path, refusal):
    make, words = FILES[kind]
    path = tmp_path / "odd.toml"
    make(path)
    err = refusal("show", path)
    assert err.count("odd.toml") == 1 and words in err


HOURS = {  # what took the parser, or this program's own reading, a time of n² or all the stack
    "a key of parts": "a." * 400_000 + "a = 1",
    "quoted parts": '",".' * 200_000 + '"" = 1',
    "a table of parts": "[" + "a." * 400_000 + "a]",
    "escapes": 'x = "' + '\\"' * 400_000,
    "quotes": "x = " + '"""' * 300_000,
    "tables within": "[a.b.c.d.e.f.g.h.i.j]\n" + "k.l.m.n.o.p.q = { a = 1 }\n",
}


@pytest.mark.parametrize("kind", HOURS)
def test_what_would_take_hours_is_refused_at_once(kind, written):
    with pytest.raises(BadInput, match=r"nested too deeply|is not valid TOML"):
        load_scene(str(written(HOURS[kind])))


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


def test_ranges_reach_their_end_and_what_is_no_list_of_points_is_refused():
    (x,) = parse_points("-1.5:1.5:0.1", 1)
    assert x.size == 31 and x[-1] == 1.5 and 0.0 in x and 0.3 in x
    assert parse_points("-1,0,0.3", 1)[0].tolist() == [-1.0, 0.0, 0.3]
    assert parse_points("1:0:-0.5", 1)[0].tolist() == [1.0, 0.5, 0.0]
    q, p = parse_points("-1:1:1 x 0,0.5", 2)
    assert q.tolist() == [-1, -1, 0, 0, 1, 1] and np.array_equal(p, [0, 0.5] * 3)
    texts = "", "a", "1:2", "1:2:0", "1:2:-1", "0:1e9:1e-9", "nan", "inf", "1e999", "1,,2", "1 x 2"
    for text in (*texts, "0:1:1e-99999999"):
        with pytest.raises(BadInput, match="--at"):
            parse_points(text, 1)
    with pytest.raises(BadInput, match="two lists"):
        parse_points("1,2", 2)
