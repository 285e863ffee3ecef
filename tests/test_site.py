"""The site builds without a warning, loads nothing from a network, and has no dead link."""

import os
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
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
    assert made >= {script.stem for script in (ROOT / "examples").glob("*.py")}
