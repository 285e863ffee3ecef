"""Scenes on disk, the command line in process, and a browser."""

import json
import shutil
import sys

import pytest
from browser import Browser

from cases.command.cli import main
from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene

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
UNITS = '[units]\nlength = "mm"\nmass = "kg"\ntime = "s"\n'


@pytest.fixture(scope="session")
def scene_text():
    return SCENE


@pytest.fixture(scope="session")
def linear_text():
    """The scene without its contact."""
    system, _, rest = SCENE.partition("[[contact]]")
    return system + rest[rest.index("[observe]") :]


@pytest.fixture(scope="session")
def units_text():
    """A table of units for the end of a scene."""
    return UNITS


@pytest.fixture
def written(tmp_path):
    """Write the text of a scene to a file of its own and return the path."""

    def write(text, name="any.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def fpk(monkeypatch, capsys):
    """Run the command line in process: return exit status, standard output, standard error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["fpk", *map(str, arguments)])
        monkeypatch.setattr("cases.command.cli.leave", sys.exit)
        with pytest.raises(SystemExit) as end:
            main()
        captured = capsys.readouterr()
        code = end.value.code
        return (0 if code is None else code), captured.out, captured.err

    return run


@pytest.fixture
def answer(fpk):
    """Return the one JSON object that a command prints, with status 0 and nothing else."""

    def ask(*arguments):
        status, out, err = fpk(*arguments, "--json")
        assert (status, err) == (0, "") and out.count("\n") == 1
        return json.loads(out)

    return ask


@pytest.fixture
def refusal(fpk):
    """Return the one line in which a command refuses bad input with status 2."""

    def refused(*arguments):
        status, out, err = fpk(*arguments)
        assert (status, out) == (2, ""), arguments
        assert err.count("\n") == 1 and err.startswith("fpk: ") and err[:-1].isprintable()
        return err

    return refused


@pytest.fixture(scope="session")
def solved(tmp_path_factory):
    """Solve the scene of a text by routes, each a method, or a name and a solver."""

    def solve(text, *routes, name="any"):
        path = tmp_path_factory.mktemp("scene") / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        methods = [method_for(*r.split("/")) if isinstance(r, str) else r for r in routes]
        return run_scene(load_scene(path), methods)

    return solve


@pytest.fixture(scope="session")
def outcome(solved):
    """The scene by energy averaging and modal averaging in closed form."""
    return solved(SCENE, "nonintegrable/closed-form", "integrable/closed-form")


@pytest.fixture(scope="session")
def browser():
    """The browser of all tests of pages; each opens its page anew."""
    if shutil.which("chromium") is None:
        pytest.skip("chromium is not installed (Debian package chromium)")
    with Browser() as own:
        yield own
