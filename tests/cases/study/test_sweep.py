"""Sweeps: values against closed forms, what is written and drawn, going on after a stop."""

import json
import os
import re
from dataclasses import replace
from html import unescape
from io import BytesIO
from math import sqrt

import numpy as np
import pytest
import xarray as xr
from scipy.special import erfc, expi

import fpk as face
from cases.compare.quantity import parse_definition
from cases.scene.errors import BadInput
from cases.scene.numbers import with_numbers
from cases.scene.scene import load_scene
from cases.show.files import write_text
from cases.show.pictures.draw import study_figure
from cases.study.regime_map import build_map
from cases.study.sweep.grid import parse_axes
from fpk.answer.quantities import Number
from fpk.system.linear import stationary_covariance

FREE = face.System([1, 2], [1, 3], [0.1, 0.2], [[0.02, 0.01], [0.01, 0.04]])
ROUND_OFF = 1e-12
"""Relative error of the references below, solved in double precision."""
CLEARANCES = {"contact[1].clearance": [0.3, 0.5]}


def assert_values(result, expected, *, most=1.0):
    """Hold the values of the first method to (quantities, points) within their stated errors.

    ``most`` bounds d ln value / d ln rms, which multiplies the round-off of the reference.
    """
    assert not result.problems
    value, error = result.field("value")[:, 0], result.field("error")[:, 0]
    assert np.all(np.abs(value - expected) <= error + most * ROUND_OFF * np.abs(expected))
    assert np.all(error < 1e-6 * np.abs(expected))


@pytest.mark.parametrize(
    ("path", "own", "values"),
    [
        ("system.mass[2]", lambda v: {"mass": [1, v]}, [0.5, 3.0]),
        ("system.damping", lambda v: {"damping": FREE.damping * v}, [0.5, 2.0]),
        ("system.damping[2]", lambda v: {"damping": [0.1, v]}, [0.05, 2.0]),
        ("system.noise_intensity[2,1]", lambda v: {"noise_intensity": [[0.02, v], [v, 0.04]]},
         [-0.02, 0.005]),
    ],
)  # fmt: skip
def test_quantities_of_a_linear_scene_are_those_of_a_gaussian(path, own, values):
    names = ["rms(q2)", "exceedance(q2,0.4)", "upcrossing_rate(q2,0.3)", "correlation(q1,q2)",
             "covariance(q1,p2)"]  # fmt: skip
    expected = []
    for value in values:
        system = replace(FREE, **own(value))
        P = stationary_covariance(system)
        rms = sqrt(P[1, 1])
        # Rice: ν(a) = σ_v/(2πσ_q) exp(−a²/2σ_q²).
        rate = sqrt(P[3, 3]) / system.mass[1] / rms / (2.0 * np.pi) * np.exp(-0.045 / P[1, 1])
        correlation = P[0, 1] / sqrt(P[0, 0] * P[1, 1])
        beyond = 0.5 * erfc(0.4 / (sqrt(2.0) * rms))
        expected.append([rms, beyond, rate, correlation, P[0, 3]])
    result = face.sweep(FREE, {path: values}, names, methods=["linear"])
    assert_values(result, np.transpose(expected), most=10.0)


def test_rates_and_passage_of_one_mass_are_those_of_a_square_root_process():
    """Damping c: λ = c/2m ± iω of the full system and sums of them, k c/m of the averaged energy.

    First passage with x = c H_f/D: mean (Ei(x) − ln x − γ)/c; the rate a root of 1F1(−λ/c; 1; x).
    """
    c = np.array([0.1, 0.2])
    names = [f"relaxation_rate({k})" for k in (2, 3, 1)]
    # Of the pairs (λ, λ*), (2λ, 2λ*) and λ + λ*: c/2m once, then c/m twice.
    known = {"linear": (c / 2, c / 2, c / 4), "nonintegrable": (c, 1.5 * c, c / 2)}
    for method, expected in known.items():
        system = face.System([2], [1], [0.1], [0.05])
        result = face.sweep(system, {"system.damping[1]": c}, names, methods=[method])
        assert_values(result, expected)
    system = face.System([1], [1], [0.1], [0.05])
    names = ["failure_rate(H=1.5)", "mean_passage(H=1.5)"]
    result = face.sweep(system, {"system.damping[1]": c}, names, methods=["nonintegrable"])
    x = c * 1.5 / 0.05
    rates = [0.013742123052434, 0.00244632003271456]
    mean = (expi(x) - np.log(x) - np.euler_gamma) / c
    assert_values(result, np.array([rates, mean]), most=100.0)


def test_a_run_and_a_sweep_give_the_same_numbers_by_the_same_names():
    stops = face.Contact(2, "left", 5.0, 0.2), face.Contact(2, "both", 10.0, 0.5)
    system = face.System([1, 2], [1, 1], [0.1, 0.2], [0.02, 0.02], contacts=stops)
    run = face.solve(system, ["q2", "H", "q1,q2"], methods=["nonintegrable"]).quantities
    names = [q.name for q in run]
    assert {"upcrossing_rate(1,left)", "upcrossing_rate(2,right)", "correlation(q1,q2)"} < {*names}
    kinds = ["contact_probability", "upcrossing_rate", "mean_force"]
    wanted = [*names, *(f"{kind}(2)" for kind in kinds), "force_in_contact(2)"]
    swept = face.sweep(system, {"system.mass[2]": [2.0, 3.0]}, wanted, methods=["nonintegrable"])
    assert not swept.problems and list(swept.quantities) == wanted
    numbers = (swept.field(name)[:, 0, 0] for name in ("value", "error"))
    found = dict(zip(wanted, zip(*numbers, strict=True), strict=True))
    for q in run:
        value, error = found[q.name]
        assert abs(value - q.number.value) <= error + q.number.error, q.name
    for kind in kinds:  # of both sides of a contact together the sum
        total, *parts = (np.array(found[f"{kind}(2{side})"]) for side in ("", ",left", ",right"))
        off, error = sum(parts) - total, sum(parts)[1] + total[1]
        assert abs(off[0]) <= error
    force, touching = found["mean_force(2)"][0], found["contact_probability(2)"][0]
    assert found["force_in_contact(2)"][0] == pytest.approx(force / touching, rel=1e-9)


def test_the_averaging_error_is_what_regime_maps():
    scene, text = load_scene("fig3a"), ["contact.clearance=0.5:2:2"]
    mapped = build_map(scene, text)
    swept = face.sweep(scene, text, ["averaging_error(q2)"])
    assert swept.methods == ("nonintegrable", "integrable")
    for k, point in enumerate(mapped.points):
        system = with_numbers(scene.system, {"contact.clearance": point["values"][0]})
        for j, theory in enumerate(swept.methods):
            (pair,) = face.compare(face.solve(system, ["q2"], methods=["exact", theory]))
            assert abs(point["L1"][theory] - pair.L1) <= point["error"][theory] + pair.error
            assert swept.field("value")[0, j, k] == point["L1"][theory]
            assert swept.points[k].answers[j].reference == point["reference"] == "exact"
        assert point["L1"]["nonintegrable"] < 1e-10


def test_a_value_whose_error_is_beyond_it_is_not_certified():
    # The numerical error of p behind the stop, about 1e-14, times the force there: B.
    names = ["mean_force(1)", "contact_probability(1)", "mean_overlap(1)"]
    values = {"contact.stiffness": [1e3, 1e30, 1e90]}
    result = face.sweep(load_scene("fig6a"), values, names, methods=["nonintegrable"])
    force, *others = result.field("certified")[:, 0]
    assert force.tolist() == [True, False, False] and all(other.all() for other in others)
    value, error = result.field("value")[0, 0], result.field("error")[0, 0]
    assert all(error[1:] >= value[1:]) and len(result.problems) == 2
    # A force that is zero but for rounding is known: no stop is ever reached.
    far = {"contact.clearance": [20.0, 30.0]}
    result = face.sweep(load_scene("fig6a"), far, names[:1], methods=["nonintegrable"])
    assert result.field("certified").all() and not result.problems
    rate = parse_definition("failure_rate(H=1.5)", FREE)
    assert rate.failures(Number(1e-9, 2e-9), None, FREE)
    assert not rate.failures(Number(1e-9, 5e-10), None, FREE)


LINE = ["sweep", "fig3a", "--vary", "contact.clearance=0.2:2:2", "--vary", "system.mass[1]=1,2",
        "--quantity", "rms(q2)", "--quantity", "quantile(q2,0.9)",
        "--quantity", "upcrossing_rate(1)", "--quantity", "correlation(q1,q2)",
        "--method", "exact"]  # fmt: skip
REGIME = ["regime", "fig3a", "--vary", "contact.clearance=0.5:2:4", "--seed", 4]


@pytest.mark.parametrize(
    ("line", "other"),
    [(LINE, ["--tol", "1e-6"]), (REGIME, ["--reference", "phase-space"])],
    ids=["sweep", "regime"],
)
def test_a_stopped_study_goes_on_and_is_the_same_to_the_bit(
    line, other, fpk, refusal, tmp_path, monkeypatch
):
    """Stopped while its fourth point would be written; then the last line is torn."""
    own, whole = tmp_path / "stopped", tmp_path / "whole"
    written = []

    def stopped(path, text):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        write_text(path, text)

    with monkeypatch.context() as context:
        context.setattr("cases.study.sweep.points.write_text", stopped)
        assert fpk(*line, "--out", own)[0] == 130
    (stored,) = own.glob("*.jsonl")
    stored.write_bytes(stored.read_bytes()[:-40])
    with pytest.warns(UserWarning, match="1 of its lines torn or changed, left out"):
        first = json.loads(fpk(*line, "--out", own, "--json")[1])
    second = json.loads(fpk(*line, "--out", whole, "--json")[1])
    assert (first["reused"], second["reused"]) == (2, 0)
    points = [[{**p, "seconds": 0} for p in record["points"]] for record in (first, second)]
    assert points[0] == points[1]
    for path in (path for ending in ("svg", "csv") for path in whole.glob(f"*.{ending}")):
        assert path.read_bytes() == (own / path.name).read_bytes()
    before = stored.read_text()
    assert "another run" in refusal(*line, *other, "--out", own)
    assert stored.read_text() == before


def test_two_axes_are_numeric_coordinates_and_a_heat_picture(fpk, tmp_path):
    status, out, err = fpk(*LINE, "--out", tmp_path)
    assert (status, err) == (0, "") and "4 points" in " ".join(out.split())
    with xr.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as data:
        assert data["value"].dims == ("quantity", "route", "contact.clearance", "system.mass.1")
        at = {"quantity": "rms(q2)", "route": "exact", "contact.clearance": 2.0}
        one = data.sel({**at, "system.mass.1": 1.0})
        assert one["certified"] == 1 and one["error_kind"] == "numerical"
        system = with_numbers(load_scene("fig3a").system, {"contact.clearance": 2.0})
        assert one["value"] == face.solve(system, ["q2"], methods=["exact"])["q2"].rms().value
    page = (tmp_path / "result.html").read_text(encoding="utf-8")
    assert page.count("<tr>") == 1 + 4 * 4 and "<img" in page
    assert "http:" not in page.replace("http://www.w3.org", "")
    # What made it, with the seed that nobody gave, and the files beside it.
    command = unescape(page.partition("<pre>fpk sweep")[2].partition("</pre>")[0])
    assert "fig3a" in command and "rms(q2)" in command and command.endswith("--seed 1")
    links = {*re.findall(r'href="([^":]*)" download', page)}
    files = set(os.listdir(tmp_path))
    assert {"result.md", "result.csv", "result.nc"} <= links <= files and "result.svg" in files


def test_a_quantity_without_any_value_is_drawn_as_nothing():
    clearances = {"contact.clearance": [0.5, 1e4]}
    for axes in (clearances, {**clearances, "system.mass[1]": [1.0, 2.0]}):
        result = face.sweep(load_scene("fig3a"), axes, ["rms(q2)"], methods=["integrable"])
        assert study_figure(result.panels()).axes and result.field("value").min() > 0.0
        points = [
            replace(p, answers=tuple(replace(a, value=None, failed=True) for a in p.answers))
            for p in result.points
        ]
        failed = replace(result, points=tuple(points))
        study_figure(failed.panels()).savefig(BytesIO(), format="svg")  # warnings are errors
        assert len(failed.problems) == len(points)


def test_simulations_have_bands_of_sampling(answer):
    record = answer(
        "sweep", "fig3a", "--vary", "contact[1].clearance=0.3,1", "--quantity", "rms(q2)",
        "--quantity", "upcrossing_rate(1,right)", "--quantity", "correlation(q1,q2)",
        "--method", "montecarlo", "--method", "exact", "--paths", 4096, "--time", 30,
    )  # fmt: skip
    assert record["methods"] == ["montecarlo", "exact"]
    for point in record["points"]:
        for sampled, exact in zip(point["answers"][::2], point["answers"][1::2], strict=True):
            assert (sampled["error_kind"], exact["error_kind"]) == ("sampling", "numerical")
            # Six comparisons at 5 standard errors: one false alarm in 300 000.
            assert abs(sampled["value"] - exact["value"]) < 5.0 * sampled["error"]
            assert sampled["error"] < 0.02 * abs(exact["value"])


@pytest.mark.parametrize(
    ("system", "quantities", "methods", "word"),
    [
        ("fig6a", ["rms(q1)"], (), "must be a System"),
        (FREE, "rms(q1)", (), "must be a list"),
        (FREE, [], (), "must be a list"),
        (FREE, ["rms(q1)"], "linear", "must be a list"),
        (FREE, ["rms(q1)"], ["linear/fem"], "is not a solver of linear"),
    ],
)
def test_mistakes_in_python_are_told_in_one_line(system, quantities, methods, word):
    with pytest.raises(face.InvalidInput) as refusal:
        face.sweep(system, {"system.mass[1]": [1, 2]}, quantities, methods=methods)
    assert word in str(refusal.value) and "\n" not in str(refusal.value)
    # A point that the system cannot take is named.
    vary = {"system.noise_intensity[1,2]": [0.0, 0.015], "system.noise_intensity[1]": [0.001, 1.0]}
    with pytest.raises(BadInput, match=r"\[1,2\] = 0.015, .*\[1\] = 0.001: .*semidefinite"):
        face.sweep(FREE, vary, ["rms(q1)"])


@pytest.mark.parametrize(
    ("grid", "values", "logarithmic"),
    [
        ("0.01:100:log5", [0.01, 0.1, 1.0, 10.0, 100.0], True),
        ("0:2:5", [0.0, 0.5, 1.0, 1.5, 2.0], False),
        ("1,10,100", [1.0, 10.0, 100.0], True),
        ("0,10,100", [0.0, 10.0, 100.0], False),
    ],
)
def test_a_grid_reaches_both_ends_and_decades_have_a_logarithmic_axis(grid, values, logarithmic):
    system = load_scene("fig6a").system
    (axis,) = parse_axes([f"contact[1].clearance={grid}"], system)
    assert axis.values.tolist() == values and axis.logarithmic == logarithmic
    assert axis.label == "clearance δ of contact 1"
    (of_all,) = parse_axes([f"contact.clearance={grid}"], system)
    assert of_all.symbol == "δ"


def test_a_sweep_in_python_has_labels_a_picture_and_a_table_for_a_notebook():
    result = face.sweep(FREE, {"system.stiffness[1]": np.array([1.0, 2.0])}, ["std(q1)"])
    data = result.to_xarray()
    assert data["system.stiffness.1"].values.tolist() == [1.0, 2.0]
    values = data["value"].sel(quantity="std(q1)", route="linear").values
    assert values[0] > values[1] > 0.0 and len(repr(result).splitlines()) == 1
    system = load_scene("fig3a").system
    names = ["rms(q2)", "exceedance(q2,1)"]
    methods = ["exact", "nonintegrable", "integrable"]
    one = face.sweep(system, CLEARANCES, names, methods=methods)
    axes = one.plot().axes
    assert [a.get_title("left") for a in axes] == names
    drawn = [np.asarray(line.get_ydata()) for line in axes[0].lines]  # the curve and its bars
    expected = pytest.approx(one.field("value")[0, 0], rel=1e-9)
    assert any(y.shape == (2,) and y == expected for y in drawn)
    page = one._repr_html_()
    assert page.count("<tr>") == 1 + 4 * 3 and "<td>0.3</td>" in page and "rms(q2)" in page
    # The page says which curve covers another one.
    (words,) = one.panels()[0].coincidences()
    assert words == "the lines of exact and energy averaging coincide"
    two = {**CLEARANCES, "contact[1].stiffness": [1.0, 10.0]}
    heat = face.sweep(system, two, ["rms(q2)"], methods=["exact"]).plot()
    assert heat.axes[0].get_title("left") == "rms(q2) by exact"


def test_a_sweep_says_what_each_method_solves_and_how_to_measure_the_averaging_error():
    names = ["mean_force(1)", "rms(q2)"]
    averaged = ["integrable", "nonintegrable"]
    result = face.sweep(load_scene("fig6a"), CLEARANCES, names, methods=averaged)
    assert result.solves == ("averaged", "averaged") == tuple(result.record()["solves"])
    (table,) = result.page().tables
    assert {row["solves"] for row in table.rows} == {"averaged"}
    remarks = "\n".join(table.remarks)
    assert "add --method montecarlo, or --method phase-space" in remarks
    assert "mean_force(1): of both sides of the contact, added up" in remarks
    assert "rms(q2): of both" not in remarks and "mean_force(1,left)" in remarks
    methods = ["exact", "nonintegrable"]
    exact = face.sweep(load_scene("fig3a"), CLEARANCES, ["rms(q2)"], methods=methods)
    assert exact.solves == ("full", "averaged")
    assert not any("averaging error" in remark for remark in exact.page().tables[0].remarks)
