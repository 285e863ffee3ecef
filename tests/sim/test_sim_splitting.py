"""Adaptive multilevel splitting: unbiased, exact on averaged energies, and its paths."""

from dataclasses import replace
from functools import partial

import mpmath as mp
import numpy as np
import pytest
from averaged_splitting import bridge_maximum, rare_failure_of_process
from numba import njit
from scipy.stats import kstest
from scipy.stats import t as student
from sim_systems import exact, fig6, mixed

import sim.questions.splitting.run as splitting_run
from fpk import Contact, DampingTerm, System
from fpk.answer.names import REST, Start, parse_limit, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.linear import natural_modes
from sim.questions.averaged.square_root import SquareRootForm
from sim.questions.passing import cubic_of, first_passage
from sim.questions.rounds import on_shell
from sim.questions.splitting import RareFailure, Splitting, rare_failure
from sim.questions.splitting.kernel import LEVELS
from sim.questions.splitting.run import mean_and_error, split, system_problem
from sim.sample.workers import workers_of
from sim.step.random import GOLDEN, fill_normals, mixed_seed
from sim.step.schemes import exact_flow

QUICK = Splitting(replicas=64, killed=4, repetitions=8, threads=1)
DECAY, NOISE = 0.1, 0.05


def square_root(n: int = 1) -> SquareRootForm:
    """dH = (n D' − γ H) dt + √(2 D' H) dB."""
    return SquareRootForm(
        noise=np.array([n * NOISE]),
        slope=np.array([2.0 * NOISE]),
        damping=None,
        linear=np.array([DECAY]),
        energies=lambda X: X,
        scales=np.array([n * NOISE / DECAY]),
    )


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
            moves = k >= begin
            after = self.x[which, k] + new[:, k]
            self.x[which, k + 1] = np.where(moves, after, self.x[which, k + 1])

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
    wanted = exact_maximum(steps, up, high)
    stream = np.random.default_rng(1401)
    answers = [split(Walk(count, steps, up, stream), high, killed, stream) for _ in range(1000)]
    values = np.exp([log for log, _, _ in answers])
    error = values.std() / np.sqrt(values.size)
    assert abs(values.mean() - wanted) < 4.5 * error < 0.4 * wanted
    # Were only those counted that had to be killed, and not the ties:
    naive = np.array(
        [
            (1.0 - killed / count) ** n * (v > 0)
            for (_, n, _), v in zip(answers, values, strict=True)
        ]
    )
    assert naive.mean() > 5.0 * wanted


@pytest.mark.parametrize(("n", "limit", "start"), [(1, 6.845, 0.0), (1, 9.0, 1.0), (2, 9.0, 0.0)])
def test_one_averaged_energy_against_its_exact_probability(n, limit, start):
    """P of 1e-4 to 2e-6; 4 stated errors, each with 15 degrees of freedom or more: 1e-3."""
    wanted = exact_failure(limit, 60.0, start, n)
    settings = Splitting(replicas=128, killed=8, repetitions=16, threads=1, seed=2)
    found = rare_failure_of_process(square_root(n), limit, 60.0, start=start, settings=settings)
    assert 1e-7 < wanted < 1e-3
    assert abs(found.probability - wanted) < 4.0 * found.error < 2.0 * wanted
    assert found.log_probability == pytest.approx(np.log(found.probability))


def test_damping_that_depends_on_the_energy():
    """Damping split off the linear one and given as a table is the same equation."""
    form = square_root()
    other = replace(form, linear=np.array([0.04]), damping=lambda X: np.full(X.shape, DECAY - 0.04))
    wanted = exact_failure(6.845, 60.0)
    settings = Splitting(replicas=128, killed=8, repetitions=16, threads=1, seed=3)
    found = rare_failure_of_process(other, 6.845, 60.0, settings=settings)
    assert abs(found.probability - wanted) < 4.0 * found.error < 2.0 * wanted


@pytest.mark.slow
@pytest.mark.parametrize("limit", [6.845, 9.286, 11.685, 14.074, 16.443])
def test_scores_of_twenty_answers_are_uniform(limit):
    """P = 1e-4, 1e-6 .. 1e-12 in 100 time units: z by the sampling error, and by the stated one."""
    wanted = exact_failure(limit, 100.0)
    answers = [
        rare_failure_of_process(
            square_root(), limit, 100.0, settings=Splitting(replicas=256, killed=16, seed=seed)
        )
        for seed in range(20)
    ]
    z = np.array([(a.probability - wanted) / a.sampling_error for a in answers])
    assert kstest(student(15).cdf(z), "uniform").pvalue > 1e-3
    stated = np.array([(a.probability - wanted) / a.error for a in answers])
    assert np.mean(stated**2) < 1.0
    # The same answers do not belong to a limit that is 2 % higher.
    z = np.array([(a.probability / exact_failure(1.02 * limit, 100.0) - 1.0) for a in answers])
    assert z.mean() > 5.0 * z.std() / np.sqrt(20.0)


def twin(system, limit, time, steps, *, paths, seed):
    """Plain NumPy paths on the same stream: states before each kick, and x of the score."""
    n, h = system.n, time / steps
    A = exact_flow(system, h)
    L, names = A.matrix[:, 2 * n :], list(limit.values)
    pairs, c = (A.factor.shape[1] + 1) // 2, len(limit.values)
    shapes, omega = natural_modes(system)

    def contact(q):
        g, slope = np.zeros_like(q), np.zeros_like(q)
        for s in system.stops:
            o = np.maximum(s.sign * q[:, s.index] - s.clearance, 0.0)
            g[:, s.index] += s.sign * s.force(o)
            slope[:, s.index] += np.where(o > 0.0, s.slope(np.where(o > 0.0, o, 1.0)), 0.0)
        return g, slope, h * h / (12.0 * system.mass)

    def observed(x):
        g, slope, a = contact(x[:, :n])
        p = (x[:, n:] - 0.5 * h * g * (1.0 - a * slope)) * (1.0 + a * slope)
        return x[:, :n] - a * g, p + (a * g) @ system.damping.T

    def reached(x):
        """√(E_i/E_f) of a displacement, from all modes, for what has not passed the limit."""
        (q, p), i, end = observed(x), int(names[0][1:]) - 1, limit.value
        size = np.hypot((q * system.mass) @ shapes, p @ shapes / omega) @ np.abs(shapes[i])
        E, E_f = (
            0.5 * s * s / system.compliance[i, i] + system.contact_energy(i, at)
            for s, at in ((size, q[:, i]), (np.full(2, end), np.array([end, -end])))
        )
        return np.minimum(np.sqrt(E / E_f.min()), 1.0 - 2.0**-53)[:, None]

    def seen(x):
        q, p = observed(x)
        if limit.kind == "q":
            i = int(names[0][1:]) - 1
            return q[:, [i]], p[:, [i]] / system.mass[i]
        N = system.noise_matrix
        if limit.kind == "H":
            u = p / system.mass @ N
            value, noise = system.hamiltonian(q, p)[:, None], 2.0 * (p / system.mass * u).sum(1)
            # The noise makes β of σ² as it adds 1 to H; at rest the means of both count.
            m_inverse = np.diag(1.0 / system.mass)
            F, G = m_inverse @ N @ m_inverse, m_inverse @ N @ m_inverse @ N @ m_inverse
            beta = np.full(len(p), 4.0 * np.trace(G) / np.trace(F))
            moves = noise > 0.0
            beta[moves] = (8.0 * (u * u / system.mass).sum(1))[moves] / noise[moves]
            return value, (noise[:, None], beta[:, None])
        modes = [int(name[1:]) - 1 for name in names]
        Q, P = (q * system.mass) @ shapes * omega, p @ shapes
        noise = np.diag(shapes.T @ N @ shapes)
        energies, beta = 0.5 * (Q * Q + P * P), np.broadcast_to(4.0 * noise, P.shape)
        return energies[:, modes], ((2.0 * noise * P * P)[:, modes], beta[:, modes])

    x = np.zeros((paths, 2 * n))
    states, shares = [x], []
    value, spread = seen(x)
    for k in range(steps):
        g, slope, a = contact(x[:, :n])
        x = x.copy()
        x[:, n:] -= h * g * (1.0 - a * slope)
        z = np.array(
            [called_normals(place_of(seed, j, k * (pairs + c)), pairs) for j in range(paths)]
        ).T
        x = x @ A.propagator.T + (L[:, : 2 * pairs] @ z[: L.shape[1]]).T
        before, rate = value, spread
        value, spread = seen(x)
        states.append(x)
        most = np.empty_like(value)
        for m in range(c):
            for j in range(paths):
                if limit.kind == "q":
                    t = np.linspace(0.0, 1.0, 4001)
                    q = (
                        (1 + 2 * t) * (1 - t) ** 2 * before[j, 0] + t**2 * (3 - 2 * t) * value[j, 0]
                        + h * (t * (1 - t) ** 2 * rate[j, 0] - t**2 * (1 - t) * spread[j, 0])
                    )  # fmt: skip
                    most[j, m] = np.abs(q).max()
                    continue
                word = place_of(seed, j, k * (pairs + c) + pairs + m)
                ends = []
                for H, (s2, beta) in ((before, rate), (value, spread)):
                    e, end = s2[j, m] / beta[j, m], limit.values[names[m]]
                    way = np.sqrt(max(e + end - H[j, m], 0.0)) - np.sqrt(e)
                    ends.append(2.0 * way / np.sqrt(beta[j, m]))
                # Where a bridge to that side of the limit would be, the path has passed it.
                passed = called_bridge(-ends[0], -ends[1], h, word) >= 0.0
                most[j, m] = end if passed else value[j, m]
        share = most / np.array(list(limit.values.values()))
        inside = reached(x) if limit.kind == "q" else np.sqrt(np.maximum(share, 0.0))
        shares.append(np.where(share >= 1.0, 1.0, inside))
    return np.array(states), np.array(shares)


def place_of(seed, trajectory, counter):
    word = ((trajectory << 40) + counter) * int(GOLDEN) + int(mixed_seed(seed))
    return np.uint64(word % 2**64)


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
    return first_passage(cubic_of(q0, v0, q1, v1, h), limit)


TWINS = [
    (fig6, "H=0.6"),
    pytest.param(fig6, "q2=0.9", marks=pytest.mark.slow),
    pytest.param(mixed, "H1=0.3,H3=0.4", marks=pytest.mark.slow),
    pytest.param(mixed, "H=0.6", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("system", "limit"), TWINS)
def test_paths_are_those_of_plain_numpy(system, limit):
    """States to 1e-9 in 60 steps, maxima to 2e-7 (cubic: by 4001 points) hence at most a level."""
    system = system()
    limit = parse_limit(limit, system.n)
    problem = system_problem(system, limit, REST, 12.0, dt=None, score=None)
    paths, steps, seed = 12, 60, 5
    replicas = problem.replicas(paths, steps, seed, np.random.default_rng(0))
    states, shares = twin(system, limit, 12.0, steps, paths=paths, seed=seed)
    rows, columns = (size - 1 for size in replicas.model[-2].shape[1:])
    written = 1 + np.argmax(replicas.paths.level == replicas.best[:, None], axis=1)
    records = 0
    for i in range(paths):
        top, m = replicas.paths.level[i, 0], 1
        for k in range(1, steps + 1):
            left = rows * np.sqrt(1.0 - k / steps)
            levels = []
            for c, table in enumerate(replicas.model[-2]):
                x = shares[k - 1, i, c] * columns
                j, r = min(int(x), columns - 1), min(int(left), rows - 1)
                a, b = x - j, left - r
                low, high = (t[j] + a * (t[j + 1] - t[j]) for t in table[r : r + 2])
                inside = min(low + b * (high - low), LEVELS - 1)
                levels.append(LEVELS if x >= columns else inside)
            rose = m < written[i] and replicas.paths.step[i, m] == k
            if abs(max(levels) - top - 1.0) > 1e-3:  # else rounding decides
                assert rose == (max(levels) > top + 1.0)
            if rose:
                assert abs(replicas.paths.level[i, m] - max(levels)) < 1.0 + 1e-3
                np.testing.assert_allclose(
                    replicas.paths.state[i, m], states[k, i], rtol=0.0, atol=1e-9
                )
                top, m, records = replicas.paths.level[i, m], m + 1, records + 1
            if top == LEVELS:
                break
        assert replicas.best[i] == top
    assert records > 3 * paths


def test_largest_values_between_steps():
    """The cubic against its own points; the bridge against P(max > m) = exp(−2 (m−a)(m−b)/V)."""
    stream = np.random.default_rng(7)
    t = np.linspace(0.0, 1.0, 2001)
    for q0, v0, q1, v1 in stream.standard_normal((200, 4)):
        h = 0.7
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
    top = np.array([called_bridge(a, b, variance, place_of(3, 1, k)) for k in range(20_000)])
    assert top.min() >= b
    assert kstest(np.exp(-2.0 * (top - a) * (top - b) / variance), "uniform").pvalue > 1e-4


def test_an_answer_depends_on_the_seed_alone():
    one = rare_failure(fig6(), parse_limit("H=2", 2), REST, 20.0, settings=QUICK)
    two = rare_failure(
        fig6(), parse_limit("H=2", 2), REST, 20.0, settings=replace(QUICK, threads=2)
    )
    other = rare_failure(fig6(), parse_limit("H=2", 2), REST, 20.0, settings=replace(QUICK, seed=2))
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
    loose = run(settings=replace(QUICK, tol=10.0))
    tight = run(settings=replace(QUICK, tol=0.1))
    assert loose.values.size == 8 < tight.values.size
    assert tight.relative_error <= 0.1
    np.testing.assert_array_equal(tight.values[:8], loose.values)


def test_a_limit_that_nobody_reaches_has_a_bound():
    """1e300 times kT: every estimate is 0; 1024 paths without a failure bound P at 95 %."""
    found = rare_failure_of_process(
        square_root(), 1e300, 1.0, settings=replace(QUICK, replicas=128, killed=127)
    )
    assert found.probability == 0.0 and found.extinct == 8
    assert found.error == found.upper_bound == pytest.approx(3.0 / 1024, rel=0.01)
    assert found.log_probability == -np.inf and found.relative_error == np.inf


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


def test_certain_failure_is_one():
    found = rare_failure_of_process(square_root(), 1e-6, 50.0, settings=QUICK)
    assert found.probability == 1.0 and found.levels == 0.0
    # No path has lived: the error is that of one, and as much for what the step may do to it.
    paths = QUICK.replicas * found.values.size
    assert found.error == pytest.approx(np.sqrt(2.0) / paths)


@pytest.mark.parametrize(
    ("key", "value"),
    [("replicas", 1), ("killed", 512), ("killed", 0), ("repetitions", 3), ("dt", 0.0),
     ("tol", -1.0), ("seconds", np.inf), ("seed", -1), ("threads", 0)],
)  # fmt: skip
def test_settings_that_cannot_be_used(key, value):
    with pytest.raises(InvalidInput, match=key):
        Splitting(**{key: value})


def test_questions_that_cannot_be_asked():
    system, limit = fig6(), parse_limit("H=1", 2)
    for start in ("H=1", "q1=2", "H1=0.5,H2=0.6"):
        with pytest.raises(InvalidInput, match="start"):
            rare_failure(system, limit, parse_start(start, system), 1.0)
    with pytest.raises(InvalidInput, match="start"):
        rare_failure(system, parse_limit("q1=0.5", 2), parse_start("q1=-0.5", system), 1.0)
    for time in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InvalidInput, match="time"):
            rare_failure(system, limit, REST, time)
    with pytest.raises(InvalidInput, match="start"):
        rare_failure_of_process(square_root(), 1.0, 1.0, start=1.0)
    with pytest.raises(InvalidInput, match="dt"):
        rare_failure(system, limit, REST, 1e9, settings=Splitting(dt=1e-3))
    with pytest.raises(InvalidInput, match="score"):
        two = parse_limit("H1=1.3,H2=1.3", 2)
        rare_failure(system, two, REST, 1.0, score=lambda H, t: np.outer(t, H))
    silent = System(mass=[1.0], stiffness=[1.0], damping=[0.1], noise_intensity=[0.0])
    with pytest.raises(NotApplicable, match="noise"):
        rare_failure(silent, parse_limit("H=1", 1), REST, 1.0)
    odd = replace(square_root(), noise=np.array([0.4 * NOISE]))
    with pytest.raises(NotApplicable, match="degrees of freedom"):
        rare_failure_of_process(odd, 1.0, 1.0)


def test_starts_on_a_shell():
    """Mean of V and of H over the shell of a contact system against quadrature; |z| < 4.5."""
    stops = Contact(1, "right", 4.0, 0.3), Contact(1, "left", 2.0, 0.1)
    one = System(mass=[2.0], stiffness=[1.5], damping=[0.1], noise_intensity=[0.1], contacts=stops)
    for system, H in ((one, 0.8), (fig6(), 1.2), (mixed(), 0.7)):
        n = system.n
        q, p = on_shell(system, H, 20_000, np.random.default_rng(11))
        np.testing.assert_allclose(system.hamiltonian(q, p), H, rtol=1e-9)
        # Of uniform points of the shell E[p_i²/m_i] is the same for all i, and E q_i ∂V/∂q_i, too.
        force = q @ system.stiffness_matrix
        for s in system.stops:
            overlap = np.maximum(s.sign * q[:, s.index] - s.clearance, 0.0)
            force[:, s.index] += s.sign * s.force(overlap)
        for i in range(n):
            difference = p[:, i] ** 2 / system.mass[i] - q[:, i] * force[:, i]
            z = difference.mean() / (difference.std() / np.sqrt(len(q)))
            assert abs(z) < 4.5
            assert abs(p[:, i].mean()) < 4.5 * p[:, i].std() / np.sqrt(len(q))


def direct(system, limit, time, *, dt, paths, seed, start=None):
    """P(H >= limit before time) by paths that are looked at with a Brownian bridge between steps.

    Straight Strang steps with the plain force: other steps, stream and energies than the kernel's.
    """
    n, stream, steps = system.n, np.random.default_rng(seed), round(time / dt)
    flow = exact_flow(system, dt)
    x = np.zeros((paths, 2 * n)) if start is None else start
    failed, stop = np.zeros(paths, dtype=bool), system.stops

    def kick(x):
        for s in stop:
            o = np.maximum(s.sign * x[:, s.index] - s.clearance, 0.0)
            x[:, n + s.index] -= 0.5 * dt * s.sign * s.force(o)

    def energy(x):
        v = x[:, n:] / system.mass
        noise = 2.0 * np.einsum("ki,ij,kj->k", v, system.noise_matrix, v)
        return system.hamiltonian(x[:, :n], x[:, n:]), noise

    H, noise = energy(x)
    for _ in range(steps):
        kick(x)
        x = (
            x @ flow.propagator.T
            + stream.standard_normal((paths, flow.factor.shape[1])) @ flow.factor.T
        )
        kick(x)
        H0, noise0 = H, noise
        H, noise = energy(x)
        u = np.log(stream.random(paths)) * dt * (noise + noise0)
        failed |= 0.5 * (H + H0 + np.sqrt((H - H0) ** 2 - u)) >= limit
    return failed.mean(), np.sqrt(failed.mean() * (1.0 - failed.mean()) / paths)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "limit", "time"), [(fig6, 2.5, 40.0), (exact, 3.5, 12.0), (mixed, 3.0, 20.0)]
)
def test_the_full_system_against_plain_sampling(system, limit, time):
    """Of 1e-2 to 1e-3, 4.5 standard errors of the difference."""
    system = system()
    plain, error = direct(system, limit, time, dt=0.02, paths=40_000, seed=1401)
    asked = parse_limit(f"H={limit}", system.n)
    found = rare_failure(system, asked, REST, time, settings=Splitting(seed=3))
    assert 5e-4 < plain < 5e-2
    assert abs(found.probability - plain) < 4.5 * np.hypot(error, found.error)
    assert found.relative_error < 0.2


@pytest.mark.slow
def test_other_starts_limits_and_damping_terms():
    """Every kind of start and limit, and damping terms: splitting against paths without it."""
    terms = (DampingTerm(1, 1, 0.05, q=((1, 2),)), DampingTerm(2, 1, 0.02, energy=1))
    damped = replace_system(fig6(), damping_terms=terms)
    for system, limit, start in (
        (damped, "H=1.5", "H=0.3"),
        (fig6(), "q2=1.05", "noise=0.5"),
        (fig6(), "H1=1.3,H2=1.3", "H1=0.1,H2=0.2"),
        (mixed(), "q3=0.8", "rest"),
    ):
        asked = parse_limit(limit, system.n)
        begun = parse_start(start, system)
        rare = rare_failure(system, asked, begun, 20.0, settings=Splitting(seed=5))
        plain = plain_failure(system, asked, begun, 20.0, paths=40_000)
        error = np.hypot(rare.error, np.sqrt(plain / 40_000))
        assert 1e-3 < plain < 0.1
        assert abs(rare.probability - plain) < 4.5 * error, (limit, start)


def replace_system(system: System, **changes) -> System:
    names = ("mass", "stiffness", "damping", "noise_intensity", "contacts", "damping_terms")
    return System(**{name: getattr(system, name) for name in names} | changes)


def plain_failure(system, limit, start: Start, time: float, *, paths: int) -> float:
    problem = system_problem(system, limit, start, time, dt=None, score=None)
    steps = 2 * splitting_run.step_count(problem)
    failed = 0
    for k in range(paths // 4000):
        replicas = problem.replicas(4000, steps, 900 + k, np.random.default_rng([9, k]))
        failed += int(np.sum(replicas.best == LEVELS))
    return failed / (4000 * (paths // 4000))


@pytest.mark.slow
def test_a_cluster_gives_the_same():
    distributed = pytest.importorskip("distributed")
    run = partial(rare_failure, fig6(), parse_limit("H=2", 2), REST, 20.0)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as local:
        there = run(settings=replace(QUICK, cluster=local.scheduler_address))
    here: RareFailure = run(settings=QUICK)
    np.testing.assert_array_equal(here.values, there.values)
    with workers_of(None, 1) as workers:
        assert workers.threads == 1


def test_the_score_of_an_energy_does_not_jump_at_the_turns_of_a_motion():
    """P is nearly (1 − K/N) to the number of levels if every level kills the K that it must alone.

    With an energy that seemed nearer to its limit where little moves, there were half as many.
    """
    rare = Splitting(replicas=128, killed=8, repetitions=8, threads=1, seed=3)
    answer = rare_failure(fig6(), parse_limit("H=4", 2), REST, 20.0, settings=rare)
    needed = answer.log_probability / np.log1p(-8 / 128)
    assert answer.levels > 0.85 * needed
