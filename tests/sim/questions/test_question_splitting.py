"""Adaptive multilevel splitting: unbiased, exact on averaged energies, and its paths."""

from dataclasses import replace
from functools import partial
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from averaged_splitting import bridge_maximum, rare_failure_of_process
from numba import njit
from scipy.stats import kstest
from scipy.stats import t as student
from sim_systems import exact, fig6, mixed, passed
from test_step_schemes import contact

import sim.questions.splitting.run as splitting_run
from fpk import Contact, DampingTerm, System
from fpk.answer.names import REST, parse_limit, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.linear import natural_modes
from sim.questions.averaged.square_root import SquareRootForm
from sim.questions.passing import cubic_of, cubic_passage
from sim.questions.rounds import on_shell
from sim.questions.splitting import Splitting, rare_failure
from sim.questions.splitting.kernel import SCORE_LEVELS
from sim.questions.splitting.run import mean_and_error, split, system_problem
from sim.step.random import GOLDEN, fill_normals, stream_offset
from sim.step.schemes import exact_flow

QUICK = Splitting(replicas=64, killed=4, repetitions=8, threads=1)
DECAY, NOISE = 0.1, 0.05


def square_root(n: int = 1) -> SquareRootForm:
    """dH = (n D' − γ H) dt + √(2 D' H) dB."""
    noise, slope, linear = (np.array([x]) for x in (n * NOISE, 2.0 * NOISE, DECAY))
    return SquareRootForm(noise, slope, None, linear, lambda X: X, noise / DECAY)


def exact_failure(limit: float, time: float, start: float = 0.0, n: int = 1) -> float:
    """P(T <= time) from E e^{−sT} = 1F1(s/γ; n; γ H/D')/1F1(s/γ; n; γ H_f/D'), inverted."""
    with mp.workdps(40):
        c, D = mp.mpf(repr(DECAY)), mp.mpf(repr(NOISE))

        def transform(s):
            return mp.hyp1f1(s / c, n, c * start / D) / mp.hyp1f1(s / c, n, c * limit / D) / s

        return float(mp.invertlaplace(transform, time, method="talbot", degree=50))


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


@pytest.mark.parametrize("killed", [1, 5])
def test_walks_with_ties_have_the_exact_mean(killed):
    """Almost all replicas are tied, on nine levels. 4.5 deviations: a false alarm in 1.5e5."""
    steps, up, high, count = 20, 0.35, 9, 12
    right, stream = exact_maximum(steps, up, high), np.random.default_rng(1401)
    answers = [split(Walk(count, steps, up, stream), high, killed, stream) for _ in range(1000)]
    values, levels = np.exp([log for log, _, _ in answers]), np.array([n for _, n, _ in answers])
    error = values.std() / np.sqrt(values.size)
    assert abs(values.mean() - right) < 4.5 * error < 0.4 * right
    # Were only those counted that had to be killed, and not the ties:
    assert np.mean((1.0 - killed / count) ** levels * (values > 0)) > 5.0 * right


TABLE = replace(square_root(), linear=np.array([0.04]), damping=lambda X: 0.06 + 0.0 * X)
"""Damping split off the linear one and given as a table: the same equation."""


@pytest.mark.parametrize(
    ("form", "n", "limit", "start"),
    [(square_root(), 1, 6.845, 0.0), (square_root(), 1, 9.0, 1.0), (square_root(2), 2, 9.0, 0.0),
     (TABLE, 1, 6.845, 0.0)],
)  # fmt: skip
def test_one_averaged_energy_against_its_exact_probability(form, n, limit, start):
    """P of 1e-4 to 2e-6; 4 stated errors, each with 15 degrees of freedom or more: 1e-3."""
    right = exact_failure(limit, 60.0, start, n)
    settings = Splitting(replicas=128, killed=8, repetitions=16, threads=1, seed=2)
    found = rare_failure_of_process(form, limit, 60.0, start=start, settings=settings)
    assert 1e-7 < right < 1e-3
    assert abs(found.probability - right) < 4.0 * found.error < 2.0 * right
    assert found.log_probability == pytest.approx(np.log(found.probability))


@pytest.mark.slow
@pytest.mark.parametrize("limit", [6.845, 9.286, 11.685, 14.074, 16.443])
def test_scores_of_twenty_answers_are_uniform(limit):
    """P = 1e-4, 1e-6 .. 1e-12 in 100 time units: z by the sampling error, and by the stated one."""
    right = exact_failure(limit, 100.0)
    settings = [Splitting(replicas=256, killed=16, seed=seed) for seed in range(20)]
    answers = [rare_failure_of_process(square_root(), limit, 100.0, settings=s) for s in settings]
    z = np.array([(a.probability - right) / a.sampling_error for a in answers])
    assert kstest(student(15).cdf(z), "uniform").pvalue > 1e-3
    assert np.mean(np.square([(a.probability - right) / a.error for a in answers])) < 1.0
    # The same answers do not belong to a limit that is 2 % higher.
    z = np.array([a.probability for a in answers]) / exact_failure(1.02 * limit, 100.0) - 1.0
    assert z.mean() > 5.0 * z.std() / np.sqrt(20.0)


def twin(system, limit, time, steps, *, paths, seed):
    """Plain NumPy paths on the same stream: states before each kick, and x of the score."""
    n, h = system.n, time / steps
    A = exact_flow(system, h)
    L, values = A.matrix[:, 2 * n :], np.array(list(limit.values.values()))
    pairs, c = (A.factor.shape[1] + 1) // 2, values.size
    row = int(next(iter(limit.values))[1:] or 1) - 1
    shapes, omega = natural_modes(system)
    N, a = system.noise_matrix, h * h / (12.0 * system.mass)

    def observed(x):
        g, slope = (y.T for y in contact(system, x[:, :n].T))
        p = (x[:, n:] - 0.5 * h * g * (1.0 - a * slope)) * (1.0 + a * slope)
        return x[:, :n] - a * g, p + (a * g) @ system.damping.T

    def reached(x):
        """√(E_i/E_f) of a displacement, from all modes, for what has not passed the limit."""
        q, p = observed(x)
        size = np.hypot((q * system.mass) @ shapes, p @ shapes / omega) @ np.abs(shapes[row])
        E, E_f = (
            0.5 * s * s / system.compliance[row, row] + system.contact_energy(row, at)
            for s, at in ((size, q[:, row]), (np.full(2, values), np.array([1.0, -1.0]) * values))
        )
        return np.minimum(np.sqrt(E / E_f.min()), 1.0 - 2.0**-53)[:, None]

    def seen(x):
        """q and v; or energies, σ² and β: the noise makes β of σ² as it adds 1 to H."""
        q, p = observed(x)
        if limit.kind == "q":
            return q[:, [row]], p[:, [row]] / system.mass[row]
        if limit.kind == "H":
            u = p / system.mass @ N
            noise = 2.0 * (p / system.mass * u).sum(1)
            F = N / np.outer(system.mass, system.mass)  # at rest the means of both count
            beta = np.full(len(p), 4.0 * np.trace(F @ N / system.mass) / np.trace(F))
            moves = noise > 0.0
            beta[moves] = (8.0 * (u * u / system.mass).sum(1))[moves] / noise[moves]
            return system.hamiltonian(q, p)[:, None], (noise[:, None], beta[:, None])
        modes = [int(name[1:]) - 1 for name in limit.values]
        Q, P = (q * system.mass) @ shapes * omega, p @ shapes
        noise = np.diag(shapes.T @ N @ shapes)
        beta = np.broadcast_to(4.0 * noise, P.shape)
        energies = 0.5 * (Q * Q + P * P)
        return energies[:, modes], ((2.0 * noise * P * P)[:, modes], beta[:, modes])

    x = np.zeros((paths, 2 * n))
    states, shares = [x], []
    value, spread = seen(x)
    t = np.linspace(0.0, 1.0, 4001)
    for k in range(steps):
        g, slope = (y.T for y in contact(system, x[:, :n].T))
        x = x.copy()
        x[:, n:] -= h * g * (1.0 - a * slope)
        places = [[place(seed, j, k * (pairs + c) + m) for m in (0, *range(pairs, pairs + c))]
                  for j in range(paths)]  # fmt: skip
        z = np.array([called_normals(at[0], pairs) for at in places]).T
        x = x @ A.propagator.T + (L[:, : 2 * pairs] @ z[: L.shape[1]]).T
        before, rate = value, spread
        value, spread = seen(x)
        states.append(x)
        most = np.empty_like(value)
        for j in range(paths):
            if limit.kind == "q":
                q = (
                    (1 + 2 * t) * (1 - t) ** 2 * before[j, 0] + t**2 * (3 - 2 * t) * value[j, 0]
                    + h * (t * (1 - t) ** 2 * rate[j, 0] - t**2 * (1 - t) * spread[j, 0])
                )  # fmt: skip
                most[j, 0] = np.abs(q).max()
                continue
            for m in range(c):
                ends = []
                for H, (s2, beta) in ((before, rate), (value, spread)):
                    e = s2[j, m] / beta[j, m]
                    way = np.sqrt(max(e + values[m] - H[j, m], 0.0)) - np.sqrt(e)
                    ends.append(2.0 * way / np.sqrt(beta[j, m]))
                # Where a bridge to that side of the limit would be, the path has passed it.
                top = called_bridge(-ends[0], -ends[1], h, places[j][1 + m])
                most[j, m] = values[m] if top >= 0.0 else value[j, m]
        share = most / values
        inside = reached(x) if limit.kind == "q" else np.sqrt(np.maximum(share, 0.0))
        shares.append(np.where(share >= 1.0, 1.0, inside))
    return np.array(states), np.array(shares)


def place(seed, trajectory, counter):
    at = ((trajectory << 40) + counter) * int(GOLDEN) + int(stream_offset(seed))
    return np.uint64(at % 2**64)


@njit
def called_normals(at, pairs):
    z = np.zeros(2 * pairs, np.float32)
    fill_normals(z, np.zeros(1, np.uint64), at, pairs, 1)
    return z


@njit
def called_bridge(a, b, variance, at):
    return bridge_maximum(a, b, variance, at)


@njit
def called_cubic(q0, v0, q1, v1, h, limit):
    return cubic_passage(cubic_of(q0, v0, q1, v1, h), limit)


def slow(*row):
    return pytest.param(*row, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("system", "limit"),
    [(fig6, "H=0.6"), slow(fig6, "q2=0.9"), slow(mixed, "H1=0.3,H3=0.4"), slow(mixed, "H=0.6")],
)
def test_paths_are_those_of_plain_numpy(system, limit):
    """States to 1e-9 in 60 steps, maxima to 2e-7 (cubic: by 4001 points) hence at most a level."""
    system = system()
    limit = parse_limit(limit, system.n)
    problem = system_problem(system, limit, REST, 12.0, dt=None, score=None)
    paths, steps, seed, records = 12, 60, 5, 0
    replicas = problem.replicas(paths, steps, seed, np.random.default_rng(0))
    states, shares = twin(system, limit, 12.0, steps, paths=paths, seed=seed)
    own, tables = replicas.paths, replicas.model[-2]
    rows, columns = (size - 1 for size in tables.shape[1:])
    written = 1 + np.argmax(own.level == replicas.best[:, None], axis=1)
    for i in range(paths):
        top, m = own.level[i, 0], 1
        for k in range(1, steps + 1):
            left, levels = rows * np.sqrt(1.0 - k / steps), []
            for share, table in zip(shares[k - 1, i], tables, strict=True):
                x = share * columns
                j, r = min(int(x), columns - 1), min(int(left), rows - 1)
                low, high = (t[j] + (x - j) * (t[j + 1] - t[j]) for t in table[r : r + 2])
                inside = min(low + (left - r) * (high - low), SCORE_LEVELS - 1)
                levels.append(SCORE_LEVELS if x >= columns else inside)
            rose = m < written[i] and own.step[i, m] == k
            if abs(max(levels) - top - 1.0) > 1e-3:  # else rounding decides
                assert rose == (max(levels) > top + 1.0)
            if rose:
                assert abs(own.level[i, m] - max(levels)) < 1.0 + 1e-3
                np.testing.assert_allclose(own.state[i, m], states[k, i], rtol=0.0, atol=1e-9)
                top, m, records = own.level[i, m], m + 1, records + 1
            if top == SCORE_LEVELS:
                break
        assert replicas.best[i] == top
    assert records > 3 * paths


def test_largest_values_between_steps():
    """The cubic against its own points; the bridge against P(max > m) = exp(−2 (m−a)(m−b)/V)."""
    stream, h = np.random.default_rng(7), 0.7
    t = np.linspace(0.0, 1.0, 2001)
    for q0, v0, q1, v1 in stream.standard_normal((200, 4)):
        q = (
            (1 + 2 * t) * (1 - t) ** 2 * q0 + t**2 * (3 - 2 * t) * q1
            + h * (t * (1 - t) ** 2 * v0 - t**2 * (1 - t) * v1)
        )  # fmt: skip
        # A maximum lies up to half an interval from a point: q'' <= 50, so that it is 4e-7 higher.
        top = np.abs(q).max()
        if top > abs(q0):
            assert called_cubic(q0, v0, q1, v1, h, top - 1e-12) <= 1.0
        assert called_cubic(q0, v0, q1, v1, h, top + 2e-6) == 2.0
    assert called_cubic(0.3, 0.0, 0.3, 0.0, 0.1, 0.3 + 1e-15) == 2.0
    assert called_cubic(0.0, 1.0, 0.1, 1.0, 0.1, 0.05) == pytest.approx(0.5)
    a, b, variance = 0.2, 0.5, 0.3
    top = np.array([called_bridge(a, b, variance, place(3, 1, k)) for k in range(20_000)])
    assert top.min() >= b
    assert kstest(np.exp(-2.0 * (top - a) * (top - b) / variance), "uniform").pvalue > 1e-4


def test_an_answer_depends_on_the_seed_alone():
    one, two, other = (
        rare_failure(fig6(), parse_limit("H=2", 2), REST, 20.0, settings=replace(QUICK, **own))
        for own in ({}, {"threads": 2}, {"seed": 2})
    )
    np.testing.assert_array_equal(one.values, two.values)
    assert one.error == two.error and one.bias == two.bias
    assert not np.isin(one.values, other.values).any()
    assert one.probability == pytest.approx(one.values.mean(), rel=1e-12) and one.probability > 0.0


def test_a_run_that_was_cut_goes_on(tmp_path, monkeypatch):
    """After five repetitions it stops; what was finished is not made again."""
    settings = replace(QUICK, checkpoint=tmp_path)
    run = partial(rare_failure_of_process, square_root(), 3.0, 20.0)
    whole, made = run(settings=QUICK), []
    original = splitting_run.repetition

    def killed_after(most):
        def repetition(*arguments):
            if len(made) == most:
                raise KeyboardInterrupt
            made.append(arguments[3:])
            return original(*arguments)

        return repetition

    monkeypatch.setattr(splitting_run, "repetition", killed_after(5))
    with pytest.raises(KeyboardInterrupt):
        run(settings=settings)
    monkeypatch.setattr(splitting_run, "repetition", killed_after(1000))
    resumed = run(settings=settings)
    assert len(made) == len(set(made)) == 16
    np.testing.assert_array_equal(resumed.values, whole.values)
    assert resumed.error == whole.error
    run(settings=settings)
    assert len(made) == 16
    assert [p.name[:10] for p in tmp_path.glob("*.checkpoint")] == ["splitting-"]
    with pytest.raises(NotCertified, match="0 repetitions"):
        run(settings=replace(QUICK, partial=True, seconds=1e-9))


def test_more_repetitions_are_made_until_the_error_is_small():
    run = partial(rare_failure_of_process, square_root(), 3.0, 20.0)
    loose, tight = (run(settings=replace(QUICK, tol=tol)) for tol in (10.0, 0.1))
    assert loose.values.size == 8 < tight.values.size and tight.relative_error <= 0.1
    np.testing.assert_array_equal(tight.values[:8], loose.values)


def test_certain_failure_is_one_and_a_limit_that_nobody_reaches_has_a_bound():
    """1e300 times kT: every estimate is 0; 1024 paths without a failure bound P at 95 %."""
    run = partial(rare_failure_of_process, square_root())
    found = run(1e300, 1.0, settings=replace(QUICK, replicas=128, killed=127))
    assert found.probability == 0.0 and found.extinct == 8
    assert found.error == found.upper_bound == pytest.approx(3.0 / 1024, rel=0.01)
    assert found.log_probability == -np.inf and found.relative_error == np.inf
    found = run(1e-6, 50.0, settings=QUICK)
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


@pytest.mark.parametrize(
    ("key", "value"),
    [("replicas", 1), ("killed", 512), ("killed", 0), ("repetitions", 3), ("dt", 0.0),
     ("tol", -1.0), ("seconds", np.inf), ("seed", -1), ("threads", 0)],
)  # fmt: skip
def test_settings_that_cannot_be_used(key, value):
    with pytest.raises(InvalidInput, match=key):
        Splitting(**{key: value})


SILENT = System([1.0], [1.0], [0.1], [0.0])


@pytest.mark.parametrize(
    ("words", "change"),
    [
        *(("start", {"start": start}) for start in ("H=1", "q1=2", "H1=0.5,H2=0.6")),
        ("start", {"limit": "q1=0.5", "start": "q1=-0.5"}),
        *(("time", {"time": time}) for time in (0.0, -1.0, np.inf, np.nan)),
        ("dt", {"time": 1e9, "settings": Splitting(dt=1e-3)}),
        ("score", {"limit": "H1=1.3,H2=1.3", "score": lambda H, t: np.outer(t, H)}),
        ("noise", {"system": SILENT}),
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
    """Mean of V and of H over the shell of a contact system against quadrature; |z| < 4.5."""
    stops = Contact(1, "right", 4.0, 0.3), Contact(1, "left", 2.0, 0.1)
    for system, H in ((System([2.0], [1.5], [0.1], [0.1], contacts=stops), 0.8), (mixed(), 0.7)):
        q, p = on_shell(system, H, 20_000, np.random.default_rng(11))
        np.testing.assert_allclose(system.hamiltonian(q, p), H, rtol=1e-9)
        # Of uniform points of the shell E[p_i²/m_i] is the same for all i, and E q_i ∂V/∂q_i, too.
        force = q @ system.stiffness_matrix + contact(system, q.T)[0].T
        for x in (p**2 / system.mass - q * force, p):
            assert np.all(np.abs(x.mean(axis=0)) < 4.5 * x.std(axis=0) / np.sqrt(len(q)))


TERMS = (DampingTerm(1, 1, 0.05, q=((1, 2),)), DampingTerm(2, 1, 0.02, energy=1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "limit", "start", "time"),
    [
        (fig6(), "H=2.5", "rest", 40.0),
        (exact(), "H=3.5", "rest", 12.0),
        (mixed(), "H=3.0", "rest", 20.0),
        (replace(fig6(), damping_terms=TERMS), "H=1.5", "H=0.3", 20.0),
        (fig6(), "q2=1.05", "noise=0.5", 20.0),
        (fig6(), "H1=1.3,H2=1.3", "H1=0.1,H2=0.2", 20.0),
        (mixed(), "q3=0.8", "rest", 20.0),
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
    answer = rare_failure(fig6(), parse_limit("H=4", 2), REST, 20.0, settings=rare)
    assert answer.levels > 0.85 * answer.log_probability / np.log1p(-8 / 128)
