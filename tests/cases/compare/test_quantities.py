"""Engineering quantities of a run: against closed forms, between routes, in tables."""

import json
import sys
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy import stats
from systems import in_units, mirrored

import fpk as face
from cases.compare.answers import Answers
from cases.compare.routes import method_for
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.presented import PresentedAnswers
from fpk.answer.density import Density
from fpk.numeric.errors import InvalidInput, Unavailable
from fpk.system.contact import Contact
from fpk.system.system import System

TEMPERATURE = 0.3
STOP = Contact(1, "right", 10.0, 0.3)
ONE = System([2.0], [1.0], [0.08], [0.08 * TEMPERATURE], contacts=(STOP,))
FREE = replace(ONE, contacts=())


@pytest.fixture(scope="module")
def one():
    """One mass at a stop: exact, averaged and simulated."""
    names = ["exact", "nonintegrable/fem", method_for("montecarlo", relaxations=20.0, seed=5)]
    return face.solve(ONE, ["q1", "H"], methods=names)


def numbers(answers):
    return {(q.quantity, q.route.label): q.number for q in answers.quantities}


def test_the_upcrossing_rate_follows_from_a_joint_density_too(one):
    joint = face.solve(ONE, ["q1,p1"], methods=["exact", "nonintegrable/fem"])
    rate = "upcrossing rate, right stop"
    pair = {("q1,p1", "covariance"), ("q1,p1", "correlation")}
    assert {(q.observable, q.quantity) for q in joint.quantities} == {("q1", rate)} | pair
    known, found = numbers(one), numbers(joint)
    exact, sampled = known[rate, "exact"], known[rate, "montecarlo"]
    for route in ("exact", "nonintegrable/fem"):
        number = found[rate, route]
        assert abs(number.value - exact.value) <= number.error + exact.error
    # 4.5 standard errors of a normal estimate: by chance of one in 1e5.
    assert abs(sampled.value - exact.value) < 4.5 * sampled.error < 0.1 * exact.value
    (comparison,) = [c for c in joint.quantity_comparisons if c.observable == f"q1: {rate}"]
    assert comparison.measures == "numerical" and comparison.holds
    without = face.solve(FREE, ["q1,p1", "q1"], methods=["exact"])
    assert not [q for q in without.quantities if "stop" in q.quantity]
    assert not [d for r in without.results for d in r.beside]


def test_a_stop_on_the_left_is_felt_as_one_on_the_right(one):
    """Mirrored, the system has the same contact; the mean is off 0 and enters the rms."""
    left, right = numbers(face.solve(mirrored(ONE), ["q1"], methods=["exact"])), numbers(one)
    felt = [name for name, _ in left if name.endswith("left stop")]
    assert len(felt) == 6
    for name in felt:
        a, b = left[name, "exact"], right[name.replace("left", "right"), "exact"]
        assert abs(a.value - b.value) <= a.error + b.error
    mean, std, rms = (left[name, "exact"].value for name in ("mean", "std", "rms"))
    assert mean > 0.1 * std and rms == pytest.approx(np.hypot(mean, std), rel=1e-12)


LEVELS = """
[system]
mass            = [1.0, 2.0]
stiffness       = [1.0, 0.5]
damping         = [0.08, 0.04]
noise_intensity = [0.024, 0.012]

[observe]
densities  = ["q2", "H", "p1"]
exceedance = { q2 = [1.0, -0.5, 3.0, 60.0], H = [0.6] }
"""
"""In equilibrium at the temperature; levels that are often, seldom and never exceeded."""


def test_exceedance_that_a_scene_asks_for_is_given_by_every_route(solved):
    """q2 has the variance T (1/k1 + 1/k2), and P(H > h) = (1 + h/T) e^(-h/T) of two masses."""
    names = ["linear", "exact", "nonintegrable", "integrable"]
    methods = [method_for(name) for name in names]
    methods += [method_for("montecarlo", paths=4096, relaxations=10.0, seed=11)]
    outcome = solved(LEVELS, *methods)
    (answers,) = outcome.curves
    normal = stats.norm(scale=np.sqrt(3.0 * TEMPERATURE))
    true = {("q2", str(a)): normal.sf(a) for a in (1, -0.5, 3, 60)}
    true["H", "0.6"] = 3.0 * np.exp(-2.0)
    rows = [q for q in answers.quantities if q.definition.kind == "exceedance"]
    assert len({q.route for q in rows}) == len(methods) and len(rows) == 5 * len(methods)
    for q in rows:
        level = q.quantity.removeprefix("probability above ")
        assert q.name == f"exceedance({q.observable},{level})"
        off = abs(q.number.value - true[q.observable, level])
        # By chance 4.5 standard errors: one in 1e5.
        assert off <= (4.5 if q.route.sampled else 1.0) * q.number.error + 1e-14, q
        assert 0.0 < q.number.error < 0.01
    assert not outcome.problems
    # What nobody asks for takes no share of the false alarms: the same samples may be off by less.
    fewer = replace(answers, exceedance=answers.exceedance[:1])
    many, own = (
        next(q for q in each.quantities if q.route.sampled and q.name == "std(q2)")
        for each in (answers, fewer)
    )
    assert many.number == own.number and many.reach > own.reach > own.number.error
    other = face.solve(replace(answers.system, stiffness=[1, 0.55]), ["q2"], methods=["exact"])
    results = (*other.results, *answers.results[-1:])
    wrong = replace(answers, results=results).quantity_comparisons
    assert not all(c.holds for c in wrong if "above" in c.observable)


def test_exceedance_stands_in_the_first_table_of_text_json_and_report(
    fpk, answer, written, units_text, tmp_path, monkeypatch
):
    path = written(LEVELS + units_text)
    monkeypatch.setenv("COLUMNS", "120")
    status, text, _ = fpk("run", path, "--no-simulation", "--out", tmp_path / "out")
    assert status == 0
    names = [f"probability of q2 > {level} mm" for level in ("1", "-0.5", "3", "60")]
    heads = [line[2:].partition("  ")[0] for line in text.splitlines()]
    k = heads.index(names[0])
    assert heads[k - 1].startswith("quantile 99 %") and heads[k : k + 4] == names
    rows = answer("run", path, "--no-simulation")["quantities"]
    rows = [row for row in rows if row["quantity"] == "probability above 3"]
    assert rows and {(row["name"], row["unit"]) for row in rows} == {("exceedance(q2,3)", "1")}
    assert "q2, probability of q2 &gt; 3 mm</td>" in (tmp_path / "out" / "report.html").read_text()


def test_the_routes_of_one_equation_agree_and_each_comparison_is_judged(one):
    assert not one.problems
    pairs = {(c.measures, c.band is None) for c in one.quantity_comparisons}
    assert pairs == {("numerical", False), ("sampling", False)}
    assert {c.observable.split(": ")[0] for c in one.quantity_comparisons} == {"q1", "H"}
    # The full system comes first and samples last; impacts stand beside the time in contact.
    routes = [q.route.label for q in one.quantities]
    assert routes[:3] == ["exact", "nonintegrable/fem", "montecarlo"]
    names = list(dict.fromkeys(q.quantity for q in one.quantities))
    k = names.index("contact probability, right stop")
    assert names[k + 1] == "upcrossing rate, right stop"
    with pytest.raises(InvalidInput, match="ask for that of a pair"):
        one["q1", "exact"].correlation()
    # One stop of two on a side is named by its place.
    stops = Contact(1, "right", 10.0, 0.3), Contact(1, "right", 5.0, 0.5), Contact(1, "left", 1, 1)
    answers = face.solve(replace(ONE, contacts=stops), ["q1"], methods=["exact"])
    where = [q.quantity.partition(", ")[2] for q in answers.quantities if "mean f" in q.quantity]
    assert where == ["right stop at 0.3", "right stop at 0.5", "left stop"]


@pytest.fixture(scope="module")
def free():
    """Energy of one mass without contact: exponential; exact, averaged and simulated."""
    system = System([1.0], [1.0], [0.5], [0.5])
    sampled = method_for("montecarlo", relaxations=150.0, seed=5)
    return face.solve(system, ["H"], methods=["exact", "nonintegrable/closed-form", sampled])


def failing(answers):
    return {c.observable for c in answers.quantity_comparisons if not c.holds}


def test_a_wrong_density_and_a_wrong_quantity_of_a_right_one_differ_from_a_simulation(
    free, monkeypatch
):
    """Two in a hundred too much energy: all but what has no unit is off; said once a pair."""
    exact, averaged, sampled = free.results
    assert not free.problems
    right = exact.densities[0]
    scaled = replace(
        right,
        panels=(right.panels[0] * 1.02,),
        pdf=lambda x: right.pdf(x / 1.02) / 1.02,
        pointwise=lambda x: right.pointwise(x / 1.02) / 1.02,
    )
    answers = Answers(free.system, (replace(exact, densities=(scaled,)), averaged, sampled))
    assert failing(answers) >= {"H: mean", "H: rms", "H: std", "H: median", "H: quantile 99 %"}
    assert not failing(answers) & {"H: skewness", "H: kurtosis"}
    assert len(answers.problems) == 2 and all("differ by L1" in p for p in answers.problems)
    own = Density.kurtosis
    monkeypatch.setattr(Density, "kurtosis", lambda d: replace(own(d), value=own(d).value * 1.1))
    answers = Answers(free.system, free.results)
    assert all(c.holds for c in answers.comparisons) and failing(answers) == {"H: kurtosis"}
    problems = answers.problems
    assert len(problems) == 2 and all(p.startswith("H: kurtosis: ") for p in problems)


def test_chance_explains_what_right_simulations_differ_by(free):
    """Short simulations, 10 seeds, 16 quantities: one of 500 such tests may call one wrong."""
    exact = face.solve(free.system, ["q1", "H"], methods=["exact"]).results
    for seed in range(10):
        method = method_for("montecarlo", paths=4096, relaxations=1.0, seed=seed)
        result = face.solve(free.system, ["q1", "H"], methods=[method]).results
        answers = Answers(free.system, exact + result)
        assert not failing(answers) and len(answers.quantity_comparisons) == 16, seed


@pytest.mark.parametrize("clearance", [4.0, 30.0])
def test_a_stop_that_no_sample_reached_is_no_contradiction(clearance):
    """The exact probabilities, 1e-13 and 0 in double precision, are beyond what samples see."""
    far = replace(ONE, contacts=(Contact(1, "right", 10.0, clearance),))
    sampled = method_for("montecarlo", paths=4096, relaxations=1.0, seed=2)
    answers = face.solve(far, ["q1"], methods=["exact", sampled])
    found = numbers(answers)
    touching = found["contact probability, right stop", "montecarlo"]
    assert touching.value == 0.0 and touching.error > 0.0
    force = found["mean force, right stop", "montecarlo"]
    assert force.value == 0.0 and (force.error > 0.0 or clearance > 10.0)
    assert found["force in contact, right stop", "montecarlo"].error == np.inf
    assert not answers.problems and "–" in answers._repr_html_()


def test_the_record_of_a_run_has_the_quantities_as_rows(solved, scene_text):
    vary = "\n[vary]\ncontact.stiffness = [1.0]\n"
    digest = digest_of(solved(scene_text + vary, "nonintegrable/closed-form"))
    keys = {"observable", "quantity", "name", "route", "value", "error", "error_kind"}
    for curve in (digest, *digest["curves"]):
        assert all(row.keys() == keys | {"label", "solves"} for row in curve["quantities"])
        assert len(curve["quantities"]) == 2 * 8 + 2 * 6  # of q2 and H, at two stops
    assert digest["schema"] == 2 and len(digest["curves"]) == 1
    json.dumps(digest, allow_nan=False)
    # Averaging errors are reported and not judged.
    answers = face.solve(
        load_scene("fig6a").system, ["q2"], methods=["nonintegrable", "integrable"]
    )
    assert {c.band for c in answers.quantity_comparisons} == {None} and not answers.problems


def test_frames_and_labelled_arrays_have_the_numbers_with_their_errors(one):
    frame = one.summary()
    for q in one.quantities:
        row = frame.loc[(q.observable, q.quantity), q.route.label]
        assert tuple(row) == (q.number.value, q.number.error, q.error_kind)
    assert [*frame.index] == list(dict.fromkeys((q.observable, q.quantity) for q in one.quantities))
    assert PresentedAnswers(ONE, ()).summary().empty

    data = one.to_xarray()
    at = data.sel(route_H="exact")["H"].to_numpy()
    values, errors = one["H", "exact"].at(at)
    np.testing.assert_array_equal(data["p_H"].sel(route_H="exact"), values)
    np.testing.assert_array_equal(data["error_H"].sel(route_H="exact"), errors)
    assert data["error_kind_q1"].sel(route_q1="montecarlo") == "sampling"


def test_a_plot_has_the_drawn_routes_and_a_logarithmic_axis_reaches_the_tail(one):
    (axes,) = one.plot("q1", log=True).axes
    assert axes.get_yscale() == "log" and axes.get_ylim()[0] < 1e-5
    (other,) = one.plot("q1").axes
    assert other.get_yscale() == "linear" and len(other.lines) >= 2
    with pytest.raises(InvalidInput, match="one of these has: q1; H"):
        one.plot("p1")
    (axes,) = one["H", "montecarlo"].plot(log=True).axes
    assert axes.get_yscale() == "log" and axes.lines
    assert axes.get_xlabel() and axes.get_ylabel()
    joint = face.solve(ONE, ["q1,p1"], methods=["exact"])
    for figure in (joint.plot("q1,p1", log=True), joint["q1,p1"].plot()):
        contours, bar = figure.axes
        assert contours.collections and "p(q₁, p₁)" in bar.get_ylabel()
    plt.close("all")


def test_a_notebook_shows_the_tables_and_a_missing_package_is_named(one, monkeypatch):
    page = one._repr_html_()
    assert page.count("<table>") == 2 and "contact probability, right stop" in page
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(Unavailable, match=r"vibro-fpk\[frames\]"):
        one.summary()


@pytest.mark.parametrize("unit", [pytest.param(1e-30, marks=pytest.mark.slow), 1e30])
def test_units_of_mass_length_and_time_are_free(unit):
    """The same system in other units: quantities differ by the unit and by round-off in errors."""
    routes = ["exact", "nonintegrable/fem"]
    observables = ["q1", "H", "q1,p1"]
    plain = face.solve(ONE, observables, methods=routes)
    for m, x, t in np.where(np.eye(3), unit, 1.0):
        force, energy = m * x / t**2, m * x**2 / t**2
        powers = {
            "skewness": 1.0,
            "kurtosis": 1.0,
            "correlation": 1.0,
            "covariance": x * m * x / t,
            "contact probability": 1.0,
            "upcrossing rate": 1.0 / t,
            "mean force": force,
            "force in contact": force,
            "mean overlap": x,
            "overlap in contact": x,
        }
        scaled = face.solve(in_units(ONE, m, x, t), observables, methods=routes)
        assert not scaled.problems
        for own, known in zip(scaled.quantities, plain.quantities, strict=True):
            kind = own.quantity.partition(",")[0]
            scale = powers.get(kind, energy if own.observable == "H" else x)
            off = abs(own.number.value / scale - known.number.value)
            assert off <= own.number.error / scale + known.number.error, (own.observable, kind)
            # Round-off depends on the unit; errors of quantiles begin at 1e-14 of the support.
            assert own.number.error / scale <= 30.0 * known.number.error + 1e-12


@pytest.mark.parametrize("route", ["linear", "nonintegrable/fem"])
def test_a_rare_exceedance_and_its_quantile_are_within_their_errors(route):
    density, scale = face.solve(FREE, ["q1"], methods=[route])["q1"], np.sqrt(TEMPERATURE)
    for p in (1e-300, 1e-30, 1e-12):
        x = stats.norm.isf(p) * scale
        number = density.exceedance(x)
        assert abs(number.value - p) <= number.error and number.error < 1e-13
        for share, true in ((p, -x), (1.0 - p, stats.norm.ppf(1.0 - p) * scale)):
            if 0.0 < share < 1.0:
                quantile = density.quantile(share)
                assert abs(quantile.value - true) <= quantile.error
