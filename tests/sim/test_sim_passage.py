"""First passage of the full system: exact judges, the order in dt, beside a look at the steps."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest
from sim_systems import estimated, exact, fig6, linear

from fpk.answer.dynamics import Passage
from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_limit, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.limits import energies_of
from sim.questions.passage import estimates, tail_begin
from sim.questions.passing import reader_of
from sim.questions.rounds import on_shell
from sim.sample.ensemble import ensemble_from
from sim.step.arrays import LANES, in_blocks, in_rows

CIR_RATE = 0.13742123052434
"""Failure rate of dH = (kT − H) dt + √(2 kT H) dB at 3 kT: 1F1(−λ; 1; 3) = 0, per decay time."""
PATHS = 64 * LANES
"""Trajectories by which ways to see a passage are compared: a share has the error 0.0055."""
CIR_MEAN = 8.25803
"""Its mean time from 0: Ei(3) − ln 3 − γ."""


def oscillator(damping: float = 0.05, kT: float = 0.5) -> System:
    return System([1.0], [1.0], [damping], [damping * kT])


def passed(
    system: System, limit: str, start: str = "rest", times: Any = (), **settings: Any
) -> Passage:
    return MonteCarlo(**({"threads": 1, "paths": 4096} | settings)).passage(
        system,
        parse_limit(limit, system.n),
        parse_start(start, system),
        np.array(times, dtype=float),
        tol=None,
        progress=silent,
    )


def test_energy_of_a_lightly_damped_oscillator_is_the_square_root_process() -> None:
    # What averaging leaves out is below 1 % at this damping (0.3 % at 0.02, of 32768 paths); four
    # standard errors beside that: a chance of 1e-4 in three numbers.
    answer = passed(oscillator(), "H=1.5", times=[1.0, 40.0, 165.0])
    assert answer.certificate.certified and answer.error_kind == "sampling"
    for number, expected in ((answer.mean, CIR_MEAN / 0.05), (answer.rate, 0.05 * CIR_RATE)):
        assert number is not None
        assert abs(number.value - expected) < 4.0 * number.error + 0.01 * expected
        assert number.error < 0.05 * expected
    assert np.all(np.diff(answer.survival) < 0.0)


def look_at_the_steps(trace: Any, samples: int, done: int, time: Any, chance: Any, *, dt: float,
                      row: int, limit: float) -> None:  # fmt: skip
    """The naive reader: a limit is passed when a sample lies beyond it."""
    for k in range(1, samples + 1):
        beyond = (np.abs(trace[:, k, row]) >= limit) & np.isinf(time[:, 0])
        time[:, 0][beyond] = (done + k) * dt


def share_failed(system: System, limit: str, dts: Any, until: float, q0: float) -> Any:
    """By a time the share that failed, (dts, 2): seen between the steps, and at the steps only.

    All by the same random numbers: a step of 2 dt is two of dt.
    """
    asked, paths = parse_limit(limit, system.n), PATHS
    energies = energies_of(asked, system.n)
    row = 2 * system.n if energies else 0
    q = np.full((paths, system.n), q0)
    chance = np.random.default_rng(5).exponential(size=(paths, 1))
    shares = []
    for dt in dts:
        right = reader_of(system, asked, dt)
        naive = partial(look_at_the_steps, dt=dt, row=row, limit=asked.value)
        times = []
        for read in (right, naive):
            motion = ensemble_from(system, q, 0.0 * q, dt, 3, energies=energies)
            time = in_blocks(np.full((paths, 1), np.inf))
            motion.advance(round(until / dt), time, in_blocks(chance), read=read)
            times.append(in_rows(time)[:, 0])
        shares.append([np.mean(t <= until) for t in times])
    return np.array(shares)


def test_a_look_at_the_steps_is_late_by_the_root_of_the_step_and_the_bridge_is_not() -> None:
    # From 0.87 of the limit for two periods: about half fail. The naive loss falls as √dt, by 2 to
    # dt/4; its chance is that of a difference of 0.03 at the least, 4 √2 errors or more. The
    # answers of the bridge at all steps differ by less than that.
    period = 2.0 * np.pi
    dts = period / np.array([16, 64, 256])
    shares = share_failed(oscillator(0.02), "H=1.5", dts, 2.0 * period, np.sqrt(2.6))
    error = np.sqrt(0.25 / PATHS)
    assert np.ptp(shares[:, 0]) < 4.0 * np.sqrt(2.0) * error
    lost = shares[-1, 0] - shares[:, 1]
    assert np.all(lost > 4.0 * error)
    assert np.all((lost[:-1] / lost[1:] > 1.6) & (lost[:-1] / lost[1:] < 2.5))


def test_a_displacement_is_seen_between_the_steps() -> None:
    # At 7.3 steps a period the steps miss the top of a cosine by up to 1 − cos(π/7.3) = 9 %.
    dts = 0.86 * np.array([1.0, 0.125])
    shares = share_failed(oscillator(0.02), "q1=1.6", dts, 12 * 0.86, 1.55)
    error = np.sqrt(0.25 / PATHS)
    assert abs(shares[0, 0] - shares[1, 0]) < 4.0 * np.sqrt(2.0) * error
    assert shares[1, 0] - shares[0, 1] > 8.0 * error


def test_without_noise_the_time_of_a_passage_is_that_of_the_cosine() -> None:
    # q = −cos t: 0.999 is passed at π − arccos 0.999, |cubic − cosine| < (ωh)^4/384 = 3e-6 here:
    # 7e-5 of time where the velocity is √(1 − 0.999²) = 0.045.
    system = System([1.0], [1.0], [0.0], [1e-24])
    limit, dt = parse_limit("q1=0.999", 1), 0.18
    q = np.full((LANES, 1), 0.5)
    p = np.full((LANES, 1), np.sqrt(0.75))
    time = in_blocks(np.full((LANES, 1), np.inf))
    motion = ensemble_from(system, q, p, dt, 1)
    motion.advance(12, time, time, read=reader_of(system, limit, dt))
    expected = np.arccos(0.5) - np.arccos(0.999)
    assert time == pytest.approx(expected, abs=7e-5)


def test_either_of_two_modes_survives_as_the_product() -> None:
    # Damping a M: modes do not couple, and equal noise by mass makes them independent.
    system = System([1.0, 1.0], [1.0, 1.0], [0.06, 0.06], [0.03, 0.03])
    times = [10.0, 30.0, 60.0]
    both = passed(system, "H1=1.2,H2=0.9", times=times)
    first = passed(system, "H1=1.2", times=times, seed=2)
    second = passed(system, "H2=0.9", times=times, seed=3)
    product = first.survival * second.survival
    error = np.hypot(first.survival_error, np.hypot(second.survival_error, both.survival_error))
    assert np.all(np.abs(both.survival - product) < 4.0 * error)
    assert np.all(both.survival < first.survival - 4.0 * error)


def test_a_shell_of_energy_stays_as_it_is_without_noise_and_damping() -> None:
    # Liouville: the density δ(H − E) is invariant. Two samples that are independent but for the
    # flow; 1e-4 each that they are called different.
    system = System(
        [1.0], [1.0], [0.0], [1e-24], contacts=(Contact(1, "right", 40.0, 0.2),)
    )  # fmt: skip
    stream = np.random.default_rng(3)
    q, p = on_shell(system, 0.5, 32 * LANES, stream)
    assert system.hamiltonian(q, p) == pytest.approx(0.5, rel=1e-12)
    motion = ensemble_from(system, *on_shell(system, 0.5, 32 * LANES, stream), dt=0.02, seed=1)
    motion.advance(3)
    for _ in range(2):
        motion.advance(57)
        after = in_rows(motion.last)
        assert kstest(after[:, 0], q[:, 0]).pvalue > 1e-4
        assert kstest(after[:, 1], p[:, 0]).pvalue > 1e-4


def test_from_the_stationary_state_the_share_beyond_the_limit_has_failed_at_once() -> None:
    # The share of the stationary ensemble, whose own error is less than 1 %.
    system = exact()
    answer = passed(system, "H=1.2", "noise=1", times=[0.0, 1.0])
    within = MonteCarlo(paths=4096, threads=1, time=60.0).solve(system, [(Coordinate("H"),)])
    (density,) = within.densities
    edges = density.panels[0]
    share = float(np.sum(density.values * np.diff(edges) * (edges[1:] <= 1.2)))
    assert abs(answer.survival[0] - share) < 4.0 * answer.survival_error[0] + 0.01
    assert answer.survival[1] < answer.survival[0]


def alike(a: Passage, b: Passage) -> bool:
    """Whether the means differ by no more than four standard errors of the difference."""
    return abs(a.mean.value - b.mean.value) < 4.0 * float(np.hypot(a.mean.error, b.mean.error))


def test_the_unit_of_energy_changes_nothing() -> None:
    # From a displacement without momentum: σ and what the noise makes of it vanish there.
    def system(unit: float) -> System:
        noise = [0.01 * unit**2, 0.02 * unit**2]
        return System([unit, unit], [unit, unit], [0.08 * unit, 0.04 * unit], noise)

    for limit in ("H={0!r}", "H1={0!r},H2={0!r}"):
        one, small = (
            passed(system(unit), limit.format(0.4 * unit), "q2=0.5", seed=seed)
            for unit, seed in ((1.0, 2), (1e-9, 3))
        )
        assert alike(one, small)


def test_an_energy_without_noise_passes_where_it_is_driven_and_only_there() -> None:
    # The noise drives the first mode alone: T2 N T2 = 0. Damping a M does not couple them.
    K = np.array([[2.0, -1.0], [-1.0, 1.0]])
    first = np.linalg.eigh(K)[1][:, :1]
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05], noise_gain=first)
    answer = passed(system, "H2=1e-6", times=[20.0], time=30.0)
    assert answer.survival[0] == 1.0 and not answer.certificate.certified
    assert alike(passed(system, "H1=0.4,H2=1e-6"), passed(system, "H1=0.4", seed=2))


def test_seconds_end_it_in_time_and_without_bias() -> None:
    whole = passed(oscillator(), "H=1.5")
    short = passed(oscillator(), "H=1.5", seconds=0.3, dt=0.1, seed=5)
    assert int(short.settings["not failed"]) > 0 and alike(whole, short)


def test_damping_that_depends_on_the_state_is_stepped() -> None:
    # A limit cycle of |q| = 2: the limit beyond it is passed by noise, that below it by the growth.
    term = DampingTerm(1, 1, 0.2, q=((1, 2),))
    system = System([1.0], [1.0], [-0.2], [0.005], damping_terms=(term,))
    below = passed(system, "q1=1.8", "q1=1", times=[60.0])
    assert below.survival[0] < 0.01 and below.mean.value < 20.0
    one, half = (passed(system, "H=2.6", "q1=1", dt=dt, seed=k) for k, dt in ((1, 0.1), (2, 0.03)))
    assert alike(one, half)


def test_the_same_for_any_threads_and_another_seed_is_another_answer() -> None:
    asked: Any = {"limit": "q2=0.8", "start": "H=0.2", "times": [20.0]}
    one, two = (passed(fig6(), threads=k, **asked) for k in (1, 2))
    assert (one.mean, one.rate) == (two.mean, two.rate)
    np.testing.assert_array_equal(one.survival, two.survival)
    other = passed(fig6(), seed=2, **asked)
    assert other.mean != one.mean
    assert abs(other.mean.value - one.mean.value) < 4.0 * np.hypot(other.mean.error, one.mean.error)


def test_with_contact_the_difference_of_the_steps_is_in_the_error() -> None:
    answer = passed(fig6(), "H=0.8", "H1=0.1,H2=0.2", times=[50.0])
    bias = answer.settings["step bias of the mean"]
    assert isinstance(bias, float) and answer.mean.error >= bias
    longer = passed(fig6(), "H=0.8", "H1=0.1,H2=0.2", times=[50.0], dt=0.02, seed=9)
    error = np.hypot(answer.mean.error, longer.mean.error)
    assert abs(answer.mean.value - longer.mean.value) < 4.0 * error


def test_trajectories_that_end_first_are_continued_by_the_tail_and_it_is_said() -> None:
    whole = passed(oscillator(), "H=1.5", times=[300.0])
    cut = passed(oscillator(), "H=1.5", times=[300.0], time=150.0, seed=4)
    assert cut.settings["not failed"] > 1000 and "continued" in cut.settings
    assert cut.certificate.certified
    for a, b in ((whole.mean, cut.mean), (whole.variance, cut.variance), (whole.rate, cut.rate)):
        assert a is not None and b is not None
        assert abs(a.value - b.value) < 4.0 * np.hypot(a.error, b.error)
    assert abs(whole.survival[0] - cut.survival[0]) < 4.0 * cut.survival_error[0] + 0.02


def test_a_limit_that_nobody_reaches_is_not_certified_and_the_rate_is_bounded() -> None:
    answer = passed(oscillator(), "H=60", times=[10.0], time=20.0)
    assert not answer.certificate.certified
    (words,) = answer.certificate.failures
    assert "passed the limit by t = 20" in words and "95 %" in words
    assert answer.rate is not None and answer.rate.value == 0.0
    assert answer.rate.error == pytest.approx(3.0 / (4096 * 20.0), rel=0.05)
    assert answer.mean.error == np.inf and answer.survival[0] == 1.0
    assert answer.survival_error[0] == pytest.approx(1.0 / 4096)
    # Without a time, an eighth of it is enough to see that, or the last time that is asked for.
    short, long = (
        passed(oscillator(), "H=60", times=times, most_steps=30000) for times in ([10.0], [900.0])
    )
    (end, asked), step = (a.settings["followed until"] for a in (short, long)), 256.0
    assert end <= (10000.0 / 8.0 + step) * short.settings["coarse dt"] and asked >= 900.0


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("beyond the limit", {"start": "H=2"}),
        ("beyond the limit", {"start": "q1=2", "limit": "q1=2"}),
        ("ascend", {"times": [2.0, 1.0]}),
        ("ascend", {"times": [-1.0, 1.0]}),
        ("exact_flow", {"scheme": "baoab"}),
        ("stability limit", {"dt": 3.0, "system": fig6()}),
    ],
)
def test_bad_input_is_one_line(words: str, change: dict[str, Any]) -> None:
    asked: Any = {"system": oscillator(), "limit": "H=1.5"} | change
    with pytest.raises(InvalidInput, match=words) as error:
        passed(**asked)
    assert "\n" not in str(error.value)


def test_an_overdamped_velocity_is_followed_and_too_long_a_step_is_not_certified() -> None:
    system = oscillator(20.0)
    chosen, finer = (passed(system, "H=1.5", dt=dt, seed=k) for k, dt in ((1, None), (2, 0.003)))
    assert alike(chosen, finer) and chosen.certificate.certified
    coarse = passed(system, "H=1.5", dt=0.3)
    assert any("not all is seen" in words for words in coarse.certificate.failures)


def test_no_noise_is_refused_and_the_method_has_the_protocol() -> None:
    with pytest.raises(NotApplicable, match="no noise"):
        passed(System([1.0], [1.0], [0.1], [0.0]), "H=1")
    assert linear(1).n == 1


def test_errors_of_exponential_times_hold_with_and_without_an_end() -> None:
    # z of 60 repetitions: their mean square is χ²/60, within 1 ± 4 √(2/60) = 1 ± 0.73; that of the
    # variance has heavier tails.
    stream, times = np.random.default_rng(8), np.array([1.0, 3.0])
    for end in (np.inf, 2.0):
        z = []
        for _ in range(60):
            time = stream.exponential(size=1024)
            until = np.full(1024, end if end < np.inf else 1e9)
            failed = np.where(time > until, np.inf, time)
            answer = estimated(failed, failed, until, times, tol=1.0)
            assert answer.rate is not None
            z.append([
                (answer.mean.value - 1.0) / answer.mean.error,
                (answer.rate.value - 1.0) / answer.rate.error,
                *(answer.survival - np.exp(-times)) / answer.survival_error,
                (answer.variance.value - 1.0) / answer.variance.error,
            ])  # fmt: skip
        square = np.mean(np.square(z), axis=0)
        assert np.all(square < [1.73, 1.73, 1.73, 1.73, 2.5])
        assert np.all(square > 0.27)


def test_the_tail_begins_after_what_the_start_has_left() -> None:
    # T = T1 + T2 with rates 1 and 4: the hazard rises to 1 as 1 − 4/3 e^(−3t)…: 1 % off at t = 1.6.
    stream = np.random.default_rng(9)
    time = stream.exponential(size=200_000) + stream.exponential(0.25, size=200_000)
    until = np.full(time.size, np.inf)
    begin = tail_begin(time, until, 0.5)
    assert begin > 1.0
    rate = estimates(time, until, np.zeros(0), begin)[2]
    late = np.count_nonzero(time > begin)
    assert abs(rate - 1.0) < 4.0 / np.sqrt(late)
    assert abs(estimates(time, until, np.zeros(0), 0.0)[2] - 1.0) > 0.1


def test_a_limit_that_is_passed_soon_is_passed_in_many_steps() -> None:
    # H rises as D t/m at first: the mean time is L m/D.
    for limit in (1e-6, 1e-60):
        answer = passed(oscillator(), f"H={limit!r}", paths=PATHS)
        assert answer.certificate.certified
        assert (
            abs(answer.mean.value - limit / 0.025) < 4.0 * answer.mean.error < 0.1 * limit / 0.025
        )


def test_failures_within_few_steps_are_not_certified() -> None:
    fine = np.linspace(0.01, 0.2, 1000)
    sampled = fine, fine, np.full(1000, 10.0)
    answer = estimated(*sampled, step=0.1, memory=1.0)
    assert any("too few to see how; use dt" in text for text in answer.certificate.failures)
    assert answer.mean.error == answer.variance.error == np.inf
    assert estimated(*sampled, step=0.02, memory=1.0).certificate.certified


def test_starts_that_are_all_beyond_the_limit_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"limit = .*begin beyond"):
        estimated(np.zeros(9), np.zeros(9), np.ones(9), step=0.1, memory=1.0)


@pytest.mark.parametrize(("events", "bound"), [(0, 2.9957), (1, 4.7439), (10, 16.9622)])
def test_the_bound_of_a_rate_is_that_of_poisson(events: int, bound: float) -> None:
    # Garwood: half the 95 % quantile of χ² with 2 (events + 1) degrees of freedom, by tables.
    time = np.where(np.arange(4096) < events, 1.0, np.inf)
    answer = estimated(time, time, np.full(4096, 10.0))
    (words,) = answer.certificate.failures
    assert f" is {bound / (40960.0 - 9.0 * events):.2g} at most (95 %)" in words
