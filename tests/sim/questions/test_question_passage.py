"""First passage of the full system: exact judges, the order in dt, steps, estimates, refusals."""

from dataclasses import replace
from functools import partial
from math import inf, sqrt
from typing import Any

import numpy as np
import pytest
from asked import assert_refused
from sim_systems import (
    CIR_MEAN,
    CIR_RATE,
    estimated,
    exact,
    exact_density,
    fig6,
    limit_cycle,
    oscillator,
    passed,
    slow,
    slow_clock,
    transient,
)

from averaging.phase_space.method import PhaseSpace
from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import Passage
from fpk.answer.names import REST, Limit, Start, parse_limit
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.contact import Contact
from fpk.system.linear import diffusion_matrix, drift_matrix, flow_covariance
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.limits import STEPS_SINCE_START, stages
from sim.questions.passage import estimates, tail_begin
from sim.questions.passing import reader_of
from sim.questions.rounds import Watch
from sim.questions.splitting.run import Splitting, rare_failure
from sim.sample.ensemble import ensemble_from
from sim.step.arrays import LANES, in_blocks

LOOSE = System([1.0], [1e-4], [1e-4], [0.5])
"""A mass whose own period is 628: noise alone moves it by 0.6 in the time 1."""
PASSES = 0.3879686
"""P(|q| = 0.5 is passed by t = 1) of ``LOOSE`` from rest, by the equation in phase space, 3e-7."""
EXITS = 0.6292312
"""P(|W| = 1 is passed by t = 1) of Brownian motion: 1 − (4/π) Σ (−1)^j e^(−(2j+1)² π²/8)/(2j+1)."""
SIGMAS = 5.0
"""Stated errors by which an answer may be off: a chance of 6e-7."""


def alike(a: Number, b: Number) -> bool:
    """Whether they differ by no more than four standard errors of the difference."""
    return abs(a.value - b.value) < 4.0 * float(np.hypot(a.error, b.error))


def off(answer: Any, reference: Any) -> float:
    """The largest distance of (values, errors) from a reference, in units of both errors."""
    value, error, right, own = (np.asarray(x, dtype=float) for x in (*answer, *reference))
    both = np.hypot(error, own)
    return float(np.max(np.abs(value - right) / np.where(both > 0.0, both, 1e-300)))


def test_energy_of_a_lightly_damped_oscillator_is_the_square_root_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # What averaging leaves out is below 1 % at this damping (0.3 % at 0.02, of 32768 paths); four
    # standard errors beside that: a chance of 1e-4 in three numbers.
    whole = passed(oscillator(), "H=1.5", times=[1.0, 40.0, 165.0, 300.0])
    assert whole.certificate.certified and whole.error_kind == "sampling"
    for number, expected in ((whole.mean, CIR_MEAN / 0.05), (whole.rate, 0.05 * CIR_RATE)):
        assert abs(number.value - expected) < 4.0 * number.error + 0.01 * expected
        assert number.error < 0.05 * expected
    assert np.all(np.diff(whole.survival) < 0.0)
    # Trajectories that end first are continued by the tail, and it is said.
    cut = passed(oscillator(), "H=1.5", times=[300.0], time=150.0, seed=4)
    assert cut.settings["not failed"] > 1000 and "continued" in cut.settings
    assert cut.certificate.certified
    for name in ("mean", "variance", "rate"):
        assert alike(getattr(whole, name), getattr(cut, name))
    assert abs(whole.survival[3] - cut.survival[0]) < 4.0 * cut.survival_error[0] + 0.02
    # Seconds end it in time and without bias: here after ten looks at the clock.
    slow_clock(monkeypatch)
    short = passed(oscillator(), "H=1.5", seconds=0.3, dt=0.1, seed=5)
    assert int(short.settings["not failed"]) > 0 and alike(whole.mean, short.mean)


def test_without_noise_the_time_of_a_passage_is_that_of_the_cosine() -> None:
    # q = −cos t: 0.999 is passed at π − arccos 0.999, |cubic − cosine| < (ωh)^4/384 = 3e-6 here:
    # 7e-5 of time where the velocity is √(1 − 0.999²) = 0.045.
    system, dt = System([1.0], [1.0], [0.0], [1e-24]), 0.18
    q, p = (np.full((LANES, 1), x) for x in (0.5, np.sqrt(0.75)))
    time = in_blocks(np.full((LANES, 1), np.inf))
    motion = ensemble_from(system, q, p, dt, 1)
    motion.advance(12, time, time, read=reader_of(system, parse_limit("q1=0.999", 1), dt))
    assert time == pytest.approx(np.arccos(0.5) - np.arccos(0.999), abs=7e-5)


def test_either_of_two_modes_survives_as_the_product() -> None:
    # Damping a M: modes do not couple, and equal noise by mass makes them independent.
    system, times = System([1.0, 1.0], [1.0, 1.0], [0.06, 0.06], [0.03, 0.03]), [10.0, 30.0, 60.0]
    both, first, second = (
        passed(system, limit, times=times, seed=seed)
        for limit, seed in (("H1=1.2,H2=0.9", 1), ("H1=1.2", 2), ("H2=0.9", 3))
    )
    error = np.hypot(first.survival_error, np.hypot(second.survival_error, both.survival_error))
    assert np.all(np.abs(both.survival - first.survival * second.survival) < 4.0 * error)
    assert np.all(both.survival < first.survival - 4.0 * error)


def test_from_the_stationary_state_the_share_beyond_the_limit_has_failed_at_once() -> None:
    answer = passed(exact(), "H=1.2", "noise=1", times=[0.0, 1.0])
    right = exact_density(exact(), "H").cdf(1.2).value
    assert off((answer.survival[0], answer.survival_error[0]), (right, 0.0)) < 4.0
    assert answer.survival[1] < answer.survival[0]


def test_an_energy_without_noise_passes_where_it_is_driven_and_only_there() -> None:
    # The noise drives the first mode alone: T2 N T2 = 0. Damping a M does not couple them.
    first = np.linalg.eigh(np.array([[2.0, -1.0], [-1.0, 1.0]]))[1][:, :1]
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05], noise_gain=first)
    answer = passed(system, "H2=1e-6", times=[20.0], time=30.0)
    assert answer.survival[0] == 1.0 and not answer.certificate.certified
    assert alike(passed(system, "H1=0.4,H2=1e-6").mean, passed(system, "H1=0.4", seed=2).mean)


@pytest.mark.parametrize(
    ("limit", "start", "right"), [("v1>1", "rest", 2.0934067), ("v1<-0.5", "p1=1", 1.6860715)]
)
def test_velocity_is_seen_between_steps(limit: str, start: str, right: float) -> None:
    """√(π/2) ∫ exp(v²/2) erfc(−v/√2) dv is the mean time of the Ornstein-Uhlenbeck process; the
    spring alters it by about 1e-6. Looks at steps alone are late by a tenth of that."""
    ou = System([1.0], [1e-6], [1.0], [1.0])
    mean = passed(ou, limit, start, paths=8192).mean
    assert abs(mean.value - right) < 4.0 * mean.error < 0.1 * right


def test_damping_that_depends_on_the_state_is_stepped() -> None:
    # A limit beyond the cycle at H = 2 is passed by noise, one below it by the growth.
    system = limit_cycle()
    below = passed(system, "H=1.6", "q1=1", times=[60.0])
    assert below.survival[0] < 0.01 and below.mean.value < 20.0
    one, half = (passed(system, "H=2.6", "q1=1", dt=dt, seed=k) for k, dt in ((1, 0.1), (2, 0.05)))
    assert alike(one.mean, half.mean)


def test_the_same_for_any_threads_and_another_seed_is_another_answer() -> None:
    asked: Any = {"limit": "q2=0.8", "start": "H=0.2", "times": [20.0]}
    one, two, other = (passed(fig6(), **own, **asked) for own in ({}, {"threads": 2}, {"seed": 2}))
    assert (one.mean, one.rate) == (two.mean, two.rate)
    np.testing.assert_array_equal(one.survival, two.survival)
    assert other.mean != one.mean and alike(other.mean, one.mean)


def test_with_contact_the_difference_of_the_steps_is_in_the_error() -> None:
    asked: Any = fig6(), "H=0.8", "H1=0.1,H2=0.2", [50.0]
    answer, finer = passed(*asked), passed(*asked, dt=0.02, seed=9)
    assert answer.mean.error >= answer.settings["step bias of the mean"]
    assert alike(answer.mean, finer.mean)


def test_a_limit_that_nobody_reaches_is_not_certified_and_the_rate_is_bounded() -> None:
    answer = passed(oscillator(), "H=60", times=[10.0], time=20.0)
    assert not answer.certificate.certified
    (words,) = answer.certificate.failures
    assert "passed the limit by t = 20" in words and "95 %" in words
    assert answer.rate.value == 0.0
    assert answer.rate.error == pytest.approx(3.0 / (4096 * 20.0), rel=0.05)
    assert answer.mean.error == np.inf and answer.survival[0] == 1.0
    assert answer.survival_error[0] == pytest.approx(1.0 / 4096)
    # Without a time, an eighth of it is enough to see that, or the last time that is asked for.
    short, long = (
        passed(oscillator(), "H=60", times=times, most_steps=30000) for times in ([10.0], [900.0])
    )
    (end, asked), step = (a.settings["followed until"] for a in (short, long)), 256.0
    assert end <= (10000.0 / 8.0 + step) * short.settings["coarse dt"] and asked >= 900.0


def test_bad_input_is_one_line() -> None:
    for words, change in (
        ("beyond the limit", {"start": "H=2"}),
        ("beyond the limit", {"start": "q1=2", "limit": "q1=2"}),
        ("ascend", {"times": [2.0, 1.0]}),
        ("ascend", {"times": [-1.0, 1.0]}),
        ("exact_flow", {"scheme": "baoab"}),
        ("stability limit", {"dt": 3.0, "system": fig6()}),
    ):
        asked: Any = {"system": oscillator(), "limit": "H=1.5"} | change
        assert_refused(InvalidInput, words, partial(passed, **asked))


def test_an_overdamped_velocity_is_followed_and_too_long_a_step_is_not_certified() -> None:
    system = oscillator(20.0)
    chosen, finer = (passed(system, "H=1.5", dt=dt, seed=k) for k, dt in ((1, None), (2, 0.003)))
    assert alike(chosen.mean, finer.mean) and chosen.certificate.certified
    for own, limit, dt in ((system, "H=1.5", 0.3), (LOOSE, "q1=0.5", 15.7)):
        coarse = passed(own, limit, times=[1.0], time=1.0, dt=dt)
        assert any("not all is seen" in words for words in coarse.certificate.failures)
    with pytest.raises(InvalidInput, match=r"dt = 15\.7: is too long"):
        rare_failure(LOOSE, parse_limit("q1=0.5", 1), REST, 1.0, settings=Splitting(dt=15.7))


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
            a = estimated(failed, failed, until, times, tol=1.0)
            ones = [(x.value - 1.0) / x.error for x in (a.mean, a.rate, a.variance)]
            z.append([*ones[:2], *(a.survival - np.exp(-times)) / a.survival_error, ones[2]])
        square = np.mean(np.square(z), axis=0)
        assert np.all(square < [1.73, 1.73, 1.73, 1.73, 2.5]) and np.all(square > 0.27)


def test_the_tail_begins_after_what_the_start_has_left() -> None:
    # T = T1 + T2 with rates 1 and 4: the hazard rises to 1 as 1 − 4/3 e^(−3t)…: 1 % off at t = 1.6.
    stream = np.random.default_rng(9)
    time = stream.exponential(size=200_000) + stream.exponential(0.25, size=200_000)
    until = np.full(time.size, np.inf)
    begin = tail_begin(time, until, 0.5)
    rate, early = (estimates(time, until, np.zeros(0), b)[2] for b in (begin, 0.0))
    assert begin > 1.0 and abs(early - 1.0) > 0.1
    assert abs(rate - 1.0) < 4.0 / np.sqrt(np.count_nonzero(time > begin))


def test_a_limit_that_is_passed_soon_is_passed_in_many_steps() -> None:
    # H rises as D t/m at first: the mean time is L m/D.
    answer, right = passed(oscillator(), "H=1e-60", paths=8192), 1e-60 / 0.025
    assert answer.certificate.certified
    assert abs(answer.mean.value - right) < 4.0 * answer.mean.error < 0.1 * right


def test_failures_within_few_steps_are_not_certified() -> None:
    fine = np.linspace(0.01, 0.2, 1000)
    sampled = fine, fine, np.full(1000, 10.0)
    answer = estimated(*sampled, step=0.1, memory=1.0)
    assert any("too few to see how; use dt" in text for text in answer.certificate.failures)
    assert answer.mean.error == answer.variance.error == np.inf
    assert estimated(*sampled, step=0.02, memory=1.0).certificate.certified
    with pytest.raises(InvalidInput, match=r"limit = .*begin beyond"):
        estimated(np.zeros(9), np.zeros(9), np.ones(9), step=0.1, memory=1.0)


def test_the_bound_of_a_rate_is_that_of_poisson() -> None:
    # Garwood: half the 95 % quantile of χ² with 2 (events + 1) degrees of freedom, by tables.
    for events, bound in ((0, 2.9957), (1, 4.7439), (10, 16.9622)):
        time = np.where(np.arange(4096) < events, 1.0, np.inf)
        (words,) = estimated(time, time, np.full(4096, 10.0)).certificate.failures
        assert f" is {bound / (40960.0 - 9.0 * events):.2g} at most (95 %)" in words


def test_a_number_that_the_step_makes_is_not_certified() -> None:
    # 40 and 4 of 1000 fail: the next halving may add as many again.
    fine, coarse = np.full((2, 1000), inf)
    fine[:40], coarse[:4] = np.linspace(0.5, 0.9, 40), np.linspace(0.5, 0.9, 4)
    known: Any = {"limit": "q1=1", "step": 0.01, "memory": 1.0}
    for rough in (True, False):
        answer = estimated(fine, coarse, np.ones(1000), [1.0], **known)
        assert any("changes by" in words for words in answer.certificate.failures) == rough
        coarse[:38] = fine[:38]


def test_no_rate_is_given_from_a_time_in_which_the_start_is_not_forgotten() -> None:
    """From t = 1 on the rate is 1, and before 0: 150 of 1000 have failed when they are cut."""
    fine = np.append(1.0 - np.log1p(-np.arange(150) / 1000.0), np.full(850, inf))
    known: Any = {"limit": "q1=1", "step": 0.001, "memory": 1.1}
    cut = estimated(fine, fine, np.full(1000, 1.163), [1.1, 20.0], **known)
    assert cut.rate is None and cut.mean.error == inf == cut.survival_error[1]
    assert cut.survival[0] == pytest.approx(np.exp(-0.1), abs=2e-3)
    assert not cut.certificate.certified


def test_a_probability_that_is_known_to_tenths_only_is_not_certified() -> None:
    number, certificate = Number(1.0, 0.1), Measured(0.1, None, 0.0, None, None)
    known = "sampling", certify(certificate, tol=inf, sampled=True)
    for error, certified in ((0.1, True), (0.11, False), (inf, False)):
        survival = np.array([1.0, 0.4]), np.array([0.0, error])
        answer = Passage(number, number, None, np.array([0.0, 2.0]), *survival, *known)
        assert answer.certificate.certified == certified
        assert certified or "P(T > 2)" in answer.certificate.failures[0]


def test_the_time_that_a_phase_takes_counts_from_its_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four seconds of other work, then two for a tenth of the phase: it takes 20 s, not 60."""
    clock = [4.0]
    monkeypatch.setattr("sim.questions.rounds.working_time", lambda: clock[0])
    check = Watch(5.0, lambda: False, begin=0.0).required("the first round")
    assert not check(0.05)
    clock[0] = 6.0
    with pytest.raises(InvalidInput, match="in the first round, which takes about 20 s; give it"):
        check(0.1)
    with pytest.raises(InvalidInput, match="which takes longer"):
        check(0.0)
    with pytest.raises(KeyboardInterrupt):
        Watch(5.0, lambda: True, begin=0.0).required("the first round")(0.1)


@pytest.mark.parametrize(("limit", "right"), [("q1=0.5", PASSES), ("H=0.5", EXITS)])
def test_a_loose_mass_passes_a_limit_within_a_small_part_of_its_period(
    limit: str, right: float
) -> None:
    answer = passed(LOOSE, limit, times=[1e-3, 1.0], time=1.0, paths=8192)
    assert answer.certificate.certified and answer.survival[0] == 1.0
    assert abs(1.0 - answer.survival[1] - right) < SIGMAS * answer.survival_error[1] < 0.05


def test_a_rate_is_given_from_when_the_start_is_forgotten() -> None:
    # By the equation the mean is 1.4565036, the rate 1.1035251; at t = 0.5 a tenth of that.
    short, long = (passed(LOOSE, "q1=0.5", times=[t], time=t, paths=32768) for t in (0.5, 1.5))
    assert short.certificate.certified and 0.0 < short.survival_error[0] < 1e-3
    assert short.rate is None and short.mean.error == short.variance.error == inf
    assert long.rate is not None and "continued" in long.settings
    for number, right in ((long.mean, 1.4565036), (long.rate, 1.1035251)):
        assert abs(number.value - right) < SIGMAS * number.error < 0.5 * right


def test_two_loose_masses_are_two_of_one() -> None:
    # k, c → 0: nothing couples them.
    pair = System([1.0, 1.0], [1e-8, 1e-8], [1e-8, 1e-8], [0.5, 0.5])
    settings = Splitting(replicas=256, repetitions=8, threads=1)
    rare = rare_failure(pair, parse_limit("q2=0.5", 2), REST, 1.0, settings=settings)
    assert abs(rare.probability - PASSES) < SIGMAS * rare.error < 0.3


@pytest.mark.parametrize(
    ("limit", "start", "times"),
    [("q1=1e-3", "q1=0.999e-3", [1e-4, 1e-2]), ("H=1e-7", "H=0.99e-7", [1e-11, 1e-7])],
)
def test_a_limit_near_the_start_is_seen_passed(limit: str, start: str, times: Any) -> None:
    asked: Any = {"system": LOOSE, "limit": limit, "start": start, "times": times}
    asked |= {"time": times[1], "paths": 8192}
    answer, finer = passed(**asked), passed(**asked, step_factor=0.05, seed=2)
    assert answer.certificate.certified and np.all(answer.survival_error < 0.01)
    assert 1.0 > answer.survival[0] > answer.survival[1] > 0.0
    right = finer.survival, finer.survival_error
    assert off((answer.survival, answer.survival_error), right) < SIGMAS


def test_steps_grow_with_the_time_since_the_start() -> None:
    steps = list(stages(1e-6, 0.3, 1e3, most=256))
    ends = np.cumsum([h * many for h, many in steps])
    assert max(h for h, _ in steps) == 0.3 and max(many for _, many in steps) == 256
    assert 1e3 <= ends[-1] < 1e3 + 0.3 * (1.0 + 1e-9)
    for (h, _), begin in zip(steps[1:], ends[:-1], strict=True):
        assert h <= max(begin / STEPS_SINCE_START, 1e-6) * (1.0 + 1e-9)
    assert list(stages(0.25, 0.25, 2.0, most=256)) == [(0.25, 8)]


def test_what_never_settles_or_moves_is_refused() -> None:
    for noise, start, words in ((0.5, "noise=1", "not damped"), (0.0, "rest", "no noise")):
        system = System([1.0], [1.0], [0.0], [noise])
        with pytest.raises(NotApplicable, match=words):
            passed(system, "q1=0.5", start, [1.0])
        with pytest.raises(NotApplicable, match=words):
            transient(system, "q1", start, [1.0], [0.0])


def drawn(number: int) -> tuple[System, Limit, Start, Array]:
    """A random system of one mass or two, with a stop or without; a limit, a start, two times."""
    r = np.random.default_rng([391, number])
    n, stop = 1 + number % 2, number // 2 % 2
    mass, stiffness = 10.0 ** r.uniform(-0.5, 0.5, n), 10.0 ** r.uniform(-8.0, 0.0, n)
    damping = np.where(r.random(n) < 1 / 6, 0.0, 10.0 ** r.uniform(-8.0, 0.0, n))
    noise = 10.0 ** r.uniform(-2.0, 1.0, n)
    if n == 2 and not stop and r.random() < 0.5:
        noise[r.integers(2)] = 0.0
    free = System(mass, stiffness, damping, noise)
    t, row = 10.0 ** r.uniform(-3.0, 3.0), int(r.integers(n))
    covariance = flow_covariance(drift_matrix(free), diffusion_matrix(free), t)[1]
    size = sqrt(covariance[row, row])
    energies = np.diag(free.stiffness_matrix @ covariance[:n, :n]), np.diag(covariance)[n:] / mass
    of_energy, near = r.random() < 1 / 3, r.random() < 2 / 3
    value = (0.5 * float(np.sum(energies)) if of_energy else size) * 10.0 ** r.uniform(-0.5, 0.5)
    value = value if near else 10.0 ** r.uniform(-3.0, 3.0)
    share, start = r.uniform(0.5, 0.99), REST
    name = "H" if of_energy else f"q{row + 1}"
    if r.random() < 0.25:
        start = Start("energy" if of_energy else "state", {name: share * value})
    contacts: tuple[Contact, ...] = ()
    if stop:
        clearance = size * r.uniform(0.0, 2.0) if of_energy else value * r.uniform(0.2, 1.2)
        power = (1.0, 1.5, 2.0)[r.integers(3)]
        B = mass[row] * (10.0 ** r.uniform(0.0, 2.5) / t) ** 2 / size ** (power - 1.0)
        side = ("left", "right", "both")[r.integers(3)]
        contacts = (Contact(row + 1, side, B, clearance, law="power", exponent=power),)
    system = System(mass, stiffness, damping, noise, contacts=contacts)
    before = r.uniform(0.0, 3.0 if r.random() < 0.5 else 0.3)
    return system, parse_limit(f"{name}={value!r}", n), start, np.array([t * 10.0**-before, t])


@pytest.mark.parametrize("number", [k if k == 1 else slow(k) for k in range(60)])
def test_random_systems_are_within_their_stated_errors(number: int) -> None:
    # Against the equation where it is of one mass without a stop, else a tenth of the step. Where
    # nearly all or none fail, the stated error is that of one path of all: so it is of both.
    *asked, times = drawn(number)
    system, limit, _ = asked
    method = MonteCarlo(time=float(times[-1]), threads=1)
    try:
        answer = method.passage(*asked, times)
    except NotApplicable as reason:
        assert "is so far within the contacts" in str(reason)  # the shell of a start
        return
    by_equation = system.n == 1 and limit.kind == "q" and not system.contacts
    last = times[1:] if by_equation else times  # the equation takes long over early times
    fine = PhaseSpace() if by_equation else replace(method, step_factor=0.1, seed=2)
    reference = fine.passage(*asked, last)
    known = answer.survival[-last.size :], answer.survival_error[-last.size :]
    right = reference.survival, reference.survival_error
    if answer.certificate.certified:
        assert np.all(answer.survival_error <= 0.1) and off(known, right) < SIGMAS
        pairs = ((answer.mean, reference.mean), (answer.rate, reference.rate))
        for x, y in pairs if by_equation else ():  # else both are continued at a rate
            if x is not None and y is not None and x.error < inf:  # the start is forgotten
                assert off((x.value, x.error), (y.value, y.error)) < SIGMAS
    try:
        settings = Splitting(replicas=128, repetitions=8, threads=1, seconds=5.0)
        rare = rare_failure(*asked, float(times[-1]), settings=settings)
    except NotCertified:  # too few repetitions in the time
        return
    if rare.error <= 0.5 * rare.probability:
        assert off((rare.probability, rare.error), (1.0 - right[0][-1:], right[1][-1:])) < SIGMAS
