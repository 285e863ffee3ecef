"""Every function and class of the faces has an example in its docstring, and it runs."""

import inspect
import re
from textwrap import dedent

import matplotlib.pyplot as plt
import numpy as np
import pytest

import averaging
import fpk
import sim
from cases.comparison.answers import Answers
from fpk.contact_quantities import contact_quantities
from fpk.limit import parse_limit
from fpk.start import REST
from sim.splitting import rare_failure

FACE = {
    f"{room.__name__}.{name}": getattr(room, name)
    for room in (fpk, averaging, sim)
    for name in room.__all__
    if not (inspect.isclass(getattr(room, name)) and issubclass(getattr(room, name), Exception))
}
FACE |= {"contact_quantities": contact_quantities, "rare_failure": rare_failure}
FACE |= {f"Answers.{m}": getattr(Answers, m) for m in ("summary", "to_xarray", "plot")}
SLOW = ("averaging.PhaseSpace", "sim.MonteCarlo", "rare_failure")


def examples(text):
    """The indented blocks after ``::``."""
    return [dedent(block) for block in re.findall(r"::\n\n((?: {4}.*\n|\n)+)", text + "\n")]


def test_the_faces_are_looked_at():
    assert {"fpk.solve", "fpk.System", "averaging.NonIntegrable", *SLOW} <= set(FACE)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in FACE]
)
def test_the_example_of_a_docstring_runs(name):
    found = examples(inspect.getdoc(FACE[name]) or "")
    assert found, f"{name} has no example"
    space = {"fpk": fpk, "np": np, "system": fpk.load("fig6a").system, "REST": REST}
    space |= {"contact_quantities": contact_quantities, "parse_limit": parse_limit}
    space |= {key: getattr(averaging, key) for key in averaging.__all__}
    space |= {"MonteCarlo": sim.MonteCarlo, "rare_failure": rare_failure}
    for block in found:
        exec(compile(block, name, "exec"), space)
    plt.close("all")
