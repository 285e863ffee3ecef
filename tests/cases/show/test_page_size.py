"""The report of fig6a is a small file: what stands in it beside the data of its curves."""

import re

import pytest

from cases.compare.routes import all_methods, chosen_methods
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.report import write_report

SOLVERS = "exact", "linear", "nonintegrable", "integrable"


@pytest.mark.parametrize(
    ("names", "largest"),
    # The limit is 250 kB: the rest is for bins and words that vary. Without the full system the
    # page has 147 kB, and is made in a third of the time.
    [(SOLVERS, 160_000), pytest.param((), 240_000, marks=pytest.mark.slow)],
    ids=["averaged", "all"],
)
def test_the_report_of_fig6a_is_small_beside_its_data(names, largest, tmp_path):
    methods = chosen_methods(all_methods(seconds=0.3, partial=True), names, simulation=True)
    outcome = run_scene(load_scene("fig6a"), methods, relax=True)
    write_report(outcome, digest_of(outcome), tmp_path)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    data = re.findall(r'<script type="application/json" id="data">.*?</script>', report, re.DOTALL)
    assert len(data) == 1 and len(data[0]) > 100_000
    size = len(report.encode()) - len(data[0].encode())
    assert size <= largest
    # All is there: the chain and pictures, the quantities of each of three curves.
    assert report.count("<img") >= 6 and report.count("<td>q2, kurtosis</td>") == 3
    assert ("phase-space" in report and "montecarlo" in report) or names
