"""The contract of the command line: keys, exit statuses, one JSON object and nothing else."""

import json
import os
import re
import subprocess
import sys

import pytest

from cases.compare.routes import all_methods, all_routes, chosen_methods
from cases.scene.scene import shipped_scenes
from fpk.numeric.errors import InvalidInput

QUICK = ("run", "fig3a", "--of", "q2", "--method", "exact", "--method", "nonintegrable/closed-form")

START = """
import os, sys, cases.command.app
heavy = {'numpy', 'scipy', 'matplotlib', 'xarray', 'numba', 'pydantic', 'skfem'}
print("heavy", sorted(heavy & sys.modules.keys()))
from cases.command.cli import main
sys.argv = ["fpk", "list"]
try:
    main()
finally:
    print("threads", os.environ["OPENBLAS_NUM_THREADS"])
"""


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("2", "2")])
def test_the_start_loads_nothing_heavy_and_takes_one_thread_of_linear_algebra(given, used):
    """Threads that wait for each other over small matrices make a run twenty times as slow."""
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    command = [sys.executable, "-c", START]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    first, *_, last = done.stdout.splitlines()
    assert (first, last) == ("heavy []", f"threads {used}")


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
    "module", ["click", "numba", pytest.param("averaging", marks=pytest.mark.slow)]
)
def test_control_c_while_the_program_is_imported_is_one_line(module):
    command = [sys.executable, "-c", INTERRUPTED, module, "show", "fig6a"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr.strip() == "fpk: stopped; nothing half-written was left"


ANSWER = {"scene", "method", "solver", "certificate", "seconds", "solves", "units", "settings"}
CURVE = ANSWER | {"observable", "points", "error", "error_kind"}
PASSAGE = ANSWER | {
    "limit", "start", "mean", "mean_error", "variance", "variance_error", "rate", "rate_error",
    "times", "survival", "survival_error", "failure", "failure_error", "error_kind",
}  # fmt: skip
RUN = {"scene", "effects", "regime", "methods", "comparisons", "identities", "seconds"}
SHOW = {"system", "natural_frequencies", "boundaries", "theories", "modes", "rms"}
ASKED = [  # the words after fpk, and keys that are there
    ("list", {"scenes"}),
    ("check fig6a", {"applies", "refused", "valid", "questions", "simulation_seconds"}),
    ("show fig6a", SHOW),
    ("density fig3a --method exact --of q2 --at 0,1", CURVE | {"density"}),
    (
        "transient cir --method integrable --of H --times 1 --at 0.1",
        CURVE | {"density", "times", "start"},
    ),
    ("passage cir --method phase-space --limit q1>1.2 --tol 1e-2", PASSAGE),
    ("crossings fig3a --method exact --of q2 --at 0", CURVE | {"rate"}),
    ("spectrum cir --method linear --of q1 --at 0", CURVE | {"spectrum"}),
    ("correlation cir --method linear --of q1 --at 0", CURVE | {"correlation"}),
    ("relaxation cir --method integrable", ANSWER | {"rates", "errors", "frequencies"}),
    ("run two-modes --method integrable/closed-form", RUN | {"passages", "transients"}),
    ("sweep fig3a --vary contact.clearance=0.5,1 --quantity rms(q2)", {"points", "methods"}),
]
CHECKS = {"mass_defect", "minimum", "residual", "tail_mass", "net_flux"}
CHECKS |= {"failures", "missed", "certified"}


def entries(record, path=""):
    """Every key with its path and value, below lists and objects."""
    children = record.items() if isinstance(record, dict) else enumerate(record)
    for key, value in children:
        yield f"{path}.{key}", key, value
        if isinstance(value, (dict, list)):
            yield from entries(value, f"{path}.{key}")


@pytest.mark.parametrize(("line", "keys"), ASKED, ids=[line.split()[0] for line, _ in ASKED])
def test_json_is_one_object_of_plain_keys_and_numbers(line, keys, fpk):
    status, out, _ = fpk(*line.split(), "--json")
    record = json.loads(out, parse_constant=pytest.fail)  # no NaN, no Infinity
    assert status == 0 and record["schema"] == 2 and record.keys() >= keys
    found = list(entries(record))
    assert len(found) > 5
    for path, key, value in found:
        assert isinstance(key, int) or key in ("L1", "L2") or re.fullmatch("[a-z0-9_]+", key), path
        assert not (isinstance(value, str) and re.fullmatch(r"-?[\d.]+(e[-+]?\d+)?", value)), path
        if key == "certificate":
            assert value.keys() == CHECKS, path
    # What does not apply is null, and what answered is named.
    if line.startswith("relaxation"):
        assert record["certificate"]["mass_defect"] is None is record["certificate"]["tail_mass"]
    if line.startswith("passage"):
        assert record["solver"] == "fem" and record["certificate"]["tail_mass"] is None
        assert record["certificate"]["residual"] > 0.0  # measured


def test_the_solver_is_finite_elements_if_none_is_asked_for_and_a_pair_takes_two_lists(answer):
    simulated = ("--solver", "simulation", "--of", "H1", "--at", "0.1,0.2")
    record = answer("density", "fig8b", "--method", "integrable", *simulated)
    assert record["solver"] == "simulation" and record["error_kind"] == "sampling"
    asked = ("--method", "nonintegrable", "--of", "H", "--at", "0.1,0.2")
    assert answer("density", "fig6a", *asked)["solver"] == "fem"
    asked = ("--method", "exact", "--of", "q2,p2", "--at", "-1:1:1 x 0,0.5")
    record = answer("density", "fig3a", *asked)
    assert record["points"] == [[-1, 0], [-1, 0.5], [0, 0], [0, 0.5], [1, 0], [1, 0.5]]
    assert len(record["density"]) == 6


def test_every_shipped_scene_loads_and_can_be_shown(answer):
    names = list(shipped_scenes())
    assert len(names) >= 11
    assert [s["name"] for s in answer("list")["scenes"]] == names
    for name in names:
        record = answer("show", name)
        assert len(record["natural_frequencies"]) == len(record["system"]["mass"])
        assert record["boundaries"] and any(t["applies"] for t in record["theories"])


def test_show_names_the_ends_of_every_modal_energy(fpk, answer, written):
    numbers = {"mass": 1.0, "stiffness": 1.1, "damping": 0.05, "noise_intensity": 0.01}
    path = written("[system]\n" + "".join(f"{k} = {[v] * 5}\n" for k, v in numbers.items()))
    ends = [f"H{i} = {end}" for i in range(1, 6) for end in ("0", "∞")]
    bounds = answer("show", path)["boundaries"]
    assert [b["end"] for b in bounds if b["process"] == "integrable"] == ends
    out = fpk("show", path)[1]
    assert all(end in out for end in ends)


def test_only_what_is_asked_for_is_run(answer):
    record = answer(*QUICK, "--of", "H")
    routes = {m["route"] for m in record["methods"]}
    assert routes == {"exact", "nonintegrable/closed-form"}
    rows = record["quantities"]
    assert [*dict.fromkeys(row["observable"] for row in rows)] == ["q2", "H"]
    assert {row["route"] for row in rows} == routes
    by_name = {(r["observable"], r["quantity"], r["route"]): r for r in rows}
    rms = by_name["q2", "rms", "exact"]
    assert 0.0 < rms["error"] < 1e-12 and rms["error_kind"] == "numerical"
    (of_rms,) = [c for c in record["quantity_comparisons"] if c["observable"] == "q2: rms"]
    assert (of_rms["measures"], of_rms["norm"], of_rms["holds"]) == ("numerical", "absolute", True)
    assert not record["claims"]  # they are about all routes


def test_the_summary_has_the_quantities_first_and_the_details_every_comparison(fpk, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, summary, _ = fpk(*QUICK)
    lines = summary.split("\n")
    assert status == 0 and all(len(line) <= 80 for line in lines)
    assert lines[3].split() == ["q2", "exact", "energy", "averaging"]
    assert lines[4].split() == ["equation", "solved", "full", "averaged"]
    assert lines[6].split()[0] == "rms" and "allowed" not in summary
    assert "comparisons, every check holds" in lines[-2]
    _, details, _ = fpk(*QUICK, "--details")
    assert "allowed" in details and details.index("rms") < details.index("allowed")
    assert fpk(*QUICK, "--quiet") == (0, "", "")


def test_methods_are_chosen_by_name_or_by_label_and_without_simulation_none_samples(answer):
    methods = [route.make() for route in all_routes()]
    chosen = chosen_methods(methods, ["integrable", "nonintegrable/fem"], simulation=False)
    modal = {f"integrable/{solver}" for solver in ("closed-form", "fem", "quadrature")}
    assert {m.route.label for m in chosen} == {"nonintegrable/fem", *modal}
    assert chosen_methods(methods, [], simulation=True) == tuple(methods)
    with pytest.raises(InvalidInput):
        chosen_methods(methods, ["no"], simulation=True)
    own = {m["route"] for m in answer("run", "fig3a", "--of", "H", "--no-simulation")["methods"]}
    assert len(own) > 3 and not {"montecarlo", "nonintegrable/simulation"} & own
    for method in all_methods(tol=1e-7):
        assert method.tol == (None if method.route.sampled else 1e-7)


def test_the_version_is_that_of_the_distribution(fpk):
    status, out, _ = fpk("--version")
    assert status == 0 and out.startswith("fpk ") and out[4].isdigit()
