"""Names of the Python reference are linked to the equation or definition that they stand for."""

import runpy
from pathlib import Path

import pytest
from test_docstring_examples import MEMBERS, named

ROOT = Path(__file__).parent.parent
LINKS = runpy.run_path(str(ROOT / "docs" / "links.py"))


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
