"""Tables about motion in time: read, refused in one line, and shipped scenes that use them."""

import pytest

from cases.scene.errors import BadInput
from cases.scene.scene import load_scene, shipped_scenes
from fpk.answer.names import observable_name

GOOD = """
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

BAD = [  # what is replaced, by what, and what the line must say
    ("limit      =", "limt =", ["passage[1].limt", 'did you mean "limit"']),
    ('limit      = "H=1.5"', "", ["passage[1].limit is missing"]),
    ('"H=1.5"', '"H=-1"', ["passage[1].limit", '"H=-1"', "> 0"]),
    ('"H=1.5"', '"E=1"', ["passage[1].limit", '"E=1"', "use H=1.5"]),
    ('"H=1.5"', "1.5", ["passage[1].limit = 1.5", "text in quotes"]),
    ("[1, 2.5]", "[2.5, 1]", ["passage[1].times = [2.5, 1", "ascend"]),
    ("[1, 2.5]", "[1, 1]", ["passage[1].times", "ascend"]),
    ("[1, 2.5]", "[-1, 1]", ["passage[1].times", "0 or later"]),
    ("[1, 2.5]", "[nan]", ["passage[1].times[1] = nan", "finite"]),
    ("[1, 2.5]", "3", ["passage[1].times = 3", "list"]),
    ("[1, 2.5]", "[]", ["passage[1].times", "at least 1"]),
    ("{ at_most = 0.1 }", "0.1", ["passage[1].rate_error = 0.1", "table"]),
    ("{ at_most = 0.1 }", "{}", ["passage[1].rate_error", "exactly one of"]),
    ('"q1=0.1,p2=0.2"', '"q1=10"', ["passage[2].start", "below the limit"]),
    ('"q1=0.1,p2=0.2"', '"H1=0.4,H2=0"', ["passage[2].start", "below the limit"]),
    (
        '"H=1.5"',
        "\"H=1.5\"\nstart = 'H1=0.5,H2=1.0'",
        ["passage[1].start", "below the limit H=1.5"],
    ),
    ('"q1=0.1,p2=0.2"', '"H=-1"', ["passage[2].start", "negative"]),
    ('"q1=0.1,p2=0.2"', '"q3=0"', ["passage[2].start", "use rest"]),
    ('"integrable"', '"exact"', ["passage[2].theory", '"nonintegrable"']),
    ('theory = "integrable"', "failure_error = { below = 1 }", ["passage[2].times is missing"]),
    ('of    = "q2"', 'of = "q2,p2"', ["transient[1].of", "one coordinate"]),
    ('of    = "q2"', 'of = "x"', ["transient[1].of", '"x"']),
    ("times = [1.0]", "times = [0.0, 1.0]", ["transient[1].times", "> 0"]),
    ("times = [1.0]", "", ["transient[1].times is missing"]),
    ('"noise=0.5"', '"noise=-1"', ["transient[1].start", "negative"]),
    ("[[transient]]", "[transient]", ["transient", "[[transient]]"]),
    ("[[transient]]", "[[passage]]\nlimit='H=1'\n" * 4 + "[[transient]]", ["passage", "at most 4"]),
]


def test_questions_are_read(tmp_path, scene_text):
    path = tmp_path / "time.toml"
    path.write_text(scene_text + GOOD)
    scene = load_scene(path)
    energy, either = scene.passages
    (transient,) = scene.transients
    assert (energy.name, energy.times, energy.theory) == (
        "H=1.5 from rest",
        (1.0, 2.5),
        "nonintegrable",
    )
    assert tuple(energy.rate_error) == ("at_most", 0.1)
    assert (either.name, either.times) == ("H1=0.4 or H2=0.6 from q1=0.1,p2=0.2", ())
    assert (observable_name(transient.of), str(transient.start)) == ("q2", "noise=0.5")


@pytest.mark.parametrize(("old", "new", "words"), BAD)
def test_what_cannot_be_asked_is_refused_in_one_line(tmp_path, scene_text, old, new, words):
    assert old in GOOD
    path = tmp_path / "time.toml"
    path.write_text(scene_text + GOOD.replace(old, new, 1))
    with pytest.raises(BadInput) as refusal:
        load_scene(path)
    line = str(refusal.value)
    assert "\n" not in line and all(word in line for word in ("time.toml: ", *words)), line


def test_shipped_scenes_in_time_ask_something():
    names = [n for n, path in shipped_scenes().items() if path.parent.name == "time"]
    assert len(names) >= 4
    for name in names:
        scene = load_scene(name)
        assert scene.passages or scene.transients, name
        for passage in scene.passages[:1]:
            assert passage.rate_error or passage.failure_error, name
