"""Motion in time: three-way comparison, rare failure, interruption, and what is written of it."""

import json
from dataclasses import dataclass, replace
from math import nan

import numpy as np
import pytest
import xarray as xr
from scipy.special import expi

from cases.compare import answering
from cases.compare.answering import replies_of
from cases.compare.attempts import Attempts
from cases.compare.claims import time_findings
from cases.compare.in_time import Given, Replies
from cases.compare.rare import passage_answer
from cases.compare.routes import method_for, register_routes
from cases.compare.stationary import run_scene
from cases.scene.questions import PassageQuestion
from cases.scene.scene import load_scene
from cases.show.digest import digest_of, verify_row
from cases.show.fields import write_netcdf
from cases.show.report import write_report
from cases.show.text import render
from cases.show.vtk import write_time_pvd
from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import Passage, Transient
from fpk.answer.method import ROUTES, Method, silent
from fpk.answer.names import REST, parse_limit
from fpk.answer.quantities import Number
from fpk.answer.question import answer
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.passage import LEAST_TAIL_FAILURES
from sim.sample.diagnostics import FALSE_ALARMS

register_routes()
CIR = load_scene("cir")
(PASSAGE,), (TRANSIENT,) = CIR.passages, CIR.transients
SEED = 20261123
FEM, CLOSED = ("nonintegrable", "fem"), ("nonintegrable", "closed-form")
SIMULATED, FULL = ("nonintegrable", "simulation"), ("montecarlo", "simulation")
EQUATION = ("phase-space", "hermite")


def certificate(*failures):
    measured = Measured(0.0, 0.0, 0.0, nan, 0.0, failures=failures)
    return certify(measured, tol=np.inf, sampled=True)


def survival_answer(values, errors, kind, *, mean=(1.0, 0.0), rate=(1.0, 0.0), failure=None):
    times = np.arange(1.0, len(values) + 1.0)
    errors = np.broadcast_to(errors, len(values)).astype(float)
    numbers = Number(*mean), Number(1.0, 0.0), rate and Number(*rate)
    given = (None, None) if failure is None else (np.array(failure), 1e-3 * np.array(failure))
    return Passage(*numbers, times, np.array(values), errors, kind, certificate(), None, {}, *given)


def compared(*answers):
    """The comparisons of a passage by what they are of."""
    given = tuple(Given(ROUTES[name], answer, 0.0) for name, answer in answers)
    return {c.observable.split(": ")[1]: c for c in Replies(PASSAGE, given).comparisons}


def test_stated_errors_are_the_band_of_two_solvers():
    a = survival_answer([0.5, 0.5], [1e-3], "numerical", mean=(2.0, 0.01))
    for off, holds in ((0.019, True), (0.021, False)):
        b = survival_answer([0.501, 0.495], [1e-3], "numerical", mean=(2.0 + off, 0.01))
        rows = compared((FEM, a), (CLOSED, b))
        mean = rows["mean time"]
        assert mean.measures == "numerical" and mean.norm == "relative"
        assert pytest.approx(off / 2.0) == mean.L1 and mean.holds is holds
        assert rows["P(T > 2)"].holds is False  # of both times that which is off more


def test_averaging_is_reported_relative_to_the_full_system_and_never_judged():
    a = survival_answer([0.9], [0.0], "numerical", rate=(2.0, 0.0), failure=[1e-9])
    b = survival_answer([0.5], [0.01], "sampling", rate=(4.0, 0.1), failure=[4e-9])
    for pair in (((FEM, a), (FULL, b)), ((FULL, b), (FEM, a))):
        rows = compared(*pair)
        assert {c.measures for c in rows.values()} == {"averaging"}
        assert all(c.band is None and c.b.method == "montecarlo" for c in rows.values())
        assert pytest.approx(0.5) == rows["failure rate"].L1
        assert rows["failure rate"].error == pytest.approx(0.1 / 4.0)
        assert pytest.approx(0.75) == rows["P(T ≤ 1)"].L1
        assert rows["P(T > 1)"].norm == "absolute"
    # What is not known is not compared.
    unknown = survival_answer(
        [1.0], [1e-9], "sampling", mean=(nan, np.inf), rate=None, failure=[2e-9]
    )
    assert {*compared((FEM, a), (FULL, unknown))} == {"P(T ≤ 1)", "P(T > 1)"}


def test_a_right_simulation_is_rarely_called_wrong():
    expected, paths = (0.999, 0.3, 0.003), 1024
    stream = np.random.default_rng(SEED)
    exact = survival_answer(expected, 0.0, "numerical")
    wrong = 0
    for count in np.minimum.accumulate(stream.binomial(paths, expected, (1000, 3)), axis=1):
        S = count / paths
        errors = np.maximum(np.sqrt(S * (1.0 - S) / paths), 1.0 / paths)
        rows = compared((FEM, exact), (SIMULATED, survival_answer(S, errors, "sampling")))
        wrong += any(not c.holds for of, c in rows.items() if "P(T" in of)
    # Of 1000 draws at FALSE_ALARMS 0.001 are expected.
    assert wrong == 0 and 1000 * FALSE_ALARMS < 0.002


def test_a_wrong_reliability_is_called_wrong_and_few_failures_are_not():
    S = np.array([0.9, 0.5])
    errors = np.sqrt(S * (1.0 - S) / 8192)
    # One failure of 10000 expected, none seen: chance e^-1, and no discrepancy.
    for expected, seen, error, holds in (
        (S + np.array([0.0, 0.05]), S, errors, False),
        ([1.0, 0.9999], [1.0, 1.0], [0.0, 1e-4], True),
        # Of ten failures one is seen, and its own standard error is too small.
        ([1.0, 0.99], [1.0, 1.0 - 1.0 / 1024.0], [0.0, 1.0 / 1024.0], True),
    ):
        exact = survival_answer(expected, 0.0, "numerical")
        rows = compared((FEM, exact), (SIMULATED, survival_answer(seen, error, "sampling")))
        assert [c.holds for of, c in rows.items() if "P(T" in of] == [holds]


X = np.linspace(0.0, 7.0, 129)


def densities(stream=None, *, noise=0.0, tilt=0.0):
    """An exponential density on 129 points, with noise of windows of 22 points, or tilted."""
    p, z = np.exp(-X), np.zeros(X.size)
    chance = noise * np.sqrt(p)
    if stream is not None:
        z = np.convolve(stream.standard_normal(X.size + 21), np.ones(22), "valid") / np.sqrt(22.0)
    values = p * (1.0 + tilt * (X - 1.0)) + chance * z
    kind = "sampling" if noise else "numerical"
    errors = chance if noise else np.full(X.size, 1e-12)
    return Transient(np.ones(1), values[None], errors[None], kind, certificate())


def transients(a, b, *windows, routes=(SIMULATED, FEM)):
    given = tuple(Given(ROUTES[r], p, 0.0) for r, p in zip(routes, (a, b), strict=True))
    return Replies(replace(TRANSIENT, times=(1.0,)), given, (), X, *windows)


def test_smoothed_noise_of_a_density_holds_and_a_tilt_of_it_does_not():
    stream, exact, window = np.random.default_rng(SEED), densities(), (np.arange(X.size),)

    def row(tilt=0.0):
        noisy = densities(stream, noise=0.02, tilt=tilt)
        return transients(noisy, exact, window).comparisons[0]

    rows = [row() for _ in range(1000)]
    assert sum(not row.holds for row in rows) < 3  # 0.1 are expected
    assert np.mean([row.L1 for row in rows]) == pytest.approx(rows[0].error, rel=0.05)
    # A tilt of 20 % has L1 = 0.15: the band is 0.11.
    assert not any(row(0.2).holds for _ in range(20))
    # Densities that nobody compares are a problem.
    assert not transients(exact, exact, window, routes=(FEM, CLOSED)).problems
    (problem,) = transients(exact, exact, routes=(FEM, CLOSED)).problems
    assert "not compared" in problem


@dataclass(frozen=True)
class Stub(Method):
    """A method that answers as it is told; ``error``: with a default tolerance of 1e-5."""

    name_of: tuple[str, str]
    says: object
    error: float | None = None
    paths: int = 8192
    checkpoint: object = None

    @property
    def route(self):
        return ROUTES[self.name_of]

    def prepare(self, system):
        raise NotImplementedError

    def refined(self):
        return self

    @answer
    def passage(self, asked):
        if isinstance(self.says, BaseException):
            raise self.says
        if self.error is None:
            return self.says
        measured = Measured(self.error, 0.0, 0.0, 0.0, 0.0)
        return replace(self.says, certificate=certify(measured, tol=asked.tol or 1e-5))


def replies(*methods, tol=None, **options):
    return replies_of(CIR.system, PASSAGE, methods, Attempts(**options), tol=tol)


def test_rare_failure_is_left_to_splitting(monkeypatch):
    rare = survival_answer([1.0] * 9, 0.0, "numerical", failure=[1e-9] * 9)
    split = survival_answer([1.0] * 9, 1e-9, "sampling", rate=None, failure=[2e-9] * 9)
    monkeypatch.setattr(answering, "split_passage", lambda *asked, **how: split)
    monkeypatch.setattr(answering, "splitting_of", lambda plain: None)
    seldom = survival_answer([1.0 - 1e-9] * 9, 0.0, "numerical", failure=[1e-9] * 9)
    few = replace(rare, error_kind="sampling", certificate=certificate("3 failures are too few"))
    # Splitting gives the full system's answer unless the equation does; nothing is simulated.
    simulations = [Stub(of, AssertionError("was simulated")) for of in (FULL, SIMULATED)]
    for method, own in ((FEM, ["nonintegrable/fem", "splitting"]), (EQUATION, ["phase-space"])):
        answers = replies(Stub(method, seldom), *simulations)
        assert [g.route.label for g in answers.given] == own and not answers.problems
        assert all("too rare for plain simulation" in r.reason for r in answers.refused)
        assert len(answers.refused) == 2
    # Not known before: the simulation itself says so.
    answers = replies(Stub(FULL, few))
    assert [g.route.label for g in answers.given] == ["splitting"]
    assert answers.refused[0].reason == "3 failures are too few"
    known = replace(rare, error_kind="sampling")
    assert [g.answer for g in replies(Stub(FULL, known)).given] == [known]


GOOD = survival_answer([0.5] * 9, 3e-5, "numerical")


def test_an_answer_that_fails_is_a_problem_and_one_that_does_not_apply_is_not():
    answers = replies(Stub(FEM, GOOD), Stub(CLOSED, InvalidInput("start", 1, "too high")))
    assert [r.failed for r in answers.refused] == [True]
    assert any("too high" in problem for problem in answers.problems)
    answers = replies(method_for("nonintegrable", "quadrature"), Stub(FEM, GOOD))
    assert [r.failed for r in answers.refused] == [False] and not answers.problems
    assert "no route answers" in replies(method_for("exact")).problems[0]
    # Interrupted answers are what there is.
    methods = Stub(CLOSED, GOOD), Stub(FEM, KeyboardInterrupt()), Stub(FULL, GOOD)
    answers = replies(*methods, partial=True)
    assert answers.interrupted and [g.answer for g in answers.given] == [GOOD]
    assert [r.failed for r in answers.refused] == [True, False]
    with pytest.raises(KeyboardInterrupt):
        replies(*methods)


def test_a_default_that_is_missed_is_a_note_and_a_tolerance_reaches_what_solves_in_time_only():
    method, sampled = Stub(FEM, GOOD, 3e-5), Stub(SIMULATED, GOOD, 3e-5)
    relaxed = replies(method, relax=True)
    assert not relaxed.problems and "nonintegrable/fem: certified to 1e-04" in relaxed.notes[0]
    assert not replies(method, tol=1e-4).problems
    for asked, tol, own in ((method, None, 1e-5), (method, 2e-5, 2e-5), (sampled, 1e-4, 1e-5)):
        strict = replies(asked, tol=tol)
        (problem,) = strict.problems
        assert not strict.notes and f"exceeds the tolerance {own:.0e}" in problem


@pytest.fixture(scope="module")
def outcome():
    solvers = [method_for("nonintegrable", s) for s in ("fem", "closed-form")]
    full = method_for("montecarlo", paths=4096, relaxations=5.0)
    return run_scene(CIR, [*solvers, full])


def test_the_square_root_process_is_known_by_every_route(outcome):
    (passage,), (transient,) = outcome.curves[0].passages, outcome.curves[0].transients
    assert len(passage.given) == len(transient.given) == 3 and not outcome.problems
    rate = next(g.answer.rate for g in passage.given)
    assert rate.value == pytest.approx(0.013742123052434, rel=1e-12)  # 1F1(-λ/c; 1; c H/D) = 0
    assert {c.measures for c in passage.comparisons} == {"numerical", "averaging"}
    (claim,) = time_findings(outcome.curves)
    assert claim.verdict == "holds" and "failure rate" in claim.claim


def test_everything_is_written(outcome, tmp_path):
    digest = digest_of(outcome)
    assert json.loads(json.dumps(digest, allow_nan=False)) == digest
    (passage,), (transient,) = digest["passages"], digest["transients"]
    assert passage["question"] == "H=1.5 from rest" and len(passage["answers"]) == 3
    assert {"of", "norm", "L1", "band", "holds"} <= transient["comparisons"][0].keys()
    judged = [c for q in (passage, transient) for c in q["comparisons"] if c["band"] is not None]
    assert 0 < len(judged) < digest["judged"]
    assert verify_row(digest)["holds"] and verify_row(digest)["certificates"] >= 6
    assert "mean time" in render("run.txt", {"digest": digest})

    page, *pictures = write_report(outcome, digest, tmp_path)
    assert {"passage_1.svg", "transient_1.svg"} <= {path.name for path in pictures}
    assert "In time" in page.read_text(encoding="utf-8")

    write_netcdf(outcome, tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as data:
        survival = data["survival_passage_1"]
        assert survival.shape == (1, 3, len(PASSAGE.times))
        assert data[survival.dims[-1]].values.tolist() == list(PASSAGE.times)
        points, p = data["at_transient_1"].values[0], data["p_transient_1"].values[0, 0]
        # The density of the last time on all points, by a rule that is good to 1e-4 there.
        assert np.trapezoid(p[-1], points) == pytest.approx(1.0, abs=5e-3)

    collection, *meshes = write_time_pvd(outcome, tmp_path)
    assert len(meshes) == len(TRANSIENT.times) and collection.name == "transient_1.pvd"
    pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")
    reader = pyvista.get_reader(collection)
    reader.set_active_time_point(len(meshes) - 1)
    (mesh,) = reader.read()
    assert mesh["nonintegrable fem"].size == mesh.n_points and mesh["time"][0] == 100.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["cir", "fig6-passage", "rare", "two-modes", "modulated", "earthquake"]
)
def test_shipped_scenes_hold(answer, name):
    digest = answer("run", name)
    claims = {claim["verdict"] for claim in digest["claims"]}
    assert not digest["problems"] and claims == ({"holds"} if name != "modulated" else set())


@pytest.mark.parametrize(("level", "last", "runs"), [(1.5, 400.0, 1), (3.5, 25.0, 2)])
def test_the_simulation_that_shows_how_rare_passages_are_is_used_where_it_answers(
    level, last, runs, monkeypatch
):
    """From 3.5 few of the paths pass by the last time, nearly all in the time that is allowed."""
    system, run, times = System([1.0], [1.0], [0.1], [0.05]), MonteCarlo.passage, []

    def counted(method, *asked, **how):
        times.append(method.time)
        return run(method, *asked, **how)

    monkeypatch.setattr(MonteCarlo, "passage", counted)
    question = PassageQuestion(parse_limit(f"H={level}", 1), REST, (last,))
    method = MonteCarlo(paths=4096, threads=1)
    found = passage_answer(method, system, question, tol=None, progress=silent)
    assert times == [last, None][:runs] and found.certificate.certified
    # But for averaging, with x = c H/D: 10 (Ei(x) − ln x − γ); 4 errors.
    x = 2.0 * level
    exact = 10.0 * (expi(x) - np.log(x) - np.euler_gamma)
    assert abs(found.mean.value - exact) < 4.0 * found.mean.error
    assert np.all(np.abs(found.survival) <= 1.0) and "sampled_by" not in found.settings
    assert level == 1.5 or 0.0 < (1.0 - found.survival[0]) * 4096 < LEAST_TAIL_FAILURES
