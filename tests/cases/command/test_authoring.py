"""``fpk new``, ``check``, ``schema``, ``completion``, and the examples of every help text."""

import json
import os
import re
import shlex
import tomllib
from itertools import product
from pathlib import Path
from runpy import run_path

import click
import pytest

from cases.command.app import app
from cases.command.examples import EXAMPLES
from cases.command.parts import as_wide
from cases.scene.json_schema import DIRECTIVE, FILE, scene_schema
from cases.scene.scene import load_scene, shipped_scenes
from cases.scene.schema import SCENE
from cases.scene.written import duration
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


@pytest.mark.parametrize(("masses", "law"), list(product((1, 2, 3, 7), sorted(LAWS))))
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
    assert text.startswith(DIRECTIVE + "\n") and (
        masses > 3 or max(map(len, text.splitlines())) <= 100
    )
    assert json.loads((tmp_path / FILE).read_text()) == scene_schema()
    optional = text.replace("# [[", "[[").replace("# limit", "limit").replace("# times", "times")
    (tmp_path / "more.toml").write_text(optional)
    assert load_scene("./more.toml").passages


def test_what_new_says_as_json(fpk, tmp_path):
    path = tmp_path / "a.toml"
    record = json.loads(fpk("new", "pipe", "--out", path, "--json")[1])
    assert record == {
        "schema": 2, "scene": "pipe", "file": str(path), "files": [str(path), str(tmp_path / FILE)]
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["../pipe"], "letters"),
        (['a"\nb'], "letters"),
        (["-"], "letters"),
        (["ü"], "letters"),
        (["a" * 65], "64"),
        (["fig6a"], "shipped"),
        (["pipe", "--law", "steel"], "bilinear, hertz, power"),
        (["pipe", "--masses", "0"], "--masses"),
        (["pipe", "--masses", "501"], "--masses"),
        (["pipe", "--out", "nowhere/pipe.toml"], "does not exist"),
        (["there"], "not overwritten"),
        (["link"], "not overwritten"),
        ([], "NAME"),
    ],
)
def test_new_refuses_in_one_line(arguments, word, fpk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.toml").write_text("mine")
    (tmp_path / "link.toml").symlink_to("nowhere.toml")
    status, out, err = fpk("new", *arguments)
    assert (status, out) == (2, "") and err.count("\n") == 1 and word in err
    assert (tmp_path / "there.toml").read_text() == "mine"
    assert sorted(os.listdir(tmp_path)) == ["link.toml", "there.toml"]


def test_a_schema_that_is_there_is_left_alone(fpk, tmp_path):
    (tmp_path / FILE).write_text("mine")
    assert fpk("new", "pipe", "--out", tmp_path / "pipe.toml")[0] == 0
    assert (tmp_path / FILE).read_text() == "mine"
    assert fpk("schema", "--out", tmp_path / FILE)[0] == 2


def test_check_says_what_applies_and_what_it_costs(fpk, scene_text, tmp_path):
    status, out, err = fpk("check", "fig6a")
    assert (status, err) == (0, "") and len(out.splitlines()) <= 10  # folded at 80 columns
    assert "valid, 2 masses, 2 stops, 3 systems" in out and "simulation about" in out
    # Names for readers with the keys to type; no key where it is the name itself.
    assert "energy averaging (nonintegrable), modal averaging (integrable)," in out
    assert "Gaussian (linear): " in out and "exact: " in out
    record = json.loads(fpk("check", "fig6a", "--json")[1])
    assert "nonintegrable" in record["applies"] and record["valid"] is True
    assert [t["method"] for t in record["refused"]] == ["exact", "linear"]
    path = tmp_path / "bad.toml"
    path.write_text(scene_text.replace('"both"', '"up"'))
    status, out, err = fpk("check", path)
    assert (status, out) == (2, "") and err.count("\n") == 1 and "contact[1].side" in err


def test_check_says_where_nothing_can_be_simulated(fpk, scene_text, tmp_path):
    path = tmp_path / "undamped.toml"
    path.write_text(scene_text.replace("[0.08, 0.04]", "[0.0, 0.0]"))
    status, out, _ = fpk("check", path)
    assert status == 0 and "no method to stationary densities: some motion is not damped" in out
    assert out.count("not damped") == 1


def test_the_cost_of_a_simulation_is_that_of_all_its_systems(fpk):
    """A number of seconds for each curve, all added up; how good it is depends on the machine."""
    scene = load_scene("fig6a")
    expected = json.loads(fpk("check", "fig6a", "--json")[1])["simulation_seconds"]
    own = [estimate_seconds(MonteCarlo(), curve.system) for curve in scene.curves]
    assert min(own) > 0.0 and expected == pytest.approx(sum(own), rel=1e-12)


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


@pytest.fixture(scope="module")
def validator():
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    jsonschema.Draft202012Validator.check_schema(scene_schema())
    return jsonschema.Draft202012Validator(scene_schema())


def test_the_schema_takes_every_shipped_scene(validator):
    assert len(shipped_scenes()) > 20
    for path in shipped_scenes().values():
        validator.validate(tomllib.loads(path.read_text()))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("clearance", "clearence"),
        ('"both"', '"up"'),
        ("mass      = 2", "mass      = 0"),
        ("[1.0, 1.0]", '["a"]'),
        ("[[contact]]", "[contact]"),
        ("[system]", "[sistem]"),
        ('title = "A scene"', "title = 3"),
    ],
)
def test_the_schema_refuses_what_the_program_refuses(old, new, validator, scene_text):
    tables = tomllib.loads(scene_text)
    assert validator.is_valid(tables)
    assert not validator.is_valid(tomllib.loads(scene_text.replace(old, new, 1)))


def test_the_schema_has_every_key_of_a_scene(fpk):
    schema = json.loads(fpk("schema")[1])
    assert schema == scene_schema()
    assert schema["properties"].keys() == SCENE["fields"].keys()
    contact = schema["properties"]["contact"]["items"]
    assert contact["properties"]["law"]["enum"] == sorted(LAWS)
    assert contact["required"] == ["mass", "side", "stiffness", "clearance"]
    assert contact["additionalProperties"] is False


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_of_a_shell_is_printed(shell, fpk):
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


def test_observables_of_no_scene_are_not_completed(fpk, monkeypatch):
    monkeypatch.setenv("_FPK_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "fpk density nothing --of q")
    monkeypatch.setenv("COMP_CWORD", "4")
    assert "q1" not in fpk()[1]


def test_every_command_has_examples():
    assert app.commands.keys() == EXAMPLES.keys()
    for name, lines in EXAMPLES.items():
        assert lines and all(words_of(line)[0] == name for line in lines)


@pytest.mark.parametrize("example", [line for lines in EXAMPLES.values() for line in lines])
def test_examples_parse(example, fpk):
    name, *arguments = words_of(example)
    with app.commands[name].make_context(name, arguments):
        pass
    assert example in fpk(name, "--help")[1]


@pytest.mark.parametrize("name", QUICK)
def test_quick_examples_run(name, fpk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = fpk(*words_of(EXAMPLES[name][0]))
    assert (status, err) == (0, "") and out


def test_help_is_as_wide_as_the_terminal(fpk, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    narrow = fpk("passage", "--help")[1].splitlines()
    monkeypatch.setenv("COLUMNS", "160")
    wide = fpk("passage", "--help")[1].splitlines()
    options = [line for line in narrow if "fpk passage" not in line]
    assert max(map(len, options)) <= 60 and len(wide) < len(narrow)
    assert 80 < max(map(len, wide)) <= 160


@pytest.mark.parametrize("width", [40, 79, 200])
def test_lines_are_folded_at_the_width_of_the_terminal_and_keep_every_word(width, fpk, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    whole = fpk("show", "fig6a")[1]
    assert max(map(len, whole.splitlines())) > 100  # a file or a pipe has no width
    monkeypatch.setenv("COLUMNS", str(width))
    shown = fpk("show", "fig6a")[1]
    assert shown.split() == whole.split()
    assert max(map(len, shown.splitlines())) <= width
    assert as_wide("x" * 500) == "x" * 500  # a word, as the name of a file, stays one


def test_times_have_units_that_suit_them():
    words = ["5e-06 ms", "2 ms", "1 s", "1.5 min", "3 h", "1 day", "2.31 days", "3.2e+06 years"]
    times = [5e-9, 2e-3, 1.0, 90.0, 10800.0, 86400.0, 2e5, 1e14]
    assert list(map(duration, times)) == words


def test_a_command_without_examples_is_noticed(monkeypatch):
    monkeypatch.setitem(app.commands, "extra", click.Command("extra"))
    with pytest.raises(AssertionError):
        test_every_command_has_examples()
