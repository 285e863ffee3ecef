"""Sweeps: values against closed forms, paths and grids that are refused, going on after a kill."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from html import unescape
from io import BytesIO
from math import sqrt

import mpmath
import numpy as np
import pytest
import xarray as xr
from scipy.linalg import solve_continuous_lyapunov
from scipy.special import erfc

import fpk as face
from cases.compare.quantity import parse_definition
from cases.scene.errors import BadInput
from cases.scene.numbers import with_numbers
from cases.scene.scene import load_scene
from cases.show.pictures.draw import study_figure
from cases.study.regime_map import build_map
from cases.study.sweep.grid import parse_axes
from fpk.answer.quantities import Number

FREE = face.System([1, 2], [1, 3], [0.1, 0.2], [[0.02, 0.01], [0.01, 0.04]])
ROUND_OFF = 1e-12
"""Relative error of the judges below, solved in double precision."""


def covariance(system):
    """P of (q, v) by the Lyapunov equation A P + P Aᵀ + 2 f D fᵀ = 0, written here anew."""
    n, m = system.n, 1.0 / system.mass[:, None]
    drift = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-m * system.stiffness_matrix, -m * system.damping]]
    )
    noise = np.zeros((2 * n, 2 * n))
    noise[n:, n:] = 2.0 * m * system.noise_matrix * m.T
    return solve_continuous_lyapunov(drift, -noise)


@pytest.mark.parametrize(
    ("path", "own", "values"),
    [
        ("system.mass[2]", lambda v: {"mass": [1, v]}, [0.5, 3.0]),
        ("system.damping", lambda v: {"damping": FREE.damping * v}, [0.5, 2.0]),
        ("system.damping[2]", lambda v: {"damping": [0.1, v]}, [0.05, 2.0]),
        (
            "system.noise_intensity[2,1]",
            lambda v: {"noise_intensity": [[0.02, v], [v, 0.04]]},
            [-0.02, 0.0],
        ),
    ],
)
def test_rms_and_exceedance_of_a_linear_scene_are_those_of_lyapunov(path, own, values):
    fields = {"mass": [1, 2], "stiffness": [1, 3], "damping": [0.1, 0.2]}
    fields["noise_intensity"] = FREE.noise_intensity
    result = face.sweep(FREE, {path: values}, ["rms(q2)", "exceedance(q2,0.4)"], methods=["linear"])
    assert not result.problems
    for k, value in enumerate(values):
        rms = sqrt(covariance(face.System(**fields | own(value)))[1, 1])
        beyond = 0.5 * erfc(0.4 / (sqrt(2.0) * rms))
        # d ln P / d ln rms = (x/rms)² and a little more: 10 covers it for x < 2.5 rms.
        for i, (exact, worth) in enumerate([(rms, 1.0), (beyond, 10.0)]):
            found = result.field("value")[i, 0, k], result.field("error")[i, 0, k]
            assert abs(found[0] - exact) <= found[1] + worth * ROUND_OFF * exact


def test_upcrossings_and_correlations_of_a_linear_scene_are_those_of_a_gaussian():
    names = ["upcrossing_rate(q2,0.3)", "correlation(q1,q2)", "covariance(q1,p2)"]
    result = face.sweep(FREE, {"system.mass[2]": [0.5, 3.0]}, names, methods=["linear"])
    assert not result.problems
    for k, mass in enumerate([0.5, 3.0]):
        P = covariance(replace(FREE, mass=[1.0, mass]))
        # Rice: ν(a) = σ_v/(2πσ_q) exp(−a²/2σ_q²).
        rate = sqrt(P[3, 3] / P[1, 1]) / (2.0 * np.pi) * np.exp(-0.045 / P[1, 1])
        judges = rate, P[0, 1] / sqrt(P[0, 0] * P[1, 1]), mass * P[0, 3]
        for i, exact in enumerate(judges):
            value, error = result.field("value")[i, 0, k], result.field("error")[i, 0, k]
            # The exponent of the rate is 2.2 at most: 10 covers what it makes of P's error.
            assert abs(value - exact) <= error + 10.0 * ROUND_OFF and error < 1e-9


def test_relaxation_rates_are_those_of_the_drift_matrix_and_of_a_square_root_process():
    # One mass without contact: λ = c/2m ± iω and sums of them; the averaged energy has k c/m.
    system = face.System([2], [1], [0.1], [0.05])
    names = [f"relaxation_rate({k})" for k in (2, 3, 1)]
    result = face.sweep(system, {"system.damping[1]": [0.1, 0.2]}, names,
                        methods=["linear", "nonintegrable"])  # fmt: skip
    assert not result.problems
    for k, c in enumerate([0.1, 0.2]):
        # Of the pairs (λ, λ*), (2λ, 2λ*) and λ + λ*: c/2m once, then c/m twice.
        for j, judges in enumerate([(c / 2, c / 2, c / 4), (c, 1.5 * c, c / 2)]):
            for i, exact in enumerate(judges):
                value, error = result.field("value")[i, j, k], result.field("error")[i, j, k]
                assert abs(value - exact) <= error + ROUND_OFF * exact, (names[i], j)


def test_a_run_and_a_sweep_give_the_same_numbers_by_the_same_names():
    stops = face.Contact(2, "left", 5.0, 0.2), face.Contact(2, "both", 10.0, 0.5)
    system = face.System([1, 2], [1, 1], [0.1, 0.2], [0.02, 0.02], contacts=stops)
    run = face.solve(system, ["q2", "H", "q1,q2"], methods=["nonintegrable"]).quantities
    names = [q.name for q in run]
    assert {"upcrossing_rate(1,left)", "upcrossing_rate(2,right)", "correlation(q1,q2)"} < {*names}
    kinds = ["contact_probability", "upcrossing_rate", "mean_force"]
    wanted = [*names, *(f"{kind}(2)" for kind in kinds)]
    swept = face.sweep(system, {"system.mass[2]": [2.0, 3.0]}, wanted, methods=["nonintegrable"])
    assert not swept.problems
    values, errors = (
        dict(zip(wanted, swept.field(f)[:, 0, 0], strict=True)) for f in ("value", "error")
    )
    for q in run:
        assert abs(values[q.name] - q.number.value) <= errors[q.name] + q.number.error, q.name
    for kind in kinds:  # of both sides of a contact together the sum
        parts = [f"{kind}(2,{side})" for side in ("left", "right")]
        off = abs(values[f"{kind}(2)"] - sum(values[part] for part in parts))
        assert off <= errors[f"{kind}(2)"] + sum(errors[part] for part in parts)


def test_failure_rate_is_the_root_of_the_confluent_function():
    # One mass without contact: H is a CIR process, 1F1(−λ/c; 1; c H_f/D) = 0.
    system = face.System([1], [1], [0.1], [0.05])
    vary = {"system.damping[1]": [0.1, 0.2]}
    names = ["failure_rate(H=1.5)", "mean_passage(H=1.5)"]
    result = face.sweep(system, vary, names, methods=["nonintegrable"])
    for k, (c, guess) in enumerate([(0.1, 0.0137), (0.2, 0.0025)]):
        x = mpmath.mpf(c) * 1.5 / 0.05

        def confluent(rate, c=c, x=x):
            return mpmath.hyp1f1(-rate / c, 1, x)

        mean = float((mpmath.ei(x) - mpmath.log(x) - mpmath.euler) / c)
        exact = (
            float(mpmath.findroot(confluent, (0.5 * guess, 1.5 * guess), solver="anderson")),
            mean,
        )
        for i in range(2):
            value, error = result.field("value")[i, 0, k], result.field("error")[i, 0, k]
            # The sum of the confluent series loses no digits for x = 3, 6: terms of one sign but
            # the first.
            assert abs(value - exact[i]) <= error + ROUND_OFF * exact[i]
            assert error < 1e-6 * exact[i]


def test_both_sides_of_a_contact_are_felt_as_by_the_exact_density():
    stop = face.Contact(mass=1, side="both", stiffness=10.0, clearance=0.5)
    system = face.System([1], [1], [0.1], [0.05], contacts=(stop,))  # c/D = 2
    names = ["contact_probability(1)", "mean_force(1)", "force_in_contact(1)"]
    result = face.sweep(system, {"contact[1].clearance": [0.3, 0.5]}, names, methods=["exact"])
    for k, delta in enumerate([0.3, 0.5]):

        def weight(q, delta=delta):
            return mpmath.exp(-q * q - 8.0 * max(q - delta, mpmath.mpf(0)) ** 2.5)

        inside = mpmath.quad(weight, [0, delta])
        touching = mpmath.quad(weight, [delta, 1, 2, 4])
        force = mpmath.quad(lambda q: 10 * (q - delta) ** 1.5 * weight(q), [delta, 1, 2, 4])  # noqa: B023
        judge = touching / (inside + touching), force / (inside + touching), force / touching
        for i, exact in enumerate(map(float, judge)):
            value, error = result.field("value")[i, 0, k], result.field("error")[i, 0, k]
            assert abs(value - exact) <= error + ROUND_OFF * exact and error < 1e-6 * exact


def test_the_averaging_error_is_what_regime_maps():
    scene = load_scene("fig3a")
    text = ["contact.clearance=0.5:2:2"]
    mapped = build_map(scene, text)
    swept = face.sweep(scene, text, ["averaging_error(q2)"])
    assert swept.methods == ("nonintegrable", "integrable")
    for k, point in enumerate(mapped.points):
        system = with_numbers(scene.system, {"contact.clearance": point.values[0]})
        methods = [*swept.methods, "exact"]
        q = np.linspace(-8.0, 8.0, 40_001)  # p(8) < exp(-32): the largest rms is 1
        *theories, exact = (face.solve(system, ["q2"], methods=[m])["q2"].at(q)[0] for m in methods)
        for j, theory in enumerate(swept.methods):
            judge = np.trapezoid(np.abs(theories[j] - exact), q)
            # The trapezoidal rule is off by the step times the total variation at most.
            variation = np.abs(np.diff(theories[j])).sum() + np.abs(np.diff(exact)).sum()
            assert abs(point.L1[theory] - judge) <= (q[1] - q[0]) * variation + point.error[theory]
            assert swept.field("value")[0, j, k] == point.L1[theory]
            assert swept.points[k].answers[j].reference == point.reference == "exact"


def test_a_force_whose_error_is_beyond_it_is_not_certified():
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


def test_a_rate_whose_error_is_beyond_it_is_not_certified():
    rate = parse_definition("failure_rate(H=1.5)", FREE)
    assert rate.failures(Number(1e-9, 2e-9), None, FREE)
    assert not rate.failures(Number(1e-9, 5e-10), None, FREE)


LINE = ["sweep", "fig3a", "--vary", "contact.clearance=0.2:2:3", "--vary", "system.mass[1]=1,2",
        "--quantity", "rms(q2)", "--quantity", "quantile(q2,0.9)",
        "--quantity", "upcrossing_rate(1)", "--quantity", "correlation(q1,q2)"]  # fmt: skip


KILLED = """
import os, signal
replace, points = os.replace, []
def killed(source, path):
    points.extend([path] if str(path).endswith("points.jsonl") else [])
    if len(points) == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, path)
os.replace = killed
from cases.command.cli import main
main()
"""
"""A run that is killed by the system in the moment in which its fourth point would be on disk."""


def test_a_killed_sweep_goes_on_and_is_the_same_to_the_bit(fpk, tmp_path):
    line = [sys.executable, "-c", KILLED, *LINE, "--out", str(tmp_path / "killed")]
    ended = subprocess.run(line, capture_output=True, check=False)
    assert ended.returncode == -signal.SIGKILL
    records = [
        json.loads(fpk(*LINE, "--out", tmp_path / folder, "--json")[1])
        for folder in ("killed", "whole")
    ]
    assert [record["reused"] for record in records] == [3, 0]
    again, whole = ([{**point, "seconds": 0} for point in record["points"]] for record in records)
    assert again == whole
    for ending in ("svg", "csv"):
        texts = [(tmp_path / f / f"result.{ending}").read_bytes() for f in ("killed", "whole")]
        assert texts[0] == texts[1]
    # Points of other quantities, methods or scenes are not mixed with these.
    for other in (["--quantity", "mean(q2)"], ["--method", "exact"], ["--tol", "1e-6"]):
        status, out, err = fpk(*LINE, *other, "--out", tmp_path / "whole")
        assert (status, out) == (2, "") and err.count("\n") == 1 and "another run" in err


def test_two_axes_are_numeric_coordinates_and_a_heat_picture(fpk, tmp_path):
    status, out, err = fpk(*LINE, "--out", tmp_path)
    assert (status, err) == (0, "") and "6 points" in out
    with xr.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as data:
        assert data["value"].dims == ("quantity", "route", "contact.clearance", "system.mass.1")
        at = {"quantity": "rms(q2)", "route": "exact", "contact.clearance": 2.0}
        one = data.sel({**at, "system.mass.1": 1.0})
        assert one["certified"] == 1 and one["error_kind"] == "numerical"
        system = with_numbers(load_scene("fig3a").system, {"contact.clearance": 2.0})
        assert one["value"] == face.solve(system, ["q2"], methods=["exact"])["q2"].rms().value
    page = (tmp_path / "result.html").read_text(encoding="utf-8")
    assert (
        page.count("<tr>") == 1 + 6 * 4 * 3
        and "<svg" in page
        and "http:" not in page.replace("http://www.w3.org", "")
    )
    assert {"result.md", "result.svg", "result.csv"} <= set(os.listdir(tmp_path))
    # What made it, with the seed that nobody gave, and the files beside it.
    command = unescape(page.partition("<pre>fpk sweep")[2].partition("</pre>")[0])
    assert "fig3a" in command and "rms(q2)" in command and command.endswith("--seed 1")
    links = re.findall(r'href="([^":]*)" download', page)
    assert {"result.md", "result.csv", "result.nc"} <= set(links) <= set(os.listdir(tmp_path))


@pytest.mark.parametrize("values", [[0.5, 1.0], [0.5, 1e4]])
def test_a_quantity_without_any_value_is_drawn_as_nothing(values):
    vary = {"contact.clearance": values, "system.mass[1]": [1.0, 2.0]}
    for axes in (vary, {"contact.clearance": values}):
        result = face.sweep(load_scene("fig3a"), axes, ["rms(q2)"], methods=["integrable"])
        none = [
            replace(p, answers=tuple(replace(a, value=None, failed=True) for a in p.answers))
            for p in result.points
        ]
        assert study_figure(result.panels()).axes and result.field("value").min() > 0.0
        failed = replace(result, points=tuple(none))
        study_figure(failed.panels()).savefig(BytesIO(), format="svg")  # warnings are errors
        assert len(failed.problems) == len(none)


def test_simulations_have_bands_of_sampling(fpk):
    line = ["sweep", "fig3a", "--vary", "contact[1].clearance=0.3,1", "--quantity", "rms(q2)",
            "--quantity", "upcrossing_rate(1,right)", "--quantity", "correlation(q1,q2)",
            "--method", "montecarlo", "--method", "exact", "--paths", 4096,
            "--time", 30]  # fmt: skip
    status, out, _ = fpk(*line, "--json")
    record = json.loads(out)
    assert status == 0 and record["methods"] == ["montecarlo", "exact"]
    for point in record["points"]:
        rows = point["answers"]
        for sampled, exact in zip(rows[::2], rows[1::2], strict=True):
            assert (sampled["error_kind"], exact["error_kind"]) == ("sampling", "numerical")
            # Six comparisons at 5 standard errors: one false alarm in 300 000.
            assert abs(sampled["value"] - exact["value"]) < 5.0 * sampled["error"]
            assert sampled["error"] < 0.02 * abs(exact["value"])


@pytest.mark.parametrize(
    ("vary", "word"),
    [
        ("contact[2].clearance=1,2", "contact[1..1].clearance"),
        ("contact[0].clearance=1,2", "contact[1..1].clearance"),
        ("contact[1].mass=1,2", "contact[1..1].clearance"),
        ("system.mass[3]=1,2", "system.mass[1..2]"),
        ("system.damping[1,3]=1,2", "system.damping[1..2,1..2]"),
        ("system.mass[1,1]=1,2", "system.mass[1..2]"),
        ("system.__class__=1,2", "is no number"),
        ("damping_term[1].coefficient=1,2", "is no number"),
        ("system.mass[1]=2,1", "ascend"),
        ("system.mass[1]=1", "two numbers"),
        ("system.mass[1]=1,x", "is no grid"),
        ("system.mass[1]=", "is no grid"),
        ("system.mass[1]=nan,1", "is no grid"),
        ("system.mass[1]=-1,1", "positive"),
        ("system.noise_intensity[1,2]=0,1", "semidefinite"),
        ("contact[1].exponent=1,2", "law"),
    ],
)
def test_what_is_no_number_of_the_scene_or_no_grid_is_one_line(fpk, vary, word):
    status, out, err = fpk("sweep", "fig6a", "--vary", vary, "--quantity", "rms(q2)")
    assert (status, out) == (2, "") and err.count("\n") == 1 and word in err


def test_a_point_that_the_system_cannot_take_is_named():
    vary = {"system.noise_intensity[1,2]": [0.0, 0.015], "system.noise_intensity[1]": [0.001, 1.0]}
    with pytest.raises(BadInput, match=r"\[1,2\] = 0.015, .*\[1\] = 0.001: .*semidefinite"):
        face.sweep(FREE, vary, ["rms(q1)"])


@pytest.mark.parametrize(
    "second", ["contact.clearance=1,2", "contact[1].clearance=1,2", "contact[1].clearance=3:4:2"]
)
def test_axes_that_change_the_same_number_are_refused(second):
    with pytest.raises(BadInput, match="varied already"):
        parse_axes(["contact[1].clearance=1,2", second], load_scene("fig6a").system)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("rm(q2)", "did you mean rms?"),
        ("rms", "use one of mean(q1)"),
        ("rms(q3)", "is not an observable"),
        ("rms(q1,q2)", "is a pair"),
        ("quantile(q2,1)", "between 0 and 1"),
        ("exceedance(q2)", "must be a finite number"),
        ("exceedance(q2,inf)", "must be a finite number"),
        ("exceedance(q2,__import__('os'))", "must be a finite number"),
        ("mean_force(2)", "use 1 to 1"),
        ("mean_force(1,up)", "use left or right"),
        ("mean_force(1,left,right)", "use left or right"),
        ("correlation(q1)", "name a pair"),
        ("upcrossing_rate(q1)", "must be a finite number"),
        ("upcrossing_rate(p1,1)", "is no contact"),
        ("upcrossing_rate(q3,1)", "is not an observable"),
        ("relaxation_rate(0)", "from 1 to 100"),
        ("relaxation_rate(101)", "from 1 to 100"),
        ("relaxation_rate(" + "9" * 5000 + ")", "from 1 to 100"),
        ("failure_rate(H)", "use H=1.5"),
        ("__class__(q2)", "is no quantity"),
    ],
)
def test_what_is_no_quantity_is_one_line(text, word):
    with pytest.raises(face.InvalidInput) as refusal:
        parse_definition(text, load_scene("fig6a").system)
    assert word in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_method_that_gives_nothing_anywhere_is_refused(fpk):
    line = ["sweep", "fig6a", "--vary", "contact.clearance=1,2", "--quantity"]
    for more, word in (
        (["rms(q2)", "--method", "linear"], "linear: no value anywhere: the system has contacts"),
        (["rms(q2)", "--method", "lin"], "use one of"),
        (["mean_passage(q2=3)", "--method", "exact"], "gives no first passage"),
    ):
        status, out, err = fpk(*line, *more)
        assert (status, out) == (2, "") and err.count("\n") == 1 and word in err


def test_names_are_what_a_user_writes_and_read_again():
    system = load_scene("fig6a").system
    texts = ("rms(q2)", "quantile(H,0.99)", "mean_force(1)", "failure_rate(H1=0.4,H2=0.6)",
             "mean_force(1,left)", "upcrossing_rate(1)", "upcrossing_rate(q2,0.5)",
             "correlation(q1,q2)", "relaxation_rate(3)")  # fmt: skip
    for text in texts:
        assert str(parse_definition(f" {text} ", system)) == text


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


def test_a_tolerance_out_of_range_is_refused(fpk):
    status, out, err = fpk(*LINE, "--tol", "0")
    assert (status, out) == (2, "") and "--tol 0" in err and err.count("\n") == 1


def test_a_sweep_in_python_is_labelled_and_takes_arrays():
    result = face.sweep(FREE, {"system.stiffness[1]": np.array([1.0, 2.0])}, ["std(q1)"])
    data = result.to_xarray()
    assert data["system.stiffness.1"].values.tolist() == [1.0, 2.0]
    values = data["value"].sel(quantity="std(q1)", route="linear").values
    assert values[0] > values[1] > 0.0 and len(repr(result).splitlines()) == 1


@pytest.mark.parametrize(
    ("grid", "logarithmic"), [("1,10,100", True), ("1,2,3", False), ("0,10,100", False)]
)
def test_a_list_over_decades_is_drawn_on_a_logarithmic_axis(grid, logarithmic):
    (axis,) = parse_axes([f"contact[1].clearance={grid}"], load_scene("fig6a").system)
    assert axis.logarithmic == logarithmic and axis.label == "clearance δ of contact 1"


def test_a_sweep_in_python_has_a_picture_and_a_table_for_a_notebook():
    system = load_scene("fig3a").system
    grid = {"contact[1].clearance": [0.3, 0.5]}
    one = face.sweep(system, grid, ["rms(q2)", "exceedance(q2,1)"], methods=["exact"])
    axes = one.plot().axes
    assert [a.get_title("left") for a in axes] == ["rms(q2)", "exceedance(q2,1)"]
    drawn = [np.asarray(line.get_ydata()) for line in axes[0].lines]  # the curve and its bars
    expected = pytest.approx(one.field("value")[0, 0], rel=1e-9)
    assert any(y.shape == (2,) and y == expected for y in drawn)
    page = one._repr_html_()
    assert page.count("<tr>") == 5 and "<td>0.3</td>" in page and "rms(q2)" in page
    two = {**grid, "contact[1].stiffness": [1.0, 10.0]}
    heat = face.sweep(system, two, ["rms(q2)"], methods=["exact"]).plot()
    assert heat.axes[0].get_title("left") == "rms(q2) by exact"


def test_a_sweep_says_what_each_method_solves_and_how_to_measure_the_averaging_error():
    scene = load_scene("fig6a")
    grid = {"contact[1].clearance": [0.5, 0.6]}
    names = ["mean_force(1)", "rms(q2)"]
    result = face.sweep(scene, grid, names, methods=["integrable", "nonintegrable"])
    assert result.solves == ("averaged", "averaged") == tuple(result.record()["solves"])
    (table,) = result.page().tables
    assert {row["solves"] for row in table.rows} == {"averaged"}
    remarks = "\n".join(table.remarks)
    assert "add --method phase-space or --method montecarlo" in remarks
    assert "mean_force(1): of both sides of the contact, added up" in remarks
    assert "rms(q2): of both" not in remarks and "mean_force(1,left)" in remarks
    exact = face.sweep(load_scene("fig3a"), grid, ["rms(q2)"], methods=["exact", "nonintegrable"])
    assert exact.solves == ("full", "averaged")
    assert not any("averaging error" in remark for remark in exact.page().tables[0].remarks)


def test_a_curve_that_covers_another_one_names_it():
    grid = {"contact[1].clearance": [0.3, 0.5]}
    methods = ["exact", "nonintegrable", "integrable"]
    result = face.sweep(load_scene("fig3a"), grid, ["rms(q2)"], methods=methods)
    (panel,) = result.panels()
    exact, energy, modal = (curve.name for curve in panel.curves)
    assert exact == "exact" and "covers exact" in energy and "covers" not in modal
