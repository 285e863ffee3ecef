"""Pictures of pairs: which are drawn, on axes in words; the size of a report."""

import re
from dataclasses import replace

import pytest

from cases.compare.routes import all_methods, chosen_methods, method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.pictures.in_time import passage_panel
from cases.show.pictures.svg import svg_text
from cases.show.report import figures, write_report
from fpk.answer.names import parse_observable


def drawn(name, of, *methods):
    scene = replace(load_scene(name), observables=(parse_observable(of, 2),), expect=None)
    sampling = {"paths": 4096, "time": 60.0}
    outcome = run_scene(scene, [method_for(m, **sampling) for m in methods])
    return {stem: (caption, figure) for stem, caption, figure in figures(outcome)}


def test_figure_7_is_a_surface_by_theory_and_by_simulation_and_its_bar_has_round_numbers():
    found = drawn("fig7", "q2,p2", "nonintegrable", "montecarlo")
    assert list(found) == ["density_q2_p2", "surface_q2_p2"]
    caption, figure = found["surface_q2_p2"]
    assert "surface" in caption and len(figure.axes) == 2
    for axes in figure.axes:
        assert "displacement" in axes.get_xlabel() and "momentum" in axes.get_ylabel()
        assert axes.get_zlim()[0] == 0
    assert len(svg_text(figure, salt="x")) < 2_000_000  # the sheet is an image, words are not
    bar = found["density_q2_p2"][1].axes[-1]
    low, high = bar.get_ylim()
    ticks = [tick for tick in bar.get_yticks() if low <= tick <= high]
    assert 4 <= len(ticks) <= 9 and ticks == pytest.approx([round(tick, 1) for tick in ticks])
    # A label is its number, with all digits: 0.125 is not 0.12.
    assert [bar.yaxis.get_major_formatter()(x) for x in (0.125, 125.0)] == ["0.125", "125"]


def test_energies_are_drawn_in_decades():
    found = drawn("fig8b", "H1,H2", "integrable")
    assert list(found) == ["density_H1_H2"]
    bar = found["density_H1_H2"][1].axes[-1]
    assert bar.get_yscale() == "log" and "H₁" in bar.get_ylabel()


@pytest.mark.parametrize("start, first", [("rest", 0.0), ("noise=0.5", 5.0)])
def test_reliability_begins_with_one_only_where_the_start_lies_below_the_limit(
    solved, scene_text, start, first
):
    question = f'[[passage]]\nlimit = "H=1"\nstart = "{start}"\ntimes = [5.0, 20.0]\n'
    (curve,) = solved(f"{scene_text}\n{question}", "nonintegrable/fem").curves
    (line,) = passage_panel(curve.passages[0], "").curves
    assert line.x[0] == first and line.y[0] <= 1.0


@pytest.mark.parametrize(
    ("names", "largest"),
    # The limit is 250 kB. Pictures of few samples are noisy and take the most, so their number is
    # given and not the time. Without the full system the page has 147 kB, in a third of the time.
    [
        (("exact", "linear", "nonintegrable", "integrable"), 160_000),
        pytest.param((), 250_000, marks=pytest.mark.slow),
    ],
    ids=["averaged", "all"],
)
def test_the_report_of_fig6a_is_small_beside_its_data(names, largest, tmp_path):
    methods = chosen_methods(all_methods(paths=4096, relaxations=8.0), names, simulation=True)
    outcome = run_scene(load_scene("fig6a"), methods, relax=True)
    write_report(outcome, digest_of(outcome), tmp_path)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json" id="data">.*?</script>', report, re.S)
    assert len(data) > 100_000 and len(report.encode()) - len(data.encode()) <= largest
    # All is there: the chain and pictures, the quantities of each of three curves.
    assert report.count("<img") >= 6 and report.count("<td>q2, kurtosis</td>") == 3
    assert ("phase-space" in report and "montecarlo" in report) or names
