"""The site builds without a warning or dead link; every script in examples/ runs and asserts."""

import ast
import os
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

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
