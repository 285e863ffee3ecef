"""Every script in examples/ runs by itself and finds what it asserts."""

import ast
import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))
ALONE = "contact_law"
"""It registers a law, which would stay in this process: it has one of its own."""
SLOW = ("crossings_spectrum", "export", "phase_space")


def test_there_are_examples_that_assert_and_say_something_and_the_gallery_shows_them_all():
    assert len(EXAMPLES) >= 15
    assert {ALONE, *SLOW} <= {script.stem for script in EXAMPLES}
    for script in EXAMPLES:
        text = script.read_text(encoding="utf-8")
        assert "\nassert " in text or "    assert " in text, script.name
        assert "print(" in text, script.name
        _, title, underline, *_ = text.split("\n")  # as the gallery reads it
        assert underline == "=" * len(title), script.name
    conf = (Path(__file__).parent.parent / "docs" / "conf.py").read_text(encoding="utf-8")
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
