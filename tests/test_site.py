"""The site: it builds without a warning or dead link; scripts and examples of docstrings run.

Every name of the page of the Python reference has an example, and links to the equation or
definition that it stands for. A class's example uses its members; a member may have one of its
own instead.
"""

import ast
import importlib
import inspect
import os
import re
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent

import matplotlib.pyplot as plt
import numpy as np
import pytest

import averaging
import fpk
import sim
from cases.compare.stationary import run_scene
from fpk.answer.names import REST, parse_observable
from fpk.system.contact_law import LAWS

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
ALONE = "contact_law"
"""It registers a law, which would stay in this process: it has one of its own."""
SLOW = ("crossings_spectrum", "export", "phase_space")
problems = runpy.run_path(str(ROOT / ".ci" / "offline.py"))["problems"]


def test_what_a_page_loads_from_a_network_is_a_problem(tmp_path):
    page = tmp_path / "index.html"
    page.write_text(
        '<a href="https://doi.org/1">a</a> <a href="#here">b</a> <p id="here">'
        '<img src="data:image/png;base64,AA=="> <a href="index.html#here">c</a>'
    )
    assert problems(tmp_path) == []
    for bad in (
        '<script src="https://cdn.example/x.js"></script>',
        '<link rel="stylesheet" href="//example/x.css">',
        '<img src="http://example/x.png">',
        '<img src="missing.png">',
        '<a href="missing.html">d</a>',
        '<a href="#nowhere">e</a>',
    ):
        page.write_text(bad)
        assert len(problems(tmp_path)) == 1, bad
    assert problems(tmp_path / "empty")


def test_the_continuous_integration_builds_it():
    script = (ROOT / ".ci" / "run").read_text()
    assert "sphinx-build -W" in script
    assert ".ci/offline.py" in script


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("sphinx_gallery"), reason="needs the extra docs")
def test_the_site_builds_and_needs_no_network(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", str(tmp_path / "cache"), str(ROOT / "docs"), str(tmp_path / "site")],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert problems(tmp_path / "site") == []
    made = {page.stem for page in (tmp_path / "site").glob("gallery/*.html")}
    assert made >= {script.stem for script in EXAMPLES}


def test_there_are_examples_that_assert_and_say_something_and_the_gallery_shows_them_all():
    assert len(EXAMPLES) >= 15
    assert {ALONE, *SLOW} <= {script.stem for script in EXAMPLES}
    for script in EXAMPLES:
        text = script.read_text(encoding="utf-8")
        assert "\nassert " in text or "    assert " in text, script.name
        assert "print(" in text, script.name
        _, title, underline, *_ = text.split("\n")  # as the gallery reads it
        assert underline == "=" * len(title), script.name
    conf = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    order = conf.split("ORDER = ")[1].split("]")[0] + "]"
    assert sorted(ast.literal_eval(order)) == [script.stem for script in EXAMPLES]


@pytest.mark.parametrize(
    "script",
    [pytest.param(s, marks=pytest.mark.slow) if s.stem in SLOW else s for s in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_example(script):
    if script.stem != ALONE:
        runpy.run_path(str(script), run_name="__main__")  # warnings are errors here, too
        plt.close("all")
        return
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


LINKS = runpy.run_path(str(ROOT / "docs" / "links.py"))
PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
ENTRY = re.compile(
    r"^\.\. auto(?:function|class|exception):: (\S+)\n(?:   :members: (.*)\n)?", re.MULTILINE
)
MEMBERS = {name: [m for m in members.split(", ") if m] for name, members in ENTRY.findall(PAGE)}
SLOW_NAMES = (
    "averaging.PhaseSpace",
    "sim.MonteCarlo",
    "sim.questions.splitting.rare_failure",
    "sim.questions.splitting.RareFailure",
    "fpk.answer.sampled_density.SampledDensity",
)


def named(path):
    """The object of a dotted name."""
    module, _, rest = path.rpartition(".")
    try:
        return getattr(importlib.import_module(module), rest)
    except ImportError:
        return getattr(named(module), rest)


def examples(path):
    """The indented blocks after ``::``."""
    text = inspect.getdoc(named(path)) or ""
    return [dedent(block) for block in re.findall(r"::\n\n((?: {4}.*\n|\n)+)", text + "\n")]


def test_the_page_has_the_faces():
    rooms = (fpk, averaging, sim)
    faces = {f"{room.__name__}.{name}" for room in rooms for name in room.__all__}
    assert faces <= set(MEMBERS)
    assert set(SLOW_NAMES) <= set(MEMBERS)


@pytest.mark.parametrize("name", [name for name, members in MEMBERS.items() if members])
def test_the_example_of_a_class_uses_its_members(name):
    text = "\n".join(examples(name))
    for member in MEMBERS[name]:
        own = examples(f"{name}.{member}")
        used = re.search(rf"\.{member}\b", text)
        assert own or used, f"{name}.{member} has no example"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow) if n in SLOW_NAMES else n
        for name, members in MEMBERS.items()
        for n in (name, *(f"{name}.{m}" for m in members if examples(f"{name}.{m}")))
    ],
)
def test_the_example_of_a_docstring_runs(name, tmp_path, monkeypatch):
    found = examples(name)
    assert found, f"{name} has no example"
    monkeypatch.chdir(tmp_path)
    space = {path.rpartition(".")[2]: named(path) for path in MEMBERS}
    space |= {"parse_observable": parse_observable, "REST": REST, "run_scene": run_scene}
    space |= {"fpk": fpk, "np": np, "Path": Path, "system": fpk.load("fig6a").system}
    before = set(LAWS)
    try:
        for block in found:
            exec(compile(block, name, "exec"), space)
    finally:
        for law in set(LAWS) - before:
            del LAWS[law]
    plt.close("all")


def links_of(name, site, what=None):
    """The line of links of a name, and what it lacks, with a gallery as in the folder ``site``."""
    obj = named(name)
    kind = "class" if isinstance(obj, type) else "function"
    what = what or ("exception" if name.endswith(("Input", "Applicable", "Certified")) else kind)
    return LINKS["links_of"](what, name, obj, obj.__doc__ or "", site)


@pytest.mark.parametrize("name", MEMBERS)
def test_an_entry_has_an_equation_or_a_definition(name, tmp_path):
    _, lacking = links_of(name, tmp_path)
    assert lacking == "no example in the gallery"  # which only the build of the site makes


def test_members_are_linked_where_they_are_defined(tmp_path):
    for name, words in (
        ("fpk.Density.rms", "from-density"),
        ("averaging.NonIntegrable.passage", "averaged-in-time"),
        ("averaging.PhaseSpace.passage", "full-passage"),
        ("averaging.Exact.crossings", "crossings"),
        ("sim.MonteCarlo.transient", "simulation-in-time"),
    ):
        line, lacking = links_of(name, tmp_path, "method")
        assert line.startswith("See: ") and f"<{words}>`" in line and not lacking
    assert links_of("fpk.System.hamiltonian", tmp_path, "method") == ("", "")  # as its class


def test_a_name_without_links_is_told(tmp_path):
    line, lacking = links_of("fpk.numeric.machine.usable_cores", tmp_path)
    assert (line, lacking) == ("", "no example in the gallery and no equation and no section")
    used = tmp_path / "gallery" / "backreferences"
    used.mkdir(parents=True)
    (used / "fpk.System.examples").write_text("a :doc:`/gallery/tails` :doc:`/gallery/tails`")
    line, lacking = links_of("fpk.System", tmp_path)
    assert line.endswith("In the gallery: :doc:`/gallery/tails`") and not lacking
    labels = {label for found in LINKS["mentions"]().values() for label in found}
    assert len(labels) >= 13 and {*LINKS["SECTIONS"]} <= labels
