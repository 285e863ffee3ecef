"""A method, a law, a question in time, a format and a study, one file each, are used as all others.

The method and the law are shown, run, compared, drawn and exported; the question is asked through
the library and the command line.
"""

import csv
import re
import sys
from importlib import import_module

import numpy as np
import pytest
import xarray as xr

from averaging import Linear
from cases.compare.routes import all_methods, method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.fields import WRITERS, write_netcdf
from cases.show.report import write_report
from cases.study import STUDIES
from cases.study.converge import study_own
from fpk.answer.method import ROUTES
from fpk.answer.names import parse_observable
from fpk.answer.question import QUESTIONS
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact_law import LAWS, ContactLaw, register_law


def executed(module):
    """The module, executed anew: what it registered before may have been forgotten since."""
    sys.modules.pop(module, None)
    return import_module(module)


TOY = ("equipartition", "closed-form")


@pytest.fixture(scope="module")
def scene_path(scene_text, tmp_path_factory):
    """A scene with the law, whose momenta the method knows; both are forgotten afterwards."""
    executed("toy_law")
    executed("toy_method")
    text = scene_text.replace("[0.01, 0.02]", "[0.04, 0.02]").replace('"q2", "H"', '"p1", "q2"')
    path = tmp_path_factory.mktemp("toy") / "toy.toml"
    path.write_text(text.replace('side      = "both"', 'side = "both"\nlaw = "cubic"'))
    yield path
    del ROUTES[TOY], LAWS["cubic"]


@pytest.fixture(scope="module")
def outcome(scene_path):
    methods = [method_for(name) for name in ("exact", TOY[0])]
    methods.append(method_for("nonintegrable", "closed-form"))
    methods.append(method_for("montecarlo", paths=4096, relaxations=20.0))
    return run_scene(load_scene(str(scene_path)), methods)


def test_they_are_shown_run_and_compared(scene_path, outcome, fpk, answer):
    record = answer("show", scene_path)
    (theory,) = [t for t in record["theories"] if t["method"] == TOY[0]]
    assert theory["applies"] and theory["reason"] == "not for q2: momenta only"
    assert record["system"]["contacts"][0]["law"] == "cubic"
    assert TOY[0] in fpk("show", scene_path)[1]
    (curve,) = outcome.curves
    toy = [c for c in curve.comparisons if TOY[0] in (c.a.method, c.b.method)]
    assert {c.measures for c in toy} == {"numerical", "sampling"} and not outcome.problems
    assert [c for c in curve.comparisons if c.observable == "q2" and c.measures == "sampling"]
    record = answer("density", scene_path, "--method", TOY[0], "--of", "p1", "--at", "0")
    assert record["method"] == TOY[0] and record["certificate"]["certified"]
    assert record["density"] == pytest.approx([(2 * np.pi * 0.5) ** -0.5])


def test_they_are_drawn_and_reported(outcome, tmp_path):
    written = [path.name for path in write_report(outcome, digest_of(outcome), tmp_path)]
    assert {"density_p1.svg", "density_q2.svg", "left_p1.svg"} <= set(written)
    page = (tmp_path / "report.html").read_text()
    assert "equipartition" in page and "cubic law" in page
    write_netcdf(outcome, tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as data:
        assert TOY[0] in data["route_p1"].values.tolist()


def test_they_are_exported_and_in_a_format_of_one_file(
    scene_path, outcome, fpk, tmp_path, monkeypatch
):
    def few(**settings):
        return [m for m in all_methods(**settings) if m.route.method in ("exact", TOY[0])]

    executed("toy_writer")
    monkeypatch.setattr("cases.compare.routes.all_methods", few)
    for ending in ("csv", "nc", "vtu", "dat"):
        path = tmp_path / ending / f"p1.{ending}"  # in a folder that it makes
        status, out, _ = fpk("export", scene_path, "--of", "p1", "--out", path)
        assert (status, out.split()) == (0, ["wrote", str(path)]) and path.stat().st_size > 1000
    with (tmp_path / "csv" / "p1.csv").open() as stream:
        assert any(row["route"] == TOY[0] for row in csv.DictReader(stream))
    assert f'Name="{TOY[0]}"' in (tmp_path / "vtu" / "p1.vtu").read_text(errors="replace")
    names = re.findall("# (.*)", path.read_text())
    assert names == ["p1, exact", f"p1, {TOY[0]}"]
    x, p, error = np.loadtxt(path, unpack=True)[:, :401]
    values, errors = outcome.curves[0].of("p1")["exact"].at(x)
    assert np.all(np.abs(p - values) <= error + 1e-12) and error == pytest.approx(errors, rel=1e-9)
    del WRITERS[".dat"]
    status, _, err = fpk("export", scene_path, "--of", "p1", "--out", path)
    assert status == 2 and ".vtu, .pvd, .nc, .csv" in err


@pytest.fixture(scope="module")
def question():
    """The question, forgotten afterwards with its answer."""
    yield executed("toy_question").INCREMENT
    del QUESTIONS["increment"], Linear.increment


@pytest.fixture
def free_path(linear_text, units_text, written):
    """A scene without contact, in units."""
    return written(linear_text + units_text)


def test_a_question_is_asked_through_the_library(question, free_path):
    system = load_scene(free_path).system
    q2, lags = parse_observable("q2", 2), np.array([0.0, 1.0, 400.0])
    asked = Linear().increment(system, q2, lags, tol=1e-8)
    C = Linear().correlation(system, q2, lags).values
    assert asked.values == pytest.approx(2.0 * (C[0] - C), abs=1e-10) and asked.values[1] > 0.0
    assert asked.certificate.certified and hasattr(Linear(), question.name)
    assert not hasattr(method_for("exact"), question.name)
    for at, tol, observable in ((-lags, None, q2), (lags, -1.0, q2), (lags, None, q2 * 2)):
        with pytest.raises(InvalidInput):
            Linear().increment(system, observable, at, tol=tol)
    with pytest.raises(NotApplicable, match="contact"):
        Linear().increment(load_scene("fig6a").system, q2, lags)


def test_a_question_is_asked_on_the_command_line(question, free_path, fpk, answer, refusal):
    assert "increment" in fpk("--help")[1] and question.help in fpk("increment", "--help")[1]
    asked = "increment", free_path, "--method", "linear", "--of", "q2", "--at", "0,400"
    record = answer(*asked)
    assert record["certificate"]["certified"] and record["variance"][0] == 0.0
    assert record["units"] == {"points": "s", "variance": "mm²"}
    head, _, _, solves = fpk(*asked)[1].splitlines()
    assert head.startswith("# lag [s]   variance [mm²]") and "full equation" in solves
    err = refusal("increment", free_path, "--method", "exact", *asked[4:])
    assert "exact gives no variance of an increment; use one of linear" in err
    assert "a lag is a time" in refusal(*asked[:-1], "-1")


def test_modules_named_in_the_environment_are_imported(refusal, monkeypatch):
    sys.modules.pop("toy_study", None)
    monkeypatch.setenv("FPK_IMPORT", "toy_study,that_is_not_there")
    assert "FPK_IMPORT: that_is_not_there is not imported: ModuleNotFound" in refusal("list")
    assert STUDIES.pop("trapezoid")


@pytest.mark.parametrize(
    ("name", "energy", "slope", "error", "words"),
    [
        ("wrong", lambda x, e: x**3 / 2, lambda x, e: 2 * x, InvalidInput, "energy and force"),
        ("wrong", lambda x, e: x**3 / 3, lambda x, e: 3 * x, InvalidInput, "force and slope"),
        ("hertz", lambda x, e: x**3 / 3, lambda x, e: 2 * x, ValueError, "registered already"),
    ],
)
def test_a_law_of_a_name_that_is_taken_or_of_parts_that_do_not_belong_together_is_refused(
    name, energy, slope, error, words
):
    law = ContactLaw(name, 2.0, force=lambda x, e: x * x, energy=energy, slope=slope)
    with pytest.raises(error, match=words):
        register_law(law)
    assert LAWS.get(name) is not law


@pytest.mark.parametrize(
    ("force", "energy", "slope"),
    [
        (lambda x, e: np.sinh(900 * x), lambda x, e: 2 * np.sinh(450 * x) ** 2 / 900,
         lambda x, e: 900 * np.cosh(900 * x)),
        (lambda x, e: x**90, lambda x, e: x**91 / 91, lambda x, e: 90 * x**89),
        (lambda x, e: x / (1 - x), lambda x, e: -x - np.log1p(-x), lambda x, e: (1 - x) ** -2),
        (lambda x, e: x + 8 * np.maximum(x - 0.3, 0), lambda x, e: x * x / 2
         + 4 * np.maximum(x - 0.3, 0) ** 2, lambda x, e: 1 + 8 * (x > 0.3)),
    ],
    ids=["exponential", "steep", "finite travel", "kink"],
)  # fmt: skip
def test_a_law_of_any_scale_is_registered(force, energy, slope):
    register_law(ContactLaw("any", 1.0, force, energy, slope))
    del LAWS["any"]


@pytest.fixture(scope="module")
def study():
    """The study, forgotten afterwards."""
    yield executed("toy_study").TRAPEZOID
    del STUDIES["trapezoid"]


def test_a_study_is_run_by_the_library_and_the_command_line(study, fpk, answer, tmp_path):
    result = study_own(study, load_scene("fig3a"))
    (ladder,) = result.ladders
    assert not result.problems and len(ladder.levels) == 6
    verdict = ladder.verdicts["mass"]
    assert verdict.kind == "asymptotic" and verdict.orders[-1] == pytest.approx(2.0, abs=0.05)
    assert ladder.grid["mass"].index >= ladder.levels[-1].errors["mass"]
    assert study.help in fpk("trapezoid", "--help")[1] and "trapezoid" in fpk("--help")[1]
    record = answer("trapezoid", "fig3a", "--out", tmp_path)
    assert record["scene"] == "fig3a"
    assert record["equations"][0]["ladders"][0]["verdicts"]["mass"]["theory"] == 2.0
    for ending in ("md", "html", "svg", "nc"):
        assert (tmp_path / f"trapezoid.{ending}").stat().st_size > 1000
    assert "asymptotic" in (tmp_path / "trapezoid.md").read_text(encoding="utf-8")
