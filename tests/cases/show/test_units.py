"""``[units]`` of a scene on axes, in tables, JSON and files; modes and rms of ``fpk show``."""

import csv
import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from cases.scene.numbers import place_of
from cases.scene.scene import load_scene, shipped_scenes
from cases.scene.units import DERIVED, DIMENSIONS, Units
from cases.show.facts import modes_record, rms_record
from cases.show.pictures.draw import study_figure
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


PASSAGE = {"limit": "kg mm² s⁻²", "mean": "s", "variance": "s²", "rate": "s⁻¹", "times": "s"}
ASKED = [
    ("density --of q2 --at 0", {"points": "mm", "density": "mm⁻¹", "times": "s"}),
    (
        "density --of q2,p2 --at '0 x 0'",
        {"points": ["mm", "kg mm s⁻¹"], "density": "s kg⁻¹ mm⁻²", "times": "s"},
    ),
    ("passage --limit H=0.5", PASSAGE),
    ("relaxation --rates 1", {"rates": "s⁻¹", "frequencies": "s⁻¹"}),
    ("crossings --of q1 --at 0,0.5", {"points": "mm", "rate": "s⁻¹"}),
    ("spectrum --of q1 --at 0,0.5", {"points": "s⁻¹", "spectrum": "mm² s"}),
    ("correlation --of q1 --at 0,0.5", {"points": "s", "correlation": "mm²"}),
]


@pytest.mark.parametrize(("question", "units"), ASKED)
def test_answers_say_the_units_of_their_numbers(
    question, units, answer, fpk, written, linear_text, units_text
):
    command, *options = shlex.split(question)
    method = "linear" if command in ("crossings", "spectrum", "correlation") else "nonintegrable"
    asked = (command, written(linear_text + units_text), "--method", method, *options)
    assert answer(*asked)["units"] == units
    text = fpk(*asked)[1]
    shown = [unit for unit in units.values() if isinstance(unit, str)]
    assert any(f"[{unit}]" in text or f"  {unit}\n" in text for unit in shown)
    if method == "linear":
        (points, values), key = shown, list(units)[1]
        head = text.splitlines()[0]
        assert f"[{points}]" in head and f"{key} [{values}]" in head
    asked = (command, written(linear_text, "bare.toml"), "--method", method, *options)
    assert answer(*asked)["units"] is None
    assert "[" not in fpk(*asked)[1]


def test_the_tables_of_a_run_say_units(written, units_text, tmp_path, fpk, answer):
    """On the terminal, in the report, in JSON: rows of quantities, answers in time."""
    text, how = shipped_scenes()["two-modes"].read_text(), ("--method", "integrable/closed-form")
    path = written(text + units_text)
    out = fpk("run", path, *how, "--out", tmp_path / "out")[1]
    assert "mean [kg mm² s⁻²]" in out
    # The heads of a wide table are wrapped, with the units below.
    assert re.search(r"mean time +failure rate .*\n +\[s\] +\[s⁻¹\]\n", out)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "H1, mean [kg mm² s⁻²]" in page and "mean time [s]" in page and "skewness [" not in page
    record = answer("run", path, *how)
    units = {q["quantity"]: q["unit"] for q in record["quantities"]}
    assert units["rms"] == "kg mm² s⁻²" and units["skewness"] == "1"
    assert record["passages"][0]["units"] == PASSAGE
    assert "[" not in fpk("run", "two-modes", *how)[1]
    record = answer("run", "two-modes", *how)
    assert not any("unit" in q for q in record["quantities"])
    assert record["passages"][0]["units"] is None


def test_a_quantity_has_the_unit_of_its_name():
    for unit, names in {
        "m": ("mean", "quantile 99 %", "mean overlap, left stop"),
        "m²": ("variance",),
        "kg m s⁻²": ("force in contact, right stop at 0.5", "mean_force"),
        "s⁻¹": ("upcrossing rate, left stop", "failure_rate", "impacts per unit time"),
        "s": ("mean_passage",),
        "1": ("contact probability, left stop", "averaging_error", "exceedance"),
    }.items():
        assert {SI.number(name, "q2") for name in names} == {unit}
    assert Units().number("mean", "q2") == "" and SI.of((0, 0, 0)) == "1"
    # A covariance has the product of both units, a density the inverse of its coordinates'.
    assert SI.number("covariance", "q2,p2") == SI.of(DIMENSIONS["q"], DIMENSIONS["p"])
    assert SI.density(parse_observable("q1,H", 2)) == "s² kg⁻¹ m⁻³"
    with pytest.raises(InvalidInput, match="mass"):
        Units("m", "m", "s")


def test_damping_terms_have_units_that_keep_the_equations():
    """c q^2 v H is a damping; beside gains with a dimension of their own no unit of D is known."""
    term = DampingTerm(1, 1, 0.1, ((1, 2),), ((2, 1),), 1)
    system = System([1, 1], [1, 1], [0.1, 0.2], [0.01, 0.02], damping_terms=(term,))

    def of(path, system=system):
        powers = place_of(path, system).powers(system)
        return powers and np.array(powers)

    length, _, time = np.eye(3)
    coefficient = of("damping_term[1].coefficient") + 3 * length - time + DERIVED["energy"]
    np.testing.assert_array_equal(coefficient, of("system.damping[1]"))
    assert not of("system.damping").any()
    gained = System([1.0, 1.0], [1, 1], [0.1, 0.2], [0.01], noise_gain=[[1.0], [2.0]])
    assert of("system.noise_intensity[1]", gained) is None


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


def test_the_cost_of_sampling_says_the_units_of_its_times(scene):
    """L1 = A/√W + B dt^r is a number: A is in √s, B in s^-r, W and dt in s."""
    law = Law("exact_flow", 3.2, 0.17, True, 4, 5e-9, 0.5, 39.0)

    def page(scene):
        point = law.point(1e-3, scene.units.time)
        route = Priced("exact_flow", FULL, "L1", (point,))
        return point.settings, CostStudy(scene, [route], laws=[law]).page()

    settings, own = page(load_scene(scene))
    assert settings.count(" s") == 2 and settings.endswith(" s") and " paths, time " in settings
    assert settings in own.text() and "s^(-order)" in own.text().replace("\\", "")
    (table,) = [t for t in own.tables if t.name == "laws"]
    heads = {"noise [s^0.5]", "largest [s]", "relaxation [s]", "seconds a step"}
    assert heads < set(table.cells()[0])
    assert table.variables()["laws_largest"][2] == {"units": "s"}
    # Processor times are seconds whatever the scene's time is in; errors are numbers.
    (axes, *_) = study_figure(own.panels).axes
    assert axes.get_xlabel() == "processor time in seconds, one thread"
    settings, own = page(load_scene("fig6a"))
    assert " s" not in settings and "[" not in own.text() and "^(" not in own.text()


def test_axes_say_units_while_a_scene_is_drawn(solved, scene_text, units_text):
    outcome = solved(scene_text + units_text, "nonintegrable/closed-form")
    labels = [axes.get_xlabel() for _, _, f in figures(outcome) for axes in f.axes]
    assert "displacement q₂ [mm]" in labels and "energy H [kg mm² s⁻²]" in labels


def test_the_system_and_the_sliders_of_a_report_have_units(fpk, scene, tmp_path):
    asked = ("--no-simulation", "--of", "q2", "--method", "nonintegrable", "--out", tmp_path)
    fpk("run", scene, *asked)
    page = (tmp_path / "report.html").read_text()
    assert f"fpk run {scene} " in page and "--method nonintegrable --no-simulation" in page
    system = page[page.index('id="system"') : page.index("Scene file</summary>")]
    words = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", system))
    for one in ("[kg]", "[kg s⁻²]", "[kg s⁻¹]", "[kg² mm² s⁻³]", "clearance δ = 0.5 [mm]",
                "stiffness B = 10 [kg mm^-0.5 s^-2]", "[rad/s]"):  # fmt: skip
        assert one in words
    model = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])["model"]
    assert [model[key][0]["unit"] for key in ("B", "delta", "c", "D")] == [
        "kg mm^-0.5 s^-2", "mm", "kg s⁻¹", "kg² mm² s⁻³"
    ]  # fmt: skip
    assert fpk("run", "fig6a", *asked)[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert "[rad/s]" not in page and '"unit"' not in page


def test_times_of_a_passage_and_columns_of_comma_separated_values_say_units(
    fpk, scene, written, linear_text, units_text, tmp_path
):
    asked = ("--method", "nonintegrable", "--limit", "H=1", "--times", "10")
    out = fpk("passage", scene, *asked)[1]
    assert out.startswith("# first passage of H=1 kg mm² s⁻² from rest")
    assert out.count("# time [s]   ") == 2
    free = written(linear_text + units_text, "free.toml")
    fpk("export", free, "--of", "q2", "--out", tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as file:
        units = {(r["unit_x"], r["unit_y"], r["unit_density"]) for r in csv.DictReader(file)}
    assert units == {("mm", "", "mm⁻¹")}
    fpk("export", "fig3a", "--of", "q2", "--out", tmp_path / "b.csv")
    assert "unit" not in (tmp_path / "b.csv").read_text()


def test_modes_solve_their_equation():
    system = System([1.0, 2.0, 0.5], [3.0, 1.0, 2.0], [0.1, 0.2, 0.05], [0.01] * 3)
    modes = modes_record(system)
    squares, shapes = eigh(system.stiffness_matrix, np.diag(system.mass))
    c = shapes.T @ system.damping @ shapes
    share = np.abs(c - np.diag(np.diag(c))) / np.sqrt(np.outer(np.diag(c), np.diag(c)))
    for m, mode in enumerate(modes):
        T, omega = shapes[:, m], np.sqrt(squares[m])
        assert mode["frequency"] == pytest.approx(omega, rel=1e-12)
        assert mode["damping_ratio"] == pytest.approx(c[m, m] / (2.0 * omega), rel=1e-12)
        np.testing.assert_allclose(mode["shape"], T / T[np.argmax(np.abs(T))], atol=1e-12)
        assert mode["coupled"] == pytest.approx(share[m].max(), rel=1e-9)
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


def test_show_has_modes_and_rms_with_their_units(scene, fpk, answer):
    record, out = answer("show", scene), fpk("show", scene)[1]
    assert "[rad/s]" in out and " mm by " in out and "in mm, kg, s" in out and "averaged" in out
    assert record["units"]["force"] == "kg mm s⁻²" and record["units"]["length"] == "mm"
    assert [m["frequency"] for m in record["modes"]] == record["natural_frequencies"]
    assert all(r["error"] < 1e-9 for r in record["rms"])
    assert "[rad/time]" in fpk("show", "fig6a")[1]
    assert "50 modes up to" in fpk("show", "chain-50")[1]
