"""Whatever is given as a scene: it loads and can be shown, or one line says what to do about it."""

import json
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cases.scene.errors import LONGEST, BadInput
from cases.scene.scene import load_scene, shipped_scenes
from cases.show.facts import show_record
from cases.show.text import render

REFUSAL = re.compile(r".*/any\.toml: \S.*[:;] .*\S")
"""File, what is wrong, and after a colon or semicolon what to do."""


NONSENSE = [
    "nan", "-inf", "inf", "1e400", "-1e308", "5e-324", "-0.0", "9" * 400, "-" + "9" * 400,
    "9" * 5000, "0x" + "f" * 500, "true", "false", '""', '"Left"', "'both'", '"\\u0000"',
    '"\\uD800"', "[]", "[[]]", "[[[1]]]", "{}", "{a = 1}", "[{}]", "[1, 'a']", "[nan]", "[[nan]]",
    "[1, [2]]", "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "'../../etc/passwd'", "-1",
    "0", "1.5", '"""a\n"""', "[" * 40 + "]" * 40, "{a = " * 40 + "1" + "}" * 40, "=", "]", "\ufeff",
]  # fmt: skip
"""Values that no key takes, and some that one does."""


@st.composite
def mutated_scenes(draw):
    """The bytes of a shipped scene in which lines, values, characters or bytes were changed."""
    lines = draw(st.sampled_from(TEXTS)).splitlines()
    for _ in range(draw(st.integers(1, 3))):
        i = draw(st.integers(0, len(lines) - 1))
        j = draw(st.integers(0, len(lines) - 1))
        cut = draw(st.integers(0, len(lines[i])))
        match draw(st.sampled_from(["value", "key", "delete", "double", "swap", "cut", "insert"])):
            case "value":
                lines[i] = f"{lines[i].partition('=')[0]}= {draw(VALUES)}"
            case "key":
                lines[i] = f"{draw(KEYS)} = {lines[i].partition('=')[2] or draw(VALUES)}"
            case "delete":
                lines[i] = ""
            case "double":
                lines[i] += "\n" + lines[i]
            case "swap":
                lines[i], lines[j] = lines[j], lines[i]
            case "cut":
                lines[i] = lines[i][:cut]
            case "insert":
                lines[i] = lines[i][:cut] + draw(st.text(max_size=4)) + lines[i][cut:]
    content = "\n".join(lines).encode("utf-8", "surrogatepass")
    if draw(st.integers(0, 9)) == 0:
        i = draw(st.integers(0, len(content)))
        content = content[:i] + draw(st.binary(max_size=3)) + content[i + 1 :]
    return content


VALUES = st.one_of(
    st.sampled_from(NONSENSE),
    st.integers().map(str),
    st.floats().map(str),
    st.text(max_size=8).map(json.dumps),
    st.lists(st.floats(-10, 10), max_size=4).map(str),
)
KEYS = st.one_of(
    st.sampled_from(["mass", "side", "clearance", "contact.stiffness", "q", "v.1", "a.b", '""']),
    st.text(max_size=6).map(json.dumps),
)


TEXTS = [path.read_text(encoding="utf-8") for path in shipped_scenes().values()]


@pytest.mark.parametrize("count", [200, pytest.param(7000, marks=pytest.mark.slow)])
def test_any_mutation_of_a_shipped_scene_loads_or_is_refused(count, tmp_path):
    path = tmp_path / "any.toml"

    @settings(
        max_examples=count,
        deadline=None,
        derandomize=True,  # the same inputs in every run
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(content=mutated_scenes())
    def loads_or_is_refused(content):
        path.write_bytes(content)
        try:
            scene = load_scene(str(path))
        except BadInput as error:
            line = str(error)
            assert len(line) <= LONGEST and line.isprintable(), line
            assert REFUSAL.fullmatch(line), line
            return
        assert scene.text.encode() == content.removeprefix("\ufeff".encode())
        assert scene.curves and scene.observables and len(TEXTS) > 20
        record = show_record(scene)
        json.dumps(record, allow_nan=False)
        assert render("show.txt", record)

    loads_or_is_refused()
