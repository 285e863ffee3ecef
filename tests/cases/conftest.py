"""Scenes on disk, the command line in process, and a browser."""

import shutil
import sys

import pytest
from browser import Browser

from cases.command.cli import main

SCENE = """\
title = "A scene"
source = "tests"

[system]
mass            = [1.0, 1.0]
stiffness       = [1.0, 1.0]
damping         = [0.08, 0.04]
noise_intensity = [0.01, 0.02]

[[contact]]
mass      = 2
side      = "both"
stiffness = 10.0
clearance = 0.5

[observe]
densities = ["q2", "H"]
"""


@pytest.fixture(scope="session")
def scene_text():
    return SCENE


@pytest.fixture
def fpk(monkeypatch, capsys):
    """Run the command line in process: return exit status, standard output, standard error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["fpk", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        captured = capsys.readouterr()
        code = end.value.code
        return (0 if code is None else code), captured.out, captured.err

    return run


@pytest.fixture(scope="session")
def browser():
    """The browser of all tests of pages; each opens its page anew."""
    if shutil.which("chromium") is None:
        pytest.skip("chromium is not installed (Debian package chromium)")
    with Browser() as own:
        yield own
