"""``[units]`` of a scene on axes, in tables, JSON and files; modes and rms of ``fpk show``."""

import csv
import json
import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import eigh

from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.numbers import place_of
from cases.scene.scene import load_scene, shipped_scenes
from cases.scene.units import DERIVED, DIMENSIONS, Units
from cases.show.facts import modes_record, rms_record
from cases.show.pictures.draw import study_figure
from cases.show.pictures.style import density_words, in_units, time_words, words_of
from cases.show.report import figures
from cases.study.cost import CostStudy
from cases.study.law import FULL, Law
from cases.study.prices import Priced
from cases.study.sweep.sweep import sweep
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.linear import stationary_covariance
from fpk.system.system import System

SI = Units("m", "kg", "s")


@pytest.fixture
def scene(written, scene_text, units_text):
    return written(scene_text + units_text)


@pytest.fixture
def bare(written, scene_text):
    """The same without units."""
    return written(scene_text, "bare.toml")


def powers(unit):
    """The powers that a unit in words stands for."""
    plain = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    found = dict.fromkeys(("m", "kg", "s"), 0)
    for factor in unit.split():
        name = factor.rstrip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
        found[name] += int(factor[len(name) :].translate(plain) or 1)
    return found["m"], found["kg"], found["s"]


def test_units_say_their_powers_and_fit_together():
    """Force = mass · acceleration, energy = force · length, momentum = force · time."""
    for dimension in product((-3, 0, 1, 12), repeat=3):
        unit, inverse = SI.of(dimension), SI.of(dimension, inverse=True)
        if any(dimension):
            assert powers(unit) == dimension == tuple(-power for power in powers(inverse))
        else:
            assert unit == inverse == "1"
        assert Units().of(dimension) == ""
    units = {name: np.array(powers(SI.quantity(name))) for name in DERIVED}
    length, mass, time = np.eye(3, dtype=int)
    np.testing.assert_array_equal(units["force"], mass + length - 2 * time)
    np.testing.assert_array_equal(units["energy"], units["force"] + length)
    np.testing.assert_array_equal(units["momentum"], units["force"] + time)
    np.testing.assert_array_equal(units["momentum"], mass + units["velocity"])
    for name in ("q2", "p1", "H", "H1", "q2,p2", "q1,H"):
        observable = parse_observable(name, 2)
        own = sum(np.array(powers(SI.coordinate(c))) for c in observable)
        density = SI.density(observable)
        np.testing.assert_array_equal(powers(density) if density != "1" else 0, -own)
    assert DIMENSIONS.keys() == {"q", "p", "H"}


BAD = [
    ('length = "mm"\nmass = "kg"', "units.time is missing"),
    ('length = "mm"\nmass = "kg"\ntime = "mm"', "something else"),
    ('length = "m/s"\nmass = "kg"\ntime = "s"', "letters"),
    (f'length = "{"m" * 17}"\nmass = "kg"\ntime = "s"', "letters"),
    ('length = 1\nmass = "kg"\ntime = "s"', "text in quotes"),
    ('lenght = "m"\nmass = "kg"\ntime = "s"', 'did you mean "length"'),
    ('length = "m"\nmass = "kg"\ntime = "s"\nforce = "N"', "here are known"),
]


@pytest.mark.parametrize(("table", "word"), BAD)
def test_bad_tables_of_units_are_refused(table, word, refusal, written, scene_text):
    err = refusal("check", written(f"{scene_text}[units]\n{table}\n"))
    assert word in err and "units" in err


ASKED = [
    (["density", "--of", "q2", "--at", "0"], {"points": "mm", "density": "mm⁻¹", "times": "s"}),
    (
        ["density", "--of", "q2,p2", "--at", "0 x 0"],
        {"points": ["mm", "kg mm s⁻¹"], "density": "s kg⁻¹ mm⁻²", "times": "s"},
    ),
    (
        ["passage", "--limit", "H=0.5"],
        {"limit": "kg mm² s⁻²", "mean": "s", "variance": "s²", "rate": "s⁻¹", "times": "s"},
    ),
    (["relaxation", "--rates", "1"], {"rates": "s⁻¹", "frequencies": "s⁻¹"}),
]


@pytest.mark.parametrize(("question", "units"), ASKED)
def test_answers_say_the_units_of_their_numbers(question, units, scene, bare, answer, fpk):
    command, *options = question
    options = ["--method", "nonintegrable", *options]
    assert answer(command, scene, *options)["units"] == units
    text = fpk(command, scene, *options)[1]
    assert any(f"[{unit}]" in text or f"  {unit}\n" in text for unit in map(str, units.values()))
    assert answer(command, bare, *options)["units"] is None
    assert "[" not in fpk(command, bare, *options)[1]


@pytest.mark.parametrize(
    ("command", "points", "values"),
    [("crossings", "mm", "s⁻¹"), ("spectrum", "s⁻¹", "mm² s"), ("correlation", "s", "mm²")],
)
def test_curves_say_their_units_on_both_axes(
    command, points, values, fpk, answer, written, linear_text, units_text
):
    path = written(linear_text + units_text)
    arguments = (command, path, "--method", "linear", "--of", "q1", "--at", "0,0.5")
    key = {"crossings": "rate"}.get(command, command)
    assert answer(*arguments)["units"] == {"points": points, key: values}
    head = fpk(*arguments)[1].splitlines()[0]
    assert f"[{points}]" in head and f"{key} [{values}]" in head


def test_the_tables_of_a_run_say_units(written, units_text, tmp_path, fpk, answer):
    """On the terminal, in the report, in JSON: rows of quantities, answers in time."""
    text, how = shipped_scenes()["two-modes"].read_text(), ("--method", "integrable/closed-form")
    path = written(text + units_text)
    out = fpk("run", path, *how, "--out", tmp_path / "out")[1]
    assert "mean [kg mm² s⁻²]" in out and "mean time [s]" in out and "failure rate [s⁻¹]" in out
    page = (tmp_path / "out" / "report.html").read_text()
    assert "H1, mean [kg mm² s⁻²]" in page and "mean time [s]" in page and "skewness [" not in page
    record = answer("run", path, *how)
    units = {q["quantity"]: q["unit"] for q in record["quantities"]}
    assert units["rms"] == "kg mm² s⁻²" and units["skewness"] == "1"
    assert record["passages"][0]["units"] == ASKED[2][1]
    path = written(text)
    assert "[" not in fpk("run", path, *how)[1]
    record = answer("run", path, *how)
    assert not any("unit" in q for q in record["quantities"])
    assert record["passages"][0]["units"] is None


def test_a_quantity_has_the_unit_of_its_name():
    for names, of in (
        (("mean", "quantile 99 %", "mean overlap, left stop"), (1, 0, 0)),
        (("variance",), (2, 0, 0)),
        (("force in contact, right stop at 0.5", "mean_force"), (1, 1, -2)),
        (("upcrossing rate, left stop", "failure_rate", "impacts per unit time"), (0, 0, -1)),
        (("mean_passage",), (0, 0, 1)),
    ):
        assert {powers(SI.number(name, "q2")) for name in names} == {of}
    none = "contact probability, left stop", "averaging_error", "share of time in contact"
    assert {SI.number(name, "q2") for name in (*none, "exceedance")} == {"1"}
    assert Units().number("mean", "q2") == ""
    # A covariance has the product of both units.
    assert SI.number("covariance", "q2,p2") == SI.of(DIMENSIONS["q"], DIMENSIONS["p"])
    with pytest.raises(InvalidInput, match="mass"):
        Units("m", "m", "s")


def test_numbers_of_a_scene_have_units_that_keep_its_equations():
    """Forces k q, c v, B x^e, and D over time, by the powers of what they are made of."""
    term = DampingTerm(1, 1, 0.1, ((1, 2),), ((2, 1),), 1)
    stop = Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
    system = System([1, 1], [1, 1], [0.1, 0.2], [0.01, 0.02], contacts=(stop,),
                    damping_terms=(term,))  # fmt: skip

    def of(path):
        return np.array(place_of(path, system).powers(system))

    length, _, time = np.eye(3)
    force = np.array(DERIVED["force"])
    np.testing.assert_array_equal(of("system.stiffness[1]") + length, force)
    np.testing.assert_array_equal(of("system.damping[1]") + length - time, force)
    np.testing.assert_array_equal(of("contact[1].stiffness") + 1.5 * of("contact.clearance"), force)
    np.testing.assert_array_equal(of("system.noise_intensity[1]") - time, 2 * force)
    energy, velocity = np.array(DERIVED["energy"]), length - time
    coefficient = of("damping_term[1].coefficient") + 2 * length + velocity + energy
    np.testing.assert_array_equal(coefficient, of("system.damping[1]"))
    assert not of("system.damping").any() and not of("contact.exponent").any()
    assert SI.of(tuple(of("contact[1].stiffness"))) == "kg m^-0.5 s^-2"
    # Beside gains with a dimension of their own the unit of D is not known.
    system = System([1.0, 1.0], [1, 1], [0.1, 0.2], [0.01], noise_gain=[[1.0], [2.0]])
    assert place_of("system.noise_intensity[1]", system).powers(system) is None


def test_a_sweep_says_the_units_of_its_axes_and_values(scene):
    swept = sweep(load_scene(scene), ["contact.clearance=0.5,1"], ["rms(q2)", "mean_force(1)"],
                  methods=["nonintegrable/closed-form"])  # fmt: skip
    page = swept.page()
    head, rows = page.tables[0].cells()
    assert head[0] == "contact.clearance [mm]"
    assert {row[1] for row in rows} == {"rms(q2) [mm]", "mean_force(1) [kg mm s⁻²]"}
    axes = study_figure(page.panels).axes
    assert {a.get_xlabel() for a in axes} == {"clearance δ [mm]"}
    assert axes[0].get_ylabel() == "rms(q2) [mm]"
    variables = swept.variables()
    assert variables["contact.clearance"][2]["units"] == "mm"
    assert list(variables["unit"][1]) == ["mm", "kg mm s⁻²"]
    assert swept.record()["units"] == ["mm", "kg mm s⁻²"]
    bare = sweep(load_scene(scene).system, ["contact.clearance=0.5,1"], ["rms(q2)"],
                 methods=["nonintegrable/closed-form"])  # fmt: skip
    assert bare.record()["units"] == [None] and "[" not in "".join(bare.table().markdown())


def test_the_cost_of_sampling_says_the_units_of_its_times(scene, bare):
    """L1 = A/√W + B dt^r is a number: A is in √s, B in s^-r, W and dt in s."""
    law = Law("exact_flow", 3.2, 0.17, True, 4, 5e-9, 0.5, 39.0)
    loaded = load_scene(scene)

    def page(scene, unit):
        point = law.point(1e-3, unit)
        route = Priced("exact_flow", FULL, "L1", (point,))
        return point.settings, CostStudy(scene, [route], laws=[law]).page()

    settings, own = page(loaded, loaded.units.time)
    assert settings.count(" s") == 2 and settings.endswith(" s") and " paths, time " in settings
    text = own.text()
    assert settings in text and "s^(-order)" in text.replace("\\", "")
    (table,) = [t for t in own.tables if t.name == "laws"]
    head, _ = table.cells()
    assert {"noise [s^0.5]", "largest [s]", "relaxation [s]", "seconds a step"} < set(head)
    assert table.variables()["laws_largest"][2] == {"units": "s"}
    # Processor times are seconds whatever the scene's time is in; errors are numbers.
    axes = study_figure(own.panels).axes
    assert axes[0].get_xlabel() == "processor time in seconds, one thread"
    settings, own = page(load_scene(bare), "")
    assert " s" not in settings and "[" not in own.text() and "^(" not in own.text()


def test_axes_say_units_while_a_scene_is_drawn(scene):
    observable = parse_observable("q2", 2)
    with in_units(Units("mm", "kg", "s")):
        assert words_of(observable[0]) == "displacement q₂ [mm]"
        assert density_words(observable) == "density p(q₂) [mm⁻¹]"
        assert time_words() == "time t [s]"
    assert words_of(observable[0]) == "displacement q₂"
    assert density_words(observable) == "density p(q₂)"
    outcome = run_scene(load_scene(scene), [method_for("nonintegrable", "closed-form")])
    labels = [axes.get_xlabel() for _, _, f in figures(outcome) for axes in f.axes]
    assert "displacement q₂ [mm]" in labels and "energy H [kg mm² s⁻²]" in labels


def test_the_system_and_the_sliders_of_a_report_have_units(fpk, scene, tmp_path):
    asked = ("--no-simulation", "--of", "q2", "--method", "nonintegrable", "--out", tmp_path)
    fpk("run", scene, *asked)
    page = (tmp_path / "report.html").read_text()
    system = page[page.index('id="system"') : page.index("Scene file</summary>")]
    words = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", system))
    for one in ("[kg]", "[kg s⁻²]", "[kg s⁻¹]", "[kg² mm² s⁻³]", "clearance δ = 0.5 [mm]",
                "stiffness B = 10 [kg mm^-0.5 s^-2]", "[rad/s]"):  # fmt: skip
        assert one in words
    model = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])["model"]
    assert [model[key][0]["unit"] for key in ("B", "delta", "c", "D")] == [
        "kg mm^-0.5 s^-2", "mm", "kg s⁻¹", "kg² mm² s⁻³"
    ]  # fmt: skip
    bare = fpk("run", "fig6a", *asked)
    page = (tmp_path / "report.html").read_text()
    assert bare[0] == 0 and "[rad/s]" not in page and '"unit"' not in page


def test_times_of_a_passage_and_columns_of_comma_separated_values_say_units(fpk, scene, tmp_path):
    asked = ("--method", "nonintegrable", "--limit", "H=1", "--times", "10")
    out = fpk("passage", scene, *asked)[1]
    assert out.startswith("# first passage of H=1 kg mm² s⁻² from rest")
    assert out.count("# time [s]   ") == 2
    assert "[" not in fpk("passage", "fig6a", *asked)[1]
    fpk("export", scene, "--of", "q2", "--out", tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["unit_x"], row["unit_y"], row["unit_density"]) for row in rows} == {
        ("mm", "", "mm⁻¹")
    }
    fpk("export", "fig6a", "--of", "q2", "--out", tmp_path / "b.csv")
    assert "unit" not in (tmp_path / "b.csv").read_text()


def test_modes_solve_their_equation():
    system = System([1.0, 2.0, 0.5], [3.0, 1.0, 2.0], [0.1, 0.2, 0.05], [0.01] * 3)
    modes = modes_record(system)
    squares, shapes = eigh(system.stiffness_matrix, np.diag(system.mass))
    for m, mode in enumerate(modes):
        assert mode["frequency"] == pytest.approx(np.sqrt(squares[m]), rel=1e-12)
        T = shapes[:, m]
        ratio = T @ system.damping @ T / (2.0 * np.sqrt(squares[m]))
        assert mode["damping_ratio"] == pytest.approx(ratio, rel=1e-12)
        assert np.max(np.abs(mode["shape"])) == np.max(mode["shape"]) == 1.0
        np.testing.assert_allclose(mode["shape"], T / T[np.argmax(np.abs(T))], atol=1e-12)
    c = shapes.T @ system.damping @ shapes
    share = np.abs(c - np.diag(np.diag(c))) / np.sqrt(np.outer(np.diag(c), np.diag(c)))
    assert [mode["coupled"] for mode in modes] == pytest.approx(share.max(axis=1), rel=1e-9)
    stiff = replace(system, damping=0.1 * system.stiffness_matrix)
    assert all(mode["coupled"] < 1e-12 for mode in modes_record(stiff))
    undamped = replace(system, damping=np.zeros((3, 3)))
    assert all(mode["coupled"] == mode["damping_ratio"] == 0.0 for mode in modes_record(undamped))


def test_rms_says_by_which_route_it_is_and_without_contact_is_that_of_the_covariance():
    system = System([1.0, 2.0], [3.0, 1.0], [0.1, 0.2], [0.01, 0.05])
    variance = np.diag(stationary_covariance(system))
    for i, row in enumerate(rms_record(system)):
        assert row["route"] == "linear" and row["of"] == f"q{i + 1}"
        assert abs(row["value"] - np.sqrt(variance[i])) <= row["error"] + 1e-14
    stop = Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
    equal = System([1, 1], [1, 1], [0.1, 0.2], [0.01, 0.02], contacts=(stop,))
    assert {row["route"] for row in rms_record(equal)} == {"exact"}
    assert {row["solves"] for row in rms_record(load_scene("fig6a").system)} == {"averaged"}
    assert [row["of"] for row in rms_record(load_scene("chain-50").system)] == ["q50"]
    assert rms_record(load_scene("two-contact-masses").system) == []


def test_show_has_modes_and_rms_with_their_units(
    scene, fpk, answer, written, scene_text, units_text
):
    micro = written(scene_text + units_text.replace("mm", "µm"), "micro.toml")
    assert "µm" in fpk("show", micro)[1]
    record, out = answer("show", scene), fpk("show", scene)[1]
    assert "[rad/s]" in out and " mm by " in out and "in mm, kg, s" in out and "averaged" in out
    assert record["units"]["force"] == "kg mm s⁻²" and record["units"]["length"] == "mm"
    assert [m["frequency"] for m in record["modes"]] == record["natural_frequencies"]
    assert all(r["error"] < 1e-9 for r in record["rms"])
    assert "[rad/time]" in fpk("show", "fig6a")[1] and "chain-50" not in fpk("show", "fig6a")[1]
    assert "50 modes up to" in fpk("show", "chain-50")[1]
