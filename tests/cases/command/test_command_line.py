"""The contract of the command line: keys, exit statuses, one JSON object and nothing else."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

pytest.importorskip("averaging.theory")
pytest.importorskip("averaging.nonintegrable")
pytest.importorskip("sim.montecarlo")

from cases.compare.routes import all_methods, method_for
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene, shipped_scenes
from fpk.answer.method import solvers_of

RUN = {"scene", "effects", "regime", "methods", "comparisons", "identities", "seconds"}
COMPARISON = {"observable", "a", "b", "measures", "L1", "band", "holds"}
DENSITY = {
    "scene", "method", "solver", "observable", "points", "density", "error", "error_kind",
    "certificate", "seconds",
}  # fmt: skip
CERTIFICATE = {"mass_defect", "minimum", "residual", "tail_mass"}
AT = ["--at", "-1.5:1.5:0.5"]
SIMULATION = "simulation"


def density(fpk, *arguments):
    status, out, err = fpk("density", *arguments, "--json")
    assert (status, err) == (0, "")
    assert out.count("\n") == 1
    return json.loads(out)


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("2", "2")])
def test_linear_algebra_takes_one_thread_unless_the_environment_says_more(given, used):
    """Threads that wait for each other over small matrices make a run twenty times as slow."""
    script = """
import os, sys
from cases.command.cli import main
sys.argv = ["fpk", "list"]
try:
    main()
finally:
    print("threads", os.environ["OPENBLAS_NUM_THREADS"])
"""
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == f"threads {used}"


@pytest.mark.parametrize("solver", [s for s in solvers_of("nonintegrable") if s != SIMULATION])
def test_density_has_the_keys_of_the_contract(solver, fpk):
    record = density(
        fpk, "fig6a", "--method", "nonintegrable", "--solver", solver, "--of", "q2", *AT
    )
    assert record.keys() >= DENSITY and record["certificate"].keys() >= CERTIFICATE
    assert record["solver"] == solver and record["error_kind"] == "numerical"
    assert record["points"] == [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5]
    assert len(record["density"]) == len(record["error"]) == 7
    assert record["density"] == pytest.approx(record["density"][::-1], rel=1e-9)


def test_averaged_equations_can_be_simulated(fpk):
    options = ["--of", "H1", "--at", "0.1,0.2"]
    record = density(fpk, "fig8b", "--method", "integrable", "--solver", SIMULATION, *options)
    assert record["solver"] == SIMULATION and record["error_kind"] == "sampling"


def test_finite_elements_are_what_nonintegrable_means_when_nothing_is_said(fpk):
    record = density(fpk, "fig6a", "--method", "nonintegrable", "--of", "H", "--at", "0.1,0.2")
    assert record["solver"] == "fem"


def test_a_pair_takes_two_lists(fpk):
    record = density(fpk, "fig3a", "--method", "exact", "--of", "q2,p2", "--at", "-1:1:1 x 0,0.5")
    assert record["points"] == [[-1, 0], [-1, 0.5], [0, 0], [0, 0.5], [1, 0], [1, 0.5]]
    assert len(record["density"]) == 6


@pytest.mark.slow
def test_a_simulation_is_the_same_for_any_number_of_threads(fpk):
    records = [
        density(
            fpk, "fig6a", "--method", "montecarlo", "--of", "q2", *AT, "--seed", 3, "--threads", t
        )
        for t in (1, 2)
    ]
    assert records[0]["error_kind"] == "sampling"
    assert records[0]["density"] == records[1]["density"]


REFUSED = [
    (["fig6a", "--method", "exact", "--of", "q2", "--at", "0"], "exact"),
    (["fig6a", "--method", "linear", "--of", "q2", "--at", "0"], "contact"),
    (["fig6a", "--method", "integrable", "--of", "q2,H1", "--at", "0 x 0"], "modal energies"),
    (["fig6a", "--method", "guess", "--of", "q2", "--at", "0"], "use one of exact"),
    (["fig3a", "--method", "exact", "--solver", "fem", "--of", "q2", "--at", "0"], "leave it out"),
    (["fig6a", "--method", "nonintegrable", "--solver", "fen", "--of", "q2", "--at", "0"], "fem"),
    (["fig6a", "--method", "nonintegrable", "--of", "q3", "--at", "0"], "q1..q2"),
    (["fig6a", "--method", "nonintegrable", "--of", "q2", "--at", "0:1"], "start:end:step"),
    (["fig6a", "--method", "nonintegrable", "--of", "q2", "--at", "0", "--tol", "0"], "--tol"),
    (["fig6a", "--method", "nonintegrable", "--of", "q2"], "--at"),
    (["fig6a", "--method", "montecarlo", "--of", "q2", "--at", "0", "--seed", "x"], "--seed"),
]


@pytest.mark.parametrize(("arguments", "word"), REFUSED)
def test_what_does_not_apply_is_refused_with_the_reason(arguments, word, fpk):
    status, out, err = fpk("density", *arguments)
    assert (status, out) == (2, "") and err.count("\n") == 1 and word in err


def test_every_shipped_scene_loads_and_can_be_shown(fpk):
    names = list(shipped_scenes())
    assert len(names) >= 11
    listed = json.loads(fpk("list", "--json")[1])["scenes"]
    assert [s["name"] for s in listed] == names
    for name in names:
        status, out, err = fpk("show", name, "--json")
        record = json.loads(out)
        assert (status, err) == (0, "")
        assert len(record["natural_frequencies"]) == len(record["system"]["mass"])
        assert record["boundaries"] and any(t["applies"] for t in record["theories"])


def test_run_judges_and_reports(fpk, tmp_path):
    text, _, _ = shipped_scenes()["fig3a"].read_text().partition("[expect]")
    scene = tmp_path / "pair.toml"
    scene.write_text(text.replace("[0.1, 1.0, 10.0]", "[1.0, 10.0]"))
    status, out, err = fpk("run", scene, "--json", "--out", tmp_path / "out", "--seed", 1)
    record = json.loads(out)
    assert len(record["curves"]) == 1  # beside the first, which is the record itself
    assert (status, err) == (0, "")
    assert record.keys() >= RUN
    for curve in [record, *record["curves"]]:
        assert curve["comparisons"] and all(c.keys() >= COMPARISON for c in curve["comparisons"])
        # (8) holds, so that only what leaves the contacts out differs from the exact density.
        found = {True: set(), False: set()}
        for c in curve["comparisons"]:
            routes = (c["a"].split("/")[0], c["b"].split("/")[0])
            found[routes.count("integrable") == 1].add(c["measures"])
        assert found == {True: {"averaging"}, False: {"numerical", "sampling"}}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<svg" in page and "http://" not in page.replace("http://www.w3.org/", "")
    with xr.open_dataset(tmp_path / "out" / "result.nc", engine="h5netcdf") as data:
        assert np.all(np.isfinite(data["p_q2"].sel(route_q2="exact")))
        assert data.attrs["scene"] == "pair"
    assert len(list((tmp_path / "out").glob("*.svg"))) == 8


def test_a_scene_is_text_in_the_report(tmp_path, scene_text):
    from cases.show.digest import digest_of  # noqa: PLC0415
    from cases.show.report import report_html  # noqa: PLC0415

    path = tmp_path / "evil.toml"
    path.write_text(scene_text.replace('"A scene"', '"<script>alert(1)</script>"'))
    outcome = run_scene(load_scene(str(path)), [method_for("nonintegrable")])
    page = report_html(outcome.scene, digest_of(outcome), [])
    assert "<script" not in page and "&lt;script&gt;" in page


@pytest.mark.parametrize("ending", ["csv", "nc", "vtu"])
def test_export_by_ending_makes_the_folder(ending, fpk, tmp_path):
    path = tmp_path / "out" / f"field.{ending}"
    status, _, err = fpk("export", "fig6a", "--out", path)
    assert (status, err) == (0, "") and path.stat().st_size > 1000
    stops = ["field_stops.vtu"] if ending == "vtu" else []
    assert sorted(p.name for p in path.parent.iterdir()) == [path.name, *stops]


@pytest.mark.parametrize("name", ["field.vtk", "field.txt", "file/field.csv"])
def test_export_says_what_it_cannot_write(name, fpk, tmp_path):
    (tmp_path / "file").write_text("no folder")
    status, out, err = fpk("export", "fig6a", "--out", tmp_path / name)
    assert (status, out) == (2, "") and err.count("\n") == 1 and "--out" in err


def test_run_says_where_it_cannot_write(fpk, tmp_path):
    (tmp_path / "file").write_text("kept")
    status, out, err = fpk("run", "fig6a", "--out", tmp_path / "file")
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert (tmp_path / "file").read_text() == "kept"


def test_the_tolerance_reaches_solvers_and_not_the_simulation():
    for method in all_methods(tol=1e-7):
        assert method.tol == (None if method.route.sampled else 1e-7)


def test_help_needs_nothing_heavy():
    code = (
        "import sys, cases.command.app; heavy = {'numpy', 'scipy', 'matplotlib', 'xarray',"
        " 'numba', 'pydantic', 'skfem'} & sys.modules.keys();"
        " sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


INTERRUPTED = """
import os, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[0]:
            sys.argv[0] = "fpk"
            os.kill(os.getpid(), signal.SIGINT)

# A shell has its background jobs ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv = sys.argv[1:]
sys.meta_path.insert(0, Interrupt())
from cases.command.cli import main
main()
"""


@pytest.mark.parametrize(
    "module", ["click", "cases.command.studies", "numpy", "scipy", "numba", "averaging"]
)
def test_control_c_while_the_program_is_imported_is_one_line(module):
    command = [sys.executable, "-c", INTERRUPTED, module, "show", "fig6a"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr.strip() == "fpk: stopped; nothing half-written was left"


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "fig6a", "--out", ""],
        ["run", "fig6a", "--checkpoint", ""],
        ["density", "fig6a", "--method", "montecarlo", "--of", "q2", "--at", 0, "--checkpoint", ""],
        ["converge", "fig6a", "--out", ""],
        ["cost", "fig6a", "--out", ""],
        ["regime", "fig6a", "--vary", "contact.stiffness=1:2:2", "--out", ""],
        ["regime", "fig6a", "--vary", "contact.stiffness=1:2:2", "--checkpoint", ""],
        ["export", "fig6a", "--out", ""],
        ["verify", "fig6a", "--out", "there"],
        ["export", "fig6a", "--of", "q9", "--out", "missing/fields.csv"],
    ],
)
def test_a_path_that_cannot_be_used_is_refused_before_the_work(
    arguments, fpk, tmp_path, monkeypatch
):
    def worked(*_, **__):
        raise AssertionError("worked")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cases.compare.stationary.run_scene", worked)
    status, out, err = fpk(*arguments)
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert not list(tmp_path.iterdir())


FAR = """[system]
mass = [1.0]
stiffness = [1.0]
damping = [1e-99]
noise_intensity = [1e99]
[[contact]]
mass = 1
side = "right"
law = "power"
exponent = 2.0
stiffness = 1.0
clearance = 1e99
"""


@pytest.mark.parametrize("solver", ["fem", "quadrature"])
def test_energies_whose_squares_overflow_are_not_blamed_on_the_damping(solver, fpk, tmp_path):
    (tmp_path / "far.toml").write_text(FAR)
    status, _, err = fpk("density", tmp_path / "far.toml", "--method", "nonintegrable",
                         "--solver", solver, "--of", "H", "--at", 0)  # fmt: skip
    assert status == 1 and err.count("\n") == 1
    assert "leave the range of double precision: choose other units" in err


def test_the_closed_form_answers_at_energies_whose_squares_overflow(fpk, tmp_path):
    # The same in the unit of the clearance: there p(H) is a number of order one.
    near = FAR.replace("1e-99", "1.0").replace("1e99", "1.0")
    near = near.replace("= 1.0\nclearance", "= 1e99\nclearance")
    densities = []
    for name, scene in (("far", FAR), ("near", near)):
        (tmp_path / f"{name}.toml").write_text(scene)
        asked = ("--method", "nonintegrable", "--solver", "closed-form", "--of", "H", "--at", 0)
        status, out, _ = fpk("density", tmp_path / f"{name}.toml", *asked, "--json")
        assert status == 0
        densities.append(json.loads(out)["density"][0])
    assert densities[0] * 1e198 == pytest.approx(densities[1], rel=1e-11)


def test_show_names_the_ends_of_every_modal_energy(fpk, tmp_path):
    path = tmp_path / "five.toml"
    numbers = {"mass": 1.0, "stiffness": 1.1, "damping": 0.05, "noise_intensity": 0.01}
    path.write_text("[system]\n" + "".join(f"{k} = {[v] * 5}\n" for k, v in numbers.items()))
    ends = [f"H{i} = {end}" for i in range(1, 6) for end in ("0", "∞")]
    record = json.loads(fpk("show", path, "--json")[1])
    assert [b["end"] for b in record["boundaries"] if b["process"] == "integrable"] == ends
    out = fpk("show", path)[1]
    assert all(end in out for end in ends)
