"""Every script in examples/ runs by itself and finds what it asserts."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))
ALONE = "contact_law"
"""It registers a law, which would stay in this process: it has one of its own."""


def test_there_are_examples():
    assert len(EXAMPLES) >= 6
    assert ALONE in {script.stem for script in EXAMPLES}


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_example(script):
    if script.stem != ALONE:
        runpy.run_path(str(script), run_name="__main__")  # warnings are errors here, too
        return
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
