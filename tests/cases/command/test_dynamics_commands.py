"""``fpk crossings``, ``spectrum``, ``correlation``, ``relaxation``: keys, refusals, statuses."""

import json

import numpy as np
import pytest

from averaging.phase_space.refinement import SOLUTION_MEMORY
from fpk.system.linear import stationary_covariance
from fpk.system.system import System

CERTIFICATE = {"mass_defect", "minimum", "residual", "tail_mass", "certified"}
CURVE = {
    "scene", "method", "solver", "observable", "points", "error", "error_kind", "certificate",
    "seconds",
}  # fmt: skip
RELAXATION = {"scene", "method", "solver", "rates", "errors", "certificate", "seconds"}


@pytest.fixture
def linear_scene(scene_text, tmp_path):
    path = tmp_path / "linear.toml"
    system, rest = scene_text.split("[[contact]]")
    path.write_text(system + rest[rest.index("[observe]") :])
    return path


def record(fpk, *arguments):
    status, out, err = fpk(*arguments, "--json")
    assert (status, err) == (0, "")
    assert out.count("\n") == 1
    return json.loads(out)


def asked(method, at="-0.5:1:0.25", of="q2"):
    return ["--method", method, "--of", of, "--at", at]


@pytest.mark.parametrize(("command", "key"), [("crossings", "rate"), ("spectrum", "spectrum")])
def test_keys_of_a_curve(command, key, linear_scene, fpk):
    answer = record(fpk, command, linear_scene, *asked("linear"))
    assert answer.keys() >= CURVE | {key} and answer["certificate"].keys() >= CERTIFICATE
    assert answer["points"] == [-0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0]
    assert len(answer[key]) == len(answer["error"]) == 7
    assert (answer["observable"], answer["error_kind"]) == ("q2", "numerical")
    assert answer[key][1::2] == pytest.approx([answer[key][3], answer[key][3], answer[key][5]])


def test_a_correlation_begins_with_the_variance(linear_scene, fpk):
    answer = record(fpk, "correlation", linear_scene, *asked("linear", at="0:10:0.5"))
    assert answer.keys() >= CURVE | {"correlation"} and len(answer["correlation"]) == 21
    system = System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])
    assert answer["correlation"][0] == pytest.approx(stationary_covariance(system)[1, 1])
    assert min(answer["correlation"]) < 0.0 and answer["certificate"]["certified"]


def test_a_correlation_has_columns_too(linear_scene, fpk):
    status, out, _ = fpk("correlation", linear_scene, *asked("linear", at="0:1:0.5"))
    assert status == 0 and out.startswith("# lag   correlation") and len(out.splitlines()) == 5


def test_keys_of_relaxation(linear_scene, fpk):
    answer = record(fpk, "relaxation", linear_scene, "--method", "linear", "--rates", 7)
    assert answer.keys() >= RELAXATION | {"frequencies"}
    assert len(answer["rates"]) == len(answer["frequencies"]) == len(answer["errors"]) == 7
    assert answer["rates"] == sorted(answer["rates"]) and min(answer["rates"]) > 0.0
    status, out, _ = fpk("relaxation", linear_scene, "--method", "linear")
    assert status == 0 and len(out.splitlines()) == 1 + 5 + 1


def test_columns_of_a_curve(linear_scene, fpk):
    status, out, err = fpk("crossings", linear_scene, *asked("linear", at="0"))
    assert (status, err) == (0, "")
    # Rice: the zero-crossing rate of a Gaussian.
    system = System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])
    C = stationary_covariance(system)
    level, rate, _ = map(float, out.splitlines()[1].split())
    assert (level, rate) == (0.0, pytest.approx(np.sqrt(C[3, 3] / C[1, 1]) / (2.0 * np.pi)))


def test_crossings_of_theories_of_the_energy(fpk):
    """In equilibrium energy averaging is exact; modal averaging leaves the stops out."""
    rates = {
        name: record(fpk, "crossings", "fig3a", *asked(name))["rate"]
        for name in ("exact", "nonintegrable", "integrable")
    }
    assert rates["nonintegrable"] == pytest.approx(rates["exact"], rel=1e-9)
    assert rates["integrable"][0] < 0.9 * rates["exact"][0]


def test_exact_crossings_with_contact(fpk):
    answer = record(fpk, "crossings", "fig3a", *asked("exact", of="q1"))
    assert answer["certificate"]["certified"] and min(answer["rate"]) > 0.0


REFUSED = [
    (["crossings", "fig6a", *asked("linear")], "contacts"),
    (["crossings", "fig6a", *asked("exact")], "condition (8)"),
    (["spectrum", "fig6a", *asked("linear")], "contacts"),
    (["relaxation", "fig6a", "--method", "linear"], "contacts"),
    (["spectrum", "fig3a", *asked("exact")], "use one of linear, phase-space"),
    (["correlation", "fig6a", *asked("linear", at="0")], "contacts"),
    (["correlation", "fig3a", *asked("exact")], "use one of linear, phase-space, montecarlo"),
    (["correlation", "fig3a", *asked("nonintegrable")], "use one of linear, phase-space"),
    (["correlation", "fig3a", *asked("phase-space", at="-1:1:1")], "--at -1.0: a lag is a time"),
    (["correlation", "fig3a", *asked("montecarlo", at="-1")], "--at -1.0: a lag is a time"),
    (["correlation", "fig3a", *asked("montecarlo", at="0,1e90")], "--at 1e+90: a lag takes"),
    (["correlation", "fig3a", *asked("phase-space", at="0,nan")], "not a finite number"),
    (["correlation", "fig3a", *asked("phase-space", of="p2", at="0")], "use a displacement"),
    (["relaxation", "fig3a", "--method", "exact"], "use one of linear, "),
    (["crossings", "fig6a", *asked("integrable"), "--solver", "fem"], "only modal energies"),
    (["crossings", "fig3a", *asked("guess")], "use one of exact"),
    (["crossings", "fig3a", *asked("exact"), "--solver", "fem"], "leave it out"),
    (["crossings", "fig3a", *asked("exact", of="p1")], "use a displacement, q1..q2"),
    (["spectrum", "fig3a", *asked("phase-space", of="q1,p1")], "use a displacement, q1..q2"),
    (["spectrum", "fig3a", *asked("phase-space", of="H")], "use a displacement, q1..q2"),
    (["spectrum", "fig3a", *asked("phase-space", of="q3")], "q1..q2"),
    (["spectrum", "fig3a", *asked("phase-space", at="0,y")], "not a finite number"),
    (["spectrum", "fig3a", *asked("phase-space", at="0 x 1")], "one list"),
    (["spectrum", "fig3a", *asked("phase-space"), "--tol", "2"], "--tol"),
    (["spectrum", "fig3a", "--method", "phase-space", "--of", "q2"], "--at"),
    (["relaxation", "fig3a", "--method", "phase-space", "--rates", "0"], "--rates"),
    (["relaxation", "fig3a", "--method", "phase-space", "--rates", "x"], "--rates"),
    (["spectrum", "fig3a", *asked("montecarlo", at="0,1e90")], "ask for lower ones"),
    (["spectrum", "chain-10", *asked("phase-space")], "10 masses have 20 coordinates"),
    (["spectrum", "missing", *asked("phase-space")], "missing"),
    (
        ["crossings", "fig3a", *asked("exact"), "--seed", "3"],
        "fpk: --seed 3: is not an option",
    ),
    (["crossings", "fig3a", *asked("montecarlo"), "--seconds", "-1"], "--seconds -1.0: must be"),
]


@pytest.mark.parametrize(("arguments", "word"), REFUSED)
def test_what_does_not_apply_is_refused_with_the_reason(arguments, word, fpk):
    status, out, err = fpk(*arguments)
    assert (status, out) == (2, "") and err.count("\n") == 1 and word in err


@pytest.mark.parametrize(
    ("command", "key", "at"),
    [
        ("crossings", "rate", "-0.5:1:0.25"),
        ("spectrum", "spectrum", "-0.5:1:0.25"),
        ("correlation", "correlation", "0:9:0.5"),
    ],
)
def test_the_full_equation_answers_as_the_exact_one(command, key, at, linear_scene, fpk):
    answers = [
        record(fpk, command, linear_scene, *asked(method, at=at), *threads)
        for method, threads in (("linear", ()), ("phase-space", ("--threads", 1)))
    ]
    assert [a["solver"] for a in answers] == ["closed-form", "hermite"]
    for exact, value, error in zip(
        answers[0][key], answers[1][key], answers[1]["error"], strict=True
    ):
        assert abs(exact - value) <= error + 1e-12 * exact
    assert answers[1]["settings"]["highest_degree"] > 0


def test_what_is_not_certified_is_said(linear_scene, fpk):
    scene = linear_scene.parent / "contact.toml"
    stop = '[[contact]]\nmass = 2\nside = "both"\nstiffness = 10.0\nclearance = 0.5\n'
    scene.write_text(linear_scene.read_text().replace("[observe]", stop + "[observe]"))
    question = "crossings", scene, *asked("phase-space"), "--tol", "1e-4", "--json"
    status, out, err = fpk(*question, "--memory", "0.001")
    answer = json.loads(out)
    assert status == 1 and not answer["certificate"]["certified"]
    assert "GB of memory, at most 0.001" in err and "exceeds the tolerance" in err
    finer = record(fpk, *question[:-1], "--memory", "0.5")
    assert finer["settings"]["highest_degree"] > answer["settings"]["highest_degree"]
    status, out, err = fpk(*question, "--memory", "0")
    assert (status, out) == (2, "") and "--memory" in err
    assert f"{SOLUTION_MEMORY:g} if left out" in " ".join(fpk("crossings", "--help")[1].split())


def test_a_simulation_takes_its_seed_time_and_threads(linear_scene, fpk):
    """Rice's rate within 4.5 stated errors; the seed alone makes the answer different."""
    exact = record(fpk, "crossings", linear_scene, *asked("linear", at="0"))["rate"][0]

    def simulated(**options):
        given = [part for key, value in options.items() for part in (f"--{key}", value)]
        status, out, _ = fpk(
            "crossings", linear_scene, *asked("montecarlo", at="0"), *given, "--json"
        )
        answer = json.loads(out)
        assert status == 0 or not answer["certificate"]["certified"]
        assert abs(answer["rate"][0] - exact) < 4.5 * answer["error"][0]
        return answer

    answer = simulated(seed=7, seconds=0.2, threads=1)
    assert (answer["solver"], answer["error_kind"]) == ("simulation", "sampling")
    assert answer["settings"]["seed"] == 7
    assert simulated(seed=8, seconds=0.2)["rate"] != answer["rate"]
