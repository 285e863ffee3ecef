"""``fpk transient``, ``fpk passage`` and averaged ``fpk relaxation``: keys, refusals, statuses."""

import json

import numpy as np
import pytest

from cases.show.records import passage_text
from fpk.numeric.errors import NotApplicable
from sim.montecarlo import MonteCarlo

DENSITY = {
    "scene", "method", "solver", "observable", "points", "density", "error", "error_kind",
    "certificate", "seconds", "times",
}  # fmt: skip
PASSAGE = {
    "scene", "method", "solver", "limit", "start", "mean", "mean_error", "variance",
    "variance_error", "rate", "rate_error", "times", "survival", "survival_error", "error_kind",
    "certificate", "seconds",
}  # fmt: skip
CERTIFICATE = {"mass_defect", "minimum", "residual", "tail_mass", "certified"}
MODULATION = "\n[modulation]\ntimes = [0, 10]\nfactor = [0.5, 1.0]\n"


@pytest.fixture
def linear_scene(scene_text, tmp_path):
    path = tmp_path / "linear.toml"
    system, rest = scene_text.split("[[contact]]")
    path.write_text(system + rest[rest.index("[observe]") :])
    return path


def asked(command, *options, scene="fig6a", method="nonintegrable"):
    given = {"transient": {"--of": "H", "--times": "1,10", "--at": "0.1,0.5,1"}, "passage": {}}
    defaults = {**given[command], **({"--limit": "H=1"} if command == "passage" else {})}
    own = dict(zip(options[::2], options[1::2], strict=True))
    words = [str(word) for pair in ({**defaults, **own}).items() for word in pair]
    return [command, str(scene), "--method", method, *words]


def record(fpk, *arguments):
    status, out, err = fpk(*arguments, "--json")
    assert (status, err) == (0, "")
    assert out.count("\n") == 1
    return json.loads(out)


def test_keys_of_a_transient(fpk):
    answer = record(fpk, *asked("transient"))
    assert answer.keys() >= DENSITY and answer["certificate"].keys() >= CERTIFICATE
    assert answer["times"] == [1.0, 10.0] and answer["points"] == [0.1, 0.5, 1.0]
    assert np.shape(answer["density"]) == np.shape(answer["error"]) == (2, 3)
    assert (answer["observable"], answer["start"], answer["solver"]) == ("H", "rest", "fem")
    # From rest the energy rises.
    assert 0.0 < answer["density"][0][1] < answer["density"][1][1]


def test_keys_of_a_passage(fpk):
    answer = record(fpk, *asked("passage", "--times", "0:100:50", "--start", "H=0.2"))
    assert answer.keys() >= PASSAGE and answer["certificate"].keys() >= CERTIFICATE
    assert (answer["limit"], answer["start"]) == ("H=1", "H=0.2")
    assert answer["survival"] == sorted(answer["survival"], reverse=True)
    assert answer["survival"][0] == 1.0 and len(answer["survival_error"]) == 3
    for time, failure in zip(answer["times"], answer["failure"], strict=True):
        assert failure == pytest.approx(1.0 - answer["survival"][answer["times"].index(time)])
    k = answer["starts"]["starts"].index(0.2)
    assert answer["starts"]["mean"][k] == pytest.approx(answer["mean"], rel=1e-12)
    assert record(fpk, *asked("passage"))["survival"] == []


def rows_of(out):
    """How many lines there are before the note on the averaging error, in time never exact."""
    rows, _, note = out.rpartition("\n# ")
    assert ": averaging error not known here" in note
    return len(rows.splitlines())


def test_columns(fpk):
    status, out, err = fpk(*asked("transient"))
    assert (status, err) == (0, "") and rows_of(out) == 1 + 2 * 3
    status, out, err = fpk(*asked("passage", "--times", "1,2"))
    assert (status, err) == (0, "") and rows_of(out) == 1 + 3 + 2 * (1 + 2)
    status, out, err = fpk("relaxation", "fig6a", "--method", "nonintegrable", "--rates", 3)
    assert (status, err) == (0, "") and rows_of(out) == 1 + 3


def test_a_solver_that_refuses_is_passed_over(linear_scene, fpk):
    answers = [
        record(fpk, *asked("passage", *solver, scene=linear_scene))
        for solver in ([], ["--solver", "closed-form"])
    ]
    assert [a["solver"] for a in answers] == ["fem", "closed-form"]
    for key in ("mean", "variance", "rate"):
        errors = sum(a[f"{key}_error"] for a in answers)
        assert abs(answers[0][key] - answers[1][key]) <= errors


def test_a_variance_beyond_range_is_null(linear_scene, fpk):
    answer = record(fpk, *asked("passage", "--limit", "H=100", scene=linear_scene))
    assert answer["mean"] > 1e160 and answer["variance"] is None
    assert answer["mean_error"] < 2e-12 * answer["mean"]


def test_a_variance_beyond_range_is_a_dash_in_text(fpk):
    arguments = asked("passage", "--limit", "H=300", scene="cir")
    status, out, _ = fpk(*(word for word in arguments if word != "--json"))
    assert status == 0 and "variance  -  -" in out and "nan" not in out


def test_modulated_noise(scene_text, tmp_path, fpk):
    scene = tmp_path / "modulated.toml"
    scene.write_text(scene_text + MODULATION)
    answer = record(fpk, *asked("transient", "--times", "5", "--tol", "1e-5", scene=scene))
    steady = record(fpk, *asked("transient", "--times", "5", "--tol", "1e-5"))
    # Less noise at first, less energy.
    assert answer["density"][0][2] < 0.5 * steady["density"][0][2]
    for factor, word in (("[0.5, -0.9]", "negative"), ("[1.0]", "one per time")):
        scene.write_text(scene_text + MODULATION.replace("[0.5, 1.0]", factor))
        status, out, err = fpk(*asked("transient", scene=scene))
        assert (status, out) == (2, "") and "modulation.factor" in err and word in err


REFUSED = [
    (asked("passage", "--start", "H=1"), "below the limit"),
    (asked("passage", "--start", "H=5", method="integrable"), '--start "H=5": must lie below the'),
    (asked("passage", "--start", "H=-1"), "negative"),
    (asked("passage", "--start", "q9=1"), "use rest"),
    (asked("passage", "--limit", "H=1e6"), "beyond the range"),
    (asked("passage", "--limit", "H=1e3", method="integrable"), "beyond the range"),
    (asked("passage", "--start", "H1=1,H2=0", method="integrable"), "below the limit"),
    (asked("passage", "--limit", "H=0"), "> 0"),
    (asked("passage", "--limit", "q2=1"), "total energy only"),
    (asked("passage", "--limit", "energy=1"), "use H=1.5"),
    (asked("passage", "--times", "2,1"), "ascend"),
    (asked("passage", "--times", "-1,1"), "0 or later"),
    (asked("passage", "--limit", "H=1e-300"), "at least"),
    (asked("passage", "--times", "nan"), '--times "nan": "nan" is not a finite number'),
    (asked("passage", "--times", "1e300"), "between 1e-100 and 1e100"),
    (asked("passage", "--solver", "closed-form"), "contacts"),
    (asked("passage", "--solver", "quadrature"), "use fem"),
    (asked("passage", "--solver", "magic"), "fem"),
    (asked("passage", method="exact"), "use one of nonintegrable"),
    (asked("passage", method="guess"), "use one of"),
    (asked("passage", "--tol", "2"), "--tol"),
    (
        asked("passage", "--start", "noise=1e-6", "--limit", "H1=1,H2=1", method="integrable"),
        "so narrow a density",
    ),
    (asked("passage", "--seed", "3"), "fpk: --seed 3: is not an option of nonintegrable by fem"),
    (asked("transient", "--threads", "1"), "fpk: --threads 1: is not an option"),
    (asked("transient", "--dt", "0.1"), "fpk: --dt 0.1: is not an option"),
    (asked("passage", "--dt", "-1", method="montecarlo"), "--dt -1.0: must be"),
    (asked("passage", "--seconds", "-1", method="montecarlo"), "--seconds -1.0: must be"),
    (asked("transient", "--times", "0,1"), "no density"),
    (asked("transient", "--of", "H7"), "H1..H2"),
    (asked("transient", "--of", "H,q1"), "two lists"),
    (asked("transient", method="exact"), "use one of nonintegrable"),
    (asked("transient", scene="missing"), "missing"),
]


@pytest.mark.parametrize(("arguments", "word"), REFUSED)
def test_what_cannot_be_used_is_refused_in_one_line(arguments, word, fpk):
    status, out, err = fpk(*arguments)
    assert (status, out) == (2, "") and err.count("\n") == 1 and word in err


def test_what_is_not_certified_is_said(fpk):
    status, out, err = fpk(*asked("transient", "--start", "H=0.5", "--times", "1e-22"))
    assert status == 1 and out and "exceeds the tolerance" in err


@pytest.mark.parametrize("command", ["passage", "transient"])
def test_a_simulation_takes_its_seed_time_threads_and_step(command, fpk, monkeypatch):
    def refuse(self, *asked, **options):
        own = f"{self.seed}, {self.seconds}, {self.threads} and {self.dt}"
        raise NotApplicable(f"asked with {own}")

    monkeypatch.setattr(MonteCarlo, command, refuse)
    settings = "--seed", 7, "--seconds", 0.5, "--threads", 2, "--dt", 0.01
    status, _, err = fpk(*asked(command, *settings, method="montecarlo"))
    assert status == 2 and "asked with 7, 0.5, 2 and 0.01" in err


def test_what_a_passage_that_is_not_certified_does_not_know_is_null(linear_scene, fpk):
    """Nothing fails in a fifth of a second: no moment is known, nor is any error but a bound."""
    options = "--limit", "H=1e3", "--seconds", 0.2, "--times", 5
    given = asked("passage", *options, scene=linear_scene, method="montecarlo")
    status, out, err = fpk(*given, "--json")
    answer = json.loads(out, parse_constant=pytest.fail)  # of NaN and Infinity
    assert status == 1 and not answer["certificate"]["certified"] and "not certified" in err
    assert answer["mean_error"] is answer["variance"] is answer["variance_error"] is None
    assert (answer["rate"], answer["survival"]) == (0.0, [1.0]) and answer["rate_error"] > 0.0


def test_a_rare_passage_is_left_to_splitting_and_says_so(fpk, linear_scene):
    # P is about 3.5e-6: of 8192 paths none is to be expected.
    question = asked(
        "passage", "--limit", "H=2", "--times", "10", scene=linear_scene, method="montecarlo"
    )
    answer = record(fpk, *question)
    assert answer["settings"]["sampled_by"].startswith("splitting: of 8192 plain paths")
    (p,), (error,) = answer["failure"], answer["failure_error"]
    assert 0.0 < error < 0.25 * p < 0.01 and answer["survival"] == [1.0 - p]
    assert answer["mean"] is answer["rate"] is answer["variance_error"] is None
    text = passage_text(answer)
    assert "nan" not in text and "# splitting" in text and "P(T <= t)" in text


def test_a_limit_that_is_passed_soon_and_a_step_that_is_too_long_for_it(fpk, linear_scene):
    question = "--limit", "H=1e-60", "--times", "1e-58"
    asking = {"scene": linear_scene, "method": "montecarlo"}
    answer = record(fpk, *asked("passage", *question, **asking))
    assert 0.0 < answer["mean"] < 1e-58 and answer["survival_error"][0] < 0.01
    status, out, err = fpk(*asked("passage", *question, "--dt", 0.1, **asking))
    assert status == 1 and out and "not all is seen; use" in err and err.count("\n") == 1
