"""Every name of the page of the Python reference has an example, and it runs.

A class's example uses its members; a member may have one of its own instead.
"""

import importlib
import inspect
import re
from pathlib import Path
from textwrap import dedent

import matplotlib.pyplot as plt
import numpy as np
import pytest

import averaging
import fpk
import sim
from averaging.energy_process import energy_process
from cases.compare.stationary import run_scene
from cases.scene.scene import shipped_scenes
from cases.show.fields import write_netcdf
from cases.show.vtk import write_vtu
from fpk.answer.contacts import contact_quantities
from fpk.answer.names import REST, parse_limit, parse_observable, parse_start
from fpk.system.contact_law import LAWS, ContactLaw, register_law
from sim.questions.splitting import Splitting, rare_failure

PAGE = (Path(__file__).parent.parent / "docs" / "api.md").read_text(encoding="utf-8")
ENTRY = re.compile(
    r"^\.\. auto(?:function|class|exception):: (\S+)\n(?:   :members: (.*)\n)?", re.MULTILINE
)
MEMBERS = {name: [m for m in members.split(", ") if m] for name, members in ENTRY.findall(PAGE)}
SLOW = (
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
    assert set(SLOW) <= set(MEMBERS)


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
        pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n
        for name, members in MEMBERS.items()
        for n in (name, *(f"{name}.{m}" for m in members if examples(f"{name}.{m}")))
    ],
)
def test_the_example_of_a_docstring_runs(name, tmp_path, monkeypatch):
    found = examples(name)
    assert found, f"{name} has no example"
    monkeypatch.chdir(tmp_path)
    space = {"fpk": fpk, "np": np, "Path": Path, "system": fpk.load("fig6a").system, "REST": REST}
    space |= {key: getattr(averaging, key) for key in averaging.__all__}
    space |= {"MonteCarlo": sim.MonteCarlo, "Splitting": Splitting}
    functions = (contact_quantities, energy_process, parse_limit, parse_observable, parse_start)
    files = (
        rare_failure,
        run_scene,
        shipped_scenes,
        write_netcdf,
        write_vtu,
        ContactLaw,
        register_law,
    )
    space |= {f.__name__: f for f in (*functions, *files)}
    before = set(LAWS)
    try:
        for block in found:
            exec(compile(block, name, "exec"), space)
    finally:
        for law in set(LAWS) - before:
            del LAWS[law]
    plt.close("all")
