"""``fpk new``, ``check``, ``schema``, ``completion``, and the examples of every help text."""

import json
import re
import shlex
import tomllib
from pathlib import Path
from runpy import run_path

import pytest

from cases.command.app import app
from cases.command.examples import EXAMPLES
from cases.command.parts import as_wide
from cases.scene.json_schema import DIRECTIVE, FILE, scene_schema
from cases.scene.scene import load_scene, shipped_scenes
from cases.scene.schema import SCENE
from fpk.answer.contacts import stop_clearances
from fpk.system.contact_law import LAWS
from sim.montecarlo import MonteCarlo
from sim.sample.settings import estimate_seconds

QUICK = ("list", "new", "check", "schema", "show", "passage", "transient", "density", "crossings")
"""Commands whose first example takes a second or less once the program is compiled."""
CALL = re.compile(r'fpk [^)>"]*(?:"[^"]*"[^)>"]*)*')
"""The call in an example, which may stand in a substitution or before a redirection."""


def words_of(example):
    return shlex.split(CALL.search(example)[0], comments=True)[1:]


@pytest.mark.parametrize(("masses", "law"), [*zip((1, 3, 7), sorted(LAWS), strict=False)])
def test_a_new_scene_is_valid_and_its_stop_is_reached(masses, law, fpk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = fpk("new", "pipe", "--masses", masses, "--law", law)
    assert (status, err) == (0, "") and "wrote pipe.toml" in out
    scene = load_scene("pipe.toml")
    assert scene.system.n == masses and scene.system.contacts[0].law == law
    # Without stops the rms of the last mass is that of its temperature, which damping and noise
    # that alternate along the chain change by less than their ratio, 4: √4 in displacements.
    assert all(0.5 < stop.ratio < 2.0 for stop in stop_clearances(scene.system))
    text = (tmp_path / "pipe.toml").read_text()
    assert text.startswith(DIRECTIVE + "\n")
    assert masses > 3 or max(map(len, text.splitlines())) <= 100
    assert json.loads((tmp_path / FILE).read_text()) == scene_schema()
    optional = text.replace("# [[", "[[").replace("# limit", "limit").replace("# times", "times")
    (tmp_path / "more.toml").write_text(optional)
    assert load_scene("./more.toml").passages


def test_what_new_says_as_json_and_a_schema_that_is_there_is_left_alone(answer, refusal, tmp_path):
    path, schema = tmp_path / "a.toml", tmp_path / FILE
    record = answer("new", "pipe", "--out", path)
    assert record["files"] == [str(path), str(schema)] == [record["file"], str(schema)]
    assert record.keys() == {"schema", "scene", "file", "files"} and record["scene"] == "pipe"
    schema.write_text("mine")
    answer("new", "pipe", "--out", tmp_path / "pipe.toml")
    refusal("schema", "--out", schema)
    assert schema.read_text() == "mine"


def test_check_says_what_applies_and_what_it_costs(fpk, scene_text, written):
    status, out, err = fpk("check", "fig6a")
    assert (status, err) == (0, "") and len(out.splitlines()) <= 10  # folded at 80 columns
    assert "valid, 2 masses, 2 stops, 3 systems" in out and "simulation about" in out
    # Names for readers with the keys to type; no key where it is the name itself.
    assert "energy averaging (nonintegrable), modal averaging (integrable)," in out
    assert "Gaussian (linear): " in out and "exact: " in out
    record = json.loads(fpk("check", "fig6a", "--json")[1])
    assert "nonintegrable" in record["applies"] and record["valid"] is True
    assert [t["method"] for t in record["refused"]] == ["exact", "linear"]
    status, out, _ = fpk("check", written(scene_text.replace("[0.08, 0.04]", "[0.0, 0.0]")))
    assert status == 0 and "no method to stationary densities: some motion is not damped" in out
    assert out.count("not damped") == 1
    # The cost of a simulation is that of all its systems.
    own = [estimate_seconds(MonteCarlo(), curve.system) for curve in load_scene("fig6a").curves]
    assert min(own) > 0.0
    assert record["simulation_seconds"] == pytest.approx(sum(own), rel=1e-12)


def test_the_table_of_keys_is_that_of_the_schema():
    """``python docs/key_table.py docs/scene.md`` writes it anew."""
    docs = Path(__file__).parents[3] / "docs"
    page, tables = (docs / "scene.md").read_text(encoding="utf-8"), run_path(docs / "key_table.py")
    with_table = tables["with_table"]
    assert with_table(page) == page
    rows = [line.split(" | ") for line in tables["key_table"]().splitlines()[2:]]
    assert len(rows) > 40 and not [row[0] for row in rows if row[-1].strip(" |") == ""]
    with pytest.raises(ValueError, match="marks"):
        with_table("no table here")


def test_the_schema_takes_every_shipped_scene_and_refuses_what_the_program_refuses(scene_text, fpk):
    schema = json.loads(fpk("schema")[1])
    contact = schema["properties"]["contact"]["items"]
    assert schema == scene_schema() and schema["properties"].keys() == SCENE["fields"].keys()
    assert contact["properties"]["law"]["enum"] == sorted(LAWS)
    assert contact["required"] == ["mass", "side", "stiffness", "clearance"]
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    assert len(shipped_scenes()) > 20
    for text in (scene_text, *(path.read_text() for path in shipped_scenes().values())):
        validator.validate(tomllib.loads(text))
    for old, new in (
        ("clearance", "clearence"),
        ('"both"', '"up"'),
        ("mass      = 2", "mass      = 0"),
        ("[1.0, 1.0]", '["a"]'),
        ("[[contact]]", "[contact]"),
        ('title = "A scene"', "title = 3"),
    ):
        assert not validator.is_valid(tomllib.loads(scene_text.replace(old, new, 1)))


def test_the_completion_of_a_shell_is_printed(fpk):
    for shell in ("bash", "zsh", "fish"):
        status, out, err = fpk("completion", shell)
        assert (status, err) == (0, "") and "_FPK_COMPLETE" in out and shell in out


@pytest.mark.parametrize(
    ("typed", "word"),
    [
        ("fpk sh", "show"),
        ("fpk show fig6", "fig6a"),
        ("fpk run --se", "--seed"),
        ("fpk run fig6a --method pha", "phase-space"),
        ("fpk run fig6a --method nonintegrable/q", "nonintegrable/quadrature"),
        ("fpk density fig6a --method non", "nonintegrable"),
        ("fpk density fig6a --method nonintegrable --solver f", "fem"),
        ("fpk density fig6a --of q", "q2"),
        ("fpk new mine --law bil", "bilinear"),
    ],
)
def test_commands_options_and_scenes_are_completed(typed, word, fpk, monkeypatch):
    monkeypatch.setenv("_FPK_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    assert f"plain,{word}" in fpk()[1].splitlines()
    monkeypatch.setenv("COMP_WORDS", "fpk density nothing --of q")
    monkeypatch.setenv("COMP_CWORD", "4")
    assert "q1" not in fpk()[1]  # there is no such scene


@pytest.mark.parametrize("name", app.commands)
def test_every_command_has_examples_that_parse(name, fpk):
    shown = fpk(name, "--help")[1]
    assert EXAMPLES[name]
    for example in EXAMPLES[name]:
        own, *arguments = words_of(example)
        with app.commands[name].make_context(name, arguments):
            pass
        assert own == name and example in shown


@pytest.mark.parametrize("name", QUICK)
def test_quick_examples_run(name, fpk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = fpk(*words_of(EXAMPLES[name][0]))
    assert (status, err) == (0, "") and out


def test_help_is_as_wide_as_the_terminal(fpk, monkeypatch):
    shown = {}
    for width in (60, 160):
        monkeypatch.setenv("COLUMNS", str(width))
        shown[width] = fpk("passage", "--help")[1].splitlines()
    options = [line for line in shown[60] if "fpk passage" not in line]
    assert max(map(len, options)) <= 60 and len(shown[160]) < len(shown[60])
    assert 80 < max(map(len, shown[160])) <= 160


@pytest.mark.parametrize("width", [40, 200])
def test_lines_are_folded_at_the_width_of_the_terminal_and_keep_every_word(width, fpk, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    whole = fpk("show", "fig6a")[1]
    assert max(map(len, whole.splitlines())) > 100  # a file or a pipe has no width
    monkeypatch.setenv("COLUMNS", str(width))
    shown = fpk("show", "fig6a")[1]
    assert shown.split() == whole.split()
    assert max(map(len, shown.splitlines())) <= width
    assert as_wide("x" * 500) == "x" * 500  # a word, as the name of a file, stays one
