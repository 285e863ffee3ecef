"""The commands of questions in time: numbers, columns, statuses, notes; numbers of any size."""

import json

import numpy as np
import pytest
from systems import ONE_MASS

from averaging.phase_space.refinement import SOLUTION_MEMORY
from cases.show.records import passage_text
from fpk.numeric.errors import NotApplicable
from fpk.system.linear import stationary_covariance
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

DEFAULTS = {
    "transient": {"--of": "H", "--times": "1,10", "--at": "0.1,0.5,1"},
    "passage": {"--limit": "H=1"},
}


def asked(command, *options, scene="fig6a", method="nonintegrable"):
    """The words of a question with the defaults of its command."""
    own = dict(zip(options[::2], options[1::2], strict=True))
    given = DEFAULTS.get(command, {"--of": "q2", "--at": "-0.5:1:0.25"}) | own
    return [command, scene, "--method", method, *(word for pair in given.items() for word in pair)]


@pytest.fixture
def linear(linear_text, written):
    return {"scene": written(linear_text, "linear.toml"), "method": "linear"}


@pytest.fixture
def simulated(linear):
    return {**linear, "method": "montecarlo"}


def test_curves_of_a_linear_scene(linear, answer, fpk):
    """Rice's zero-crossing rate of a Gaussian; a correlation begins with the variance."""
    P = stationary_covariance(System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02]))
    for command, key in (("crossings", "rate"), ("spectrum", "spectrum")):
        record = answer(*asked(command, **linear))
        assert record["points"] == [-0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0]
        assert len(record[key]) == len(record["error"]) == 7
        assert record[key][1::2] == pytest.approx([record[key][3], record[key][3], record[key][5]])
    out = fpk(*asked("crossings", "--at", "0", **linear))[1]
    level, rate, _ = map(float, out.splitlines()[1].split())
    assert (level, rate) == (0.0, pytest.approx(np.sqrt(P[3, 3] / P[1, 1]) / (2.0 * np.pi)))
    record = answer(*asked("correlation", "--at", "0:10:0.5", **linear))
    assert len(record["correlation"]) == 21 and record["certificate"]["certified"]
    assert record["correlation"][0] == pytest.approx(P[1, 1]) and min(record["correlation"]) < 0.0
    out = fpk(*asked("correlation", "--at", "0:1:0.5", **linear))[1]
    assert out.startswith("# lag   correlation") and len(out.splitlines()) == 5
    question = "relaxation", linear["scene"], "--method", "linear"
    record = answer(*question, "--rates", 7)
    assert len(record["rates"]) == len(record["frequencies"]) == len(record["errors"]) == 7
    assert record["rates"] == sorted(record["rates"]) and min(record["rates"]) > 0.0
    assert len(fpk(*question)[1].splitlines()) == 1 + 5 + 1


def test_what_is_not_certified_is_said(scene_text, written, fpk, answer, refusal):
    scene = written(scene_text)
    question = asked("crossings", "--tol", "1e-4", scene=scene, method="phase-space")
    status, out, err = fpk(*question, "--json", "--memory", "0.001")
    record = json.loads(out)
    assert status == 1 and not record["certificate"]["certified"]
    assert "GB of memory, at most 0.001" in err and "exceeds the tolerance" in err
    finer = answer(*question, "--memory", "0.5")
    assert finer["settings"]["highest_degree"] > record["settings"]["highest_degree"]
    assert "--memory" in refusal(*question, "--memory", "0")
    assert f"{SOLUTION_MEMORY:g} if left out" in " ".join(fpk("crossings", "--help")[1].split())
    status, out, err = fpk(*asked("transient", "--start", "H=0.5", "--times", "1e-22"))
    assert status == 1 and out and "exceeds the tolerance" in err


def test_a_simulation_takes_its_seed_time_and_threads(linear, simulated, answer, fpk, monkeypatch):
    """Rice's rate within 4.5 stated errors; the seed alone makes the answer different."""
    exact = answer(*asked("crossings", "--at", "0", **linear))["rate"][0]
    rates = set()
    for seed in (7, 8):
        options = ("--at", "0", "--seed", seed, "--seconds", 0.2, "--threads", 1)
        record = json.loads(fpk(*asked("crossings", *options, **simulated), "--json")[1])
        assert abs(record["rate"][0] - exact) < 4.5 * record["error"][0]
        assert (record["solver"], record["error_kind"]) == ("simulation", "sampling")
        assert record["settings"]["seed"] == seed
        rates.add(record["rate"][0])
    assert len(rates) == 2

    def refuse(self, *asked, **options):
        raise NotApplicable(f"{self.seed}, {self.seconds}, {self.threads} and {self.dt}")

    settings = "--seed", 7, "--seconds", 0.5, "--threads", 2, "--dt", 0.01
    for command in ("passage", "transient"):
        monkeypatch.setattr(MonteCarlo, command, refuse)
        status, _, err = fpk(*asked(command, *settings, method="montecarlo"))
        assert status == 2 and "7, 0.5, 2 and 0.01" in err


def test_a_transient_and_a_passage_by_energy_averaging(answer):
    record = answer(*asked("transient"))
    assert record["times"] == [1.0, 10.0] and record["points"] == [0.1, 0.5, 1.0]
    assert np.shape(record["density"]) == np.shape(record["error"]) == (2, 3)
    assert (record["observable"], record["start"], record["solver"]) == ("H", "rest", "fem")
    # From rest the energy rises.
    assert 0.0 < record["density"][0][1] < record["density"][1][1]
    record = answer(*asked("passage", "--times", "0:100:50", "--start", "H=0.2"))
    assert (record["limit"], record["start"]) == ("H=1", "H=0.2")
    survival = record["survival"]
    assert survival == sorted(survival, reverse=True) and survival[0] == 1.0
    assert len(record["survival_error"]) == 3
    assert record["failure"] == pytest.approx([1.0 - s for s in survival])
    k = record["starts"]["starts"].index(0.2)
    assert record["starts"]["mean"][k] == pytest.approx(record["mean"], rel=1e-12)
    assert answer(*asked("passage"))["survival"] == []


@pytest.mark.parametrize(
    ("question", "rows"),
    [
        (asked("transient"), 1 + 2 * 3 + 1),
        (asked("passage", "--times", "1,2"), 1 + 3 + 2 * (1 + 2) + 1),
        (["relaxation", "fig6a", "--method", "nonintegrable", "--rates", 3], 1 + 3 + 1),
    ],
)
def test_columns(question, rows, fpk):
    status, out, err = fpk(*question)
    assert (status, err) == (0, "")
    assert "# solves the averaged equation: energy averaging (nonintegrable)" in out
    # The last line is the note on the averaging error, which is never known in time.
    columns, _, note = out.rpartition("\n# ")
    assert len(columns.splitlines()) == rows and ": averaging error not known here" in note


def test_a_variance_beyond_range_is_null_and_a_dash_in_text(linear, answer, fpk):
    record = answer(*asked("passage", "--limit", "H=100", scene=linear["scene"]))
    assert record["mean"] > 1e160 and record["variance"] is None
    assert record["mean_error"] < 2e-12 * record["mean"]
    status, out, _ = fpk(*asked("passage", "--limit", "H=300", scene="cir"))
    assert status == 0 and "variance  -  -" in out and "nan" not in out


def test_what_a_passage_that_is_not_certified_does_not_know_is_null(simulated, fpk):
    """Nothing fails in a fifth of a second: no moment is known, nor is any error but a bound."""
    options = "--limit", "H=1e3", "--seconds", 0.2, "--times", 5
    status, out, err = fpk(*asked("passage", *options, **simulated), "--json")
    record = json.loads(out, parse_constant=pytest.fail)  # of NaN and Infinity
    assert status == 1 and not record["certificate"]["certified"] and "not certified" in err
    assert record["mean_error"] is record["variance"] is record["variance_error"] is None
    assert (record["rate"], record["survival"]) == (0.0, [1.0]) and record["rate_error"] > 0.0


def test_a_rare_passage_is_left_to_splitting_and_says_so(simulated, answer):
    # P is about 3.5e-6: of 8192 paths none is to be expected.
    record = answer(*asked("passage", "--limit", "H=2", "--times", "10", **simulated))
    assert record["settings"]["sampled_by"].startswith("splitting: of 8192 plain paths")
    (p,), (error,) = record["failure"], record["failure_error"]
    assert 0.0 < error < 0.25 * p < 0.01 and record["survival"] == [1.0 - p]
    assert record["mean"] is record["rate"] is record["variance_error"] is None
    text = passage_text(record)
    assert "nan" not in text and "# splitting" in text and "P(T <= t)" in text


HUGE, TINY = (1e60, 1e60, 1e60, 1e90), (1e-50, 1.0, 1e-30, 1e-60)
AT_REST = ("density", "--of", "H", "--at", 0)
NO_CLEARANCE = "[[contact]]\nmass = 1\nside = 'both'\nstiffness = 1e8\nclearance = 0.0\n"
STOP = "[[contact]]\nmass = 1\nside = 'right'\nlaw = 'power'\nexponent = 2.0\n"


@pytest.fixture
def given(answer, written):
    def ask(text, command, *options, solver="fem", method="nonintegrable"):
        words = command, written(text), "--method", method, "--solver", solver, *options
        record = answer(*words)
        assert record["solver"] == solver
        return record

    return ask


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("system", [HUGE, TINY], ids=["huge", "tiny"])
def test_the_density_at_rest_is_that_of_its_limit(given, system, solver):
    record = given(ONE_MASS.format(*system), *AT_REST, solver=solver)
    (p,), (error,) = record["density"], record["error"]
    # One mass without contact: p = e^(−H/θ)/θ with θ = D/c.
    assert abs(p - system[2] / system[3]) <= error < 1e-10 * p


@pytest.mark.parametrize("solver", ["closed-form", "fem"])
def test_the_density_at_rest_rises_as_that_of_its_limit(given, solver, answer):
    asked = ("transient", "--of", "H", "--times", "1,100", "--at", "0,1")
    record = given(ONE_MASS.format(*HUGE), *asked, solver=solver)
    p, error = np.array(record["density"]), np.array(record["error"])
    # From rest p = e^(−H/θ_t)/θ_t with θ_t = θ (1 − e^(−ct/m)).
    exact = -1e-30 / np.expm1(-np.array([[1.0], [100.0]]))
    assert np.all(np.abs(p - exact) <= error) and np.all(error < 1e-10 * exact)
    plain = ONE_MASS.format(1.0, 1.0, 0.1, 0.05)
    record = given(plain + NO_CLEARANCE, *AT_REST, solver=solver)
    assert record["density"][0] > 1e3 and record["error"][0] < 1e-6
    # Several masses are hardly ever at rest.
    how = ("--method", "nonintegrable", "--solver", solver)
    assert answer("density", "fig6a", *how, *AT_REST[1:])["density"] == [0.0]


def test_rates_and_times_far_below_and_beyond_all_scales_and_starts_as_written(
    given, fpk, answer, refusal
):
    # 1F1(−1; 1; x) = 1 − x vanishes at x = c H/D = 1: the failure rate is c itself.
    weak = ONE_MASS.format(1.0, 1.0, 1e-9, 1e-9)
    record = given(weak, "passage", "--limit", "H=1", method="integrable", solver="closed-form")
    assert abs(record["rate"] - 1e-9) <= record["rate_error"] < 1e-20
    words = ("passage", "cir", "--method", "nonintegrable", "--limit")
    record = answer(*words, "H=1.5", "--times", "1e-50,1e50")
    survival, error = (np.array(record[key]) for key in ("survival", "survival_error"))
    assert np.all(np.abs(survival - [1.0, 0.0]) <= error) and np.all(error < 1e-10)
    assert "from H=0.9999999999 " in fpk(*words, "H=1", "--start", "H=0.9999999999")[1]
    assert '"H=1.0000000001"' in refusal(*words, "H=1", "--start", "H=1.0000000001")


def test_energies_whose_squares_overflow_are_answered_or_blamed_on_the_units(given, fpk, written):
    """The stop in the unit of the clearance, H in that of its square."""

    def far(stiffness, unit):
        system = ONE_MASS.format(1.0, 1.0, 1.0 / unit, unit)
        return f"{system}{STOP}stiffness = {stiffness}\nclearance = {unit}\n"

    first, second = (
        given(text, *AT_REST, solver="closed-form")["density"][0]
        for text in (far(1.0, 1e99), far(1e99, 1.0))
    )
    assert first * 1e198 == pytest.approx(second, rel=1e-11)
    for solver in ("fem", "quadrature"):
        how = ("--method", "nonintegrable", "--solver", solver)
        status, _, err = fpk("density", written(far(1.0, 1e99)), *how, *AT_REST[1:])
        assert status == 1 and err.count("\n") == 1
        assert "leave the range of double precision: choose other units" in err
