"""Adaptive multilevel splitting: unbiased, exact on free masses, and its paths."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numba import njit
from processes import failure
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import kstest
from scipy.stats import t as student
from sim_systems import exact, fig6, mixed, oscillator, passed, slow
from test_step_schemes import contact

import sim.questions.splitting.run as splitting_run
from fpk import Contact, DampingTerm, System
from fpk.answer.names import REST, Start, parse_limit, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from sim.questions.passing import cubic_of, cubic_passage
from sim.questions.rounds import on_shell
from sim.questions.splitting import RareFailure, Splitting, rare_failure
from sim.questions.splitting.kernel import least_action
from sim.questions.splitting.run import mean_and_error, split

QUICK = Splitting(replicas=64, killed=4, repetitions=8, threads=1)
DAMPING, NOISE = 0.1, 0.05


def of_energy(limit: float, time: float, settings: Splitting, *, n: int = 2) -> RareFailure:
    """P(H of a weakly damped chain of ``n`` masses passes the ``limit``), from rest."""
    system = oscillator() if n == 1 else fig6()
    return rare_failure(system, parse_limit(f"H={limit!r}", n), REST, time, settings=settings)


def of_free_masses(limit: float, n: int, start: Start, settings: Splitting) -> RareFailure:
    """P(the kinetic energy of ``n`` masses without springs passes the ``limit`` by t = 60).

    With the score of their own least action, as dH = (n D − 2 c H) dt + √(4 D H) dB.
    """
    ones = np.ones(n)
    system = System(ones, 1e-8 * ones, DAMPING * ones, NOISE * ones)
    score = partial(least_action, limit=limit, noise=2.0 * NOISE, decay=2.0 * DAMPING)
    asked = parse_limit(f"H={limit!r}", n), start, 60.0
    return rare_failure(system, *asked, score=score, settings=settings)


def exact_failure(limit: float, n: int, energy: float = 0.0) -> float:
    """P(T <= 60): each freedom is half of one of the square-root process with c = 0.2, d = 0.1."""
    rate = DAMPING / NOISE
    return float(failure(0.5 * n, rate * energy, rate * limit, 2.0 * DAMPING * 60.0))


class Walk:
    """Replicas of a walk on the whole numbers from 0, up with ``up``; its maximum is the score."""

    def __init__(self, count: int, steps: int, up: float, stream: np.random.Generator) -> None:
        self.steps, self.up, self.stream = steps, up, stream
        self.x = np.zeros((count, steps + 1), dtype=np.int64)
        self._anew(np.arange(count), np.zeros(count, dtype=np.int64))

    def _anew(self, which, begin):
        new = np.where(self.stream.random((which.size, self.steps)) < self.up, 1, -1)
        for k in range(self.steps):
            after = self.x[which, k] + new[:, k]
            self.x[which, k + 1] = np.where(k >= begin, after, self.x[which, k + 1])

    @property
    def best(self):
        return self.x.max(axis=1)

    def renew(self, dead, parents, level):
        assert (self.best[dead] <= level).all() and (self.best[parents] > level).all()
        self.x[dead] = self.x[parents]
        self._anew(dead, np.argmax(self.x[dead] > level, axis=1))


def exact_maximum(steps: int, up: float, high: int) -> float:
    """P(the walk reaches ``high``), by its distribution with the walk stopped there."""
    p = np.zeros(2 * steps + 2)
    p[steps], end = 1.0, steps + high
    for _ in range(steps):
        stopped, p[end] = p[end], 0.0
        p = up * np.roll(p, 1) + (1.0 - up) * np.roll(p, -1)
        p[end] += stopped
    return float(p[end])


def test_walks_with_ties_have_the_exact_mean():
    """Almost all replicas are tied, on nine levels. 4.5 deviations: a false alarm in 1.5e5."""
    steps, up, high, count, killed = 20, 0.35, 9, 12, 5
    right, stream = exact_maximum(steps, up, high), np.random.default_rng(1401)
    answers = [split(Walk(count, steps, up, stream), high, killed, stream) for _ in range(1000)]
    values, levels = np.exp([log for log, _, _ in answers]), np.array([n for _, n, _ in answers])
    error = values.std() / np.sqrt(values.size)
    assert abs(values.mean() - right) < 4.5 * error < 0.4 * right
    # Were only those counted that had to be killed, and not the ties:
    assert np.mean((1.0 - killed / count) ** levels * (values > 0)) > 5.0 * right


@pytest.mark.parametrize(("n", "limit", "start"), [(1, 5.0, "rest"), (2, 7.0, "p1=1")])
def test_free_masses_against_their_exact_probability(n, limit, start):
    """P of 7e-4 and 1e-4 at a long step; 4 errors of 31 degrees of freedom: 4e-4 each.

    Bridges between the steps are exact but for a tenth of the damping; without them half is lost.
    """
    right = exact_failure(limit, n, 0.0 if start == "rest" else 0.5)
    begin = parse_start(start, System(*np.ones((4, n))))
    settings = Splitting(replicas=512, killed=32, repetitions=32, threads=1, seed=2, dt=1.0)
    found = of_free_masses(limit, n, begin, settings)
    assert abs(found.probability - right) < 4.0 * found.sampling_error < 0.3 * right
    assert found.error >= found.sampling_error
    assert found.log_probability == pytest.approx(np.log(found.probability))


@pytest.mark.slow
@pytest.mark.parametrize("limit", [5.0, 9.0, 13.0])
def test_scores_of_twenty_answers_are_uniform(limit):
    """P = 4e-3 to 1e-9 by t = 60: z by the sampling error, and by the stated one."""
    right = exact_failure(limit, 2)
    settings = [Splitting(replicas=256, killed=16, seed=seed, dt=1.0) for seed in range(20)]
    answers = [of_free_masses(limit, 2, REST, s) for s in settings]
    z = np.array([(a.probability - right) / a.sampling_error for a in answers])
    assert kstest(student(15).cdf(z), "uniform").pvalue > 1e-3
    assert np.mean(np.square([(a.probability - right) / a.error for a in answers])) < 1.0
    # The same answers do not belong to a limit that is 2 % higher.
    z = np.array([a.probability for a in answers]) / exact_failure(1.02 * limit, 2) - 1.0
    assert z.mean() > 5.0 * z.std() / np.sqrt(20.0)


@pytest.mark.parametrize(("limit", "right"), [("q1>3.2", 2.6634949e-5), ("v1=3.4", 2.6458363e-5)])
def test_rare_sides_and_velocities_are_passed_as_by_the_equation(limit, right):
    """P by t = 30, at a failure rate of 5e-6, by ``phase-space`` to 1e-4 of itself; four errors."""
    settings = replace(QUICK, replicas=128, killed=16)
    asked = oscillator(0.1), parse_limit(limit, 1), REST, 30.0
    found = rare_failure(*asked, settings=settings)
    assert abs(found.probability - right) < 4.0 * found.sampling_error < 0.8 * right


@njit
def called_cubic(q0, v0, q1, v1, h, limit):
    return cubic_passage(cubic_of(q0, v0, q1, v1, h), -limit, limit)


def test_largest_values_between_steps():
    """The cubic against its own points."""
    stream, h = np.random.default_rng(7), 0.7
    t = np.linspace(0.0, h, 2001)
    for q0, v0, q1, v1 in stream.standard_normal((200, 4)):
        q = CubicHermiteSpline([0.0, h], [q0, q1], [v0, v1])(t)
        # A maximum lies up to half an interval from a point: q'' <= 50, so that it is 4e-7 higher.
        top = np.abs(q).max()
        if top > abs(q0):
            assert called_cubic(q0, v0, q1, v1, h, top - 1e-12) <= 1.0
        assert called_cubic(q0, v0, q1, v1, h, top + 2e-6) == 2.0
    assert called_cubic(0.3, 0.0, 0.3, 0.0, 0.1, 0.3 + 1e-15) == 2.0
    assert called_cubic(0.0, 1.0, 0.1, 1.0, 0.1, 0.05) == pytest.approx(0.5)


def test_an_answer_depends_on_the_seed_alone():
    one, two, other = (
        of_energy(2.0, 20.0, replace(QUICK, **own)) for own in ({}, {"threads": 2}, {"seed": 2})
    )
    np.testing.assert_array_equal(one.values, two.values)
    assert one.error == two.error and one.bias == two.bias
    assert not np.isin(one.values, other.values).any()
    assert one.probability == pytest.approx(one.values.mean(), rel=1e-12) and one.probability > 0.0


def test_a_run_that_was_cut_goes_on(tmp_path, monkeypatch):
    """After five repetitions it stops; what was finished is not made again."""
    settings, made = replace(QUICK, checkpoint=tmp_path), []
    whole, original = of_energy(2.0, 20.0, QUICK), splitting_run.repetition

    def killed_after(most):
        def repetition(*arguments):
            if len(made) == most:
                raise KeyboardInterrupt
            made.append(arguments[3:])
            return original(*arguments)

        monkeypatch.setattr(splitting_run, "repetition", repetition)

    killed_after(5)
    with pytest.raises(KeyboardInterrupt):
        of_energy(2.0, 20.0, settings)
    killed_after(1000)
    resumed = of_energy(2.0, 20.0, settings)
    assert len(made) == len(set(made)) == 16
    np.testing.assert_array_equal(resumed.values, whole.values)
    assert resumed.error == whole.error
    of_energy(2.0, 20.0, settings)
    assert len(made) == 16
    assert [p.name[:10] for p in tmp_path.glob("*.checkpoint")] == ["splitting-"]
    with pytest.raises(NotCertified, match="0 repetitions"):
        of_energy(2.0, 20.0, replace(QUICK, partial=True, seconds=1e-9))


def test_more_repetitions_are_made_until_the_error_is_small():
    loose, tight = (of_energy(2.0, 20.0, replace(QUICK, tol=tol)) for tol in (10.0, 0.1))
    assert loose.values.size == 8 < tight.values.size and tight.relative_error <= 0.1
    np.testing.assert_array_equal(tight.values[:8], loose.values)


def test_certain_failure_is_one_and_a_limit_that_nobody_reaches_has_a_bound():
    """1000 times kT: every estimate is 0; 1024 paths without a failure bound P at 95 %."""
    found = of_energy(500.0, 1.0, replace(QUICK, replicas=128, killed=127), n=1)
    assert found.probability == 0.0 and found.extinct == 8
    assert found.error == found.upper_bound == pytest.approx(3.0 / 1024, rel=0.01)
    assert found.log_probability == -np.inf and found.relative_error == np.inf
    found = of_energy(1e-6, 50.0, QUICK, n=1)
    assert found.probability == 1.0 and found.levels == 0.0
    # No path has lived: the error is that of one, and as much for what the step may do to it.
    assert found.error == pytest.approx(np.sqrt(2.0) / (QUICK.replicas * found.values.size))


def test_scattered_repetitions_have_no_finite_error():
    """Log-normal estimates of the mean 1: few of s = 2 look precise, and those of s = 0.3 are."""
    stream = np.random.default_rng(1402)
    for s, most in ((0.3, 0.0), (2.0, 0.98)):
        logs = s * stream.standard_normal((2000, 16)) - 0.5 * s * s
        means, errors = np.array([mean_and_error(x) for x in logs]).T
        assert np.mean(np.isinf(errors)) >= most
        # 15 degrees of freedom: beyond 4.1 errors with a probability of 1e-3, and skewed.
        assert np.mean(np.abs(means - 1.0) > 4.1 * errors) < 5e-3
        naive = logs.shape[1] ** -0.5 * np.exp(logs).std(axis=1, ddof=1)
        assert (np.mean(np.abs(means - 1.0) > 4.1 * naive) > 0.05) == (s == 2.0)
    assert mean_and_error(np.array([-np.inf] * 7 + [0.0]))[1] == np.inf


def test_settings_that_cannot_be_used():
    for key, value in (
        ("replicas", 1), ("killed", 512), ("killed", 0), ("repetitions", 3), ("dt", 0.0),
        ("tol", -1.0), ("seconds", np.inf), ("seed", -1), ("threads", 0),
    ):  # fmt: skip
        with pytest.raises(InvalidInput, match=key):
            Splitting(**{key: value})


@pytest.mark.parametrize(
    ("words", "change"),
    [
        *(("start", {"start": start}) for start in ("H=1", "q1=2", "H1=0.5,H2=0.6")),
        ("start", {"limit": "q1=0.5", "start": "q1=-0.5"}),
        *(("time", {"time": time}) for time in (0.0, -1.0, np.inf, np.nan)),
        ("dt", {"time": 1e9, "settings": Splitting(dt=1e-3)}),
        ("score", {"limit": "H1=1.3,H2=1.3", "score": lambda H, t: np.outer(t, H)}),
        ("noise", {"system": System([1.0], [1.0], [0.1], [0.0])}),
    ],
)
def test_questions_that_cannot_be_asked(words: str, change: dict[str, Any]):
    asked = {"system": fig6(), "limit": "H=1", "start": "rest", "time": 1.0} | change
    system = asked["system"]
    asked["start"] = parse_start(asked["start"], system)
    asked["limit"] = parse_limit(asked["limit"], system.n)
    with pytest.raises((InvalidInput, NotApplicable), match=words):
        rare_failure(**asked)


def test_starts_on_a_shell():
    """Of uniform points of a shell E p_i²/m_i = E q_i ∂V/∂q_i, the same for all i; |z| < 4.5."""
    stops = Contact(1, "right", 4.0, 0.3), Contact(1, "left", 2.0, 0.1)
    for system, H in ((System([2.0], [1.5], [0.1], [0.1], contacts=stops), 0.8), (mixed(), 0.7)):
        q, p = on_shell(system, H, 20_000, np.random.default_rng(11))
        np.testing.assert_allclose(system.hamiltonian(q, p), H, rtol=1e-9)
        force = q @ system.stiffness_matrix + contact(system, q.T)[0].T
        for x in (p**2 / system.mass - q * force, p):
            assert np.all(np.abs(x.mean(axis=0)) < 4.5 * x.std(axis=0) / np.sqrt(len(q)))


TERMS = (DampingTerm(1, 1, 0.05, q=((1, 2),)), DampingTerm(2, 1, 0.02, energy=1))


@pytest.mark.parametrize(
    ("system", "limit", "start", "time"),
    [
        (fig6(), "H1=1.3,H2=1.3", "H1=0.1,H2=0.2", 20.0),
        slow(fig6(), "q2=1.05", "noise=0.5", 20.0),
        slow(exact(), "H=3.5", "rest", 12.0),
        slow(mixed(), "H=3.0", "rest", 20.0),
        slow(replace(fig6(), damping_terms=TERMS), "H=1.5", "H=0.3", 20.0),
        slow(mixed(), "q3=0.8", "rest", 20.0),
    ],
)
def test_the_full_system_against_plain_simulation(system, limit, start, time):
    """Every kind of start and limit, and damping terms; 1e-1 to 1e-3; 4.5 standard errors."""
    plain = passed(system, limit, start, [time], time=time, paths=40_960)
    failed, error = 1.0 - plain.survival[0], plain.survival_error[0]
    asked = parse_limit(limit, system.n), parse_start(start, system), time
    found = rare_failure(system, *asked, settings=Splitting(seed=3))
    assert 5e-4 < failed < 0.1 and found.relative_error < 0.2
    assert abs(found.probability - failed) < 4.5 * np.hypot(error, found.error)


def test_the_score_of_an_energy_does_not_jump_at_the_turns_of_a_motion():
    """P is nearly (1 − K/N) to the number of levels if every level kills the K that it must alone.

    With an energy that seemed nearer to its limit where little moves, there were half as many.
    """
    rare = Splitting(replicas=128, killed=8, repetitions=8, threads=1, seed=3)
    answer = of_energy(4.0, 20.0, rare)
    assert answer.levels > 0.85 * answer.log_probability / np.log1p(-8 / 128)
