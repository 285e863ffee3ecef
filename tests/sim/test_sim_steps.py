"""Steps of motions in time: from the limit, the times, the stop and the motion's own scales."""

from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from sim_systems import estimated

from averaging.gaussian import Linear
from averaging.phase_space.method import PhaseSpace
from cases.compare.averaged import AveragedSimulation
from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import Passage
from fpk.answer.method import silent
from fpk.answer.names import REST, Limit, Start, parse_limit, parse_observable, parse_start
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.contact import Contact
from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.limits import STEPS_SINCE_START, stages
from sim.questions.splitting.run import Splitting, rare_failure
from sim.step.schemes import flow_covariance

LOOSE = System([1.0], [1e-4], [1e-4], [0.5])
"""A mass whose own period is 628: noise alone moves it by 0.6 in the time 1."""

PASSES = 0.3879686
"""P(|q| = 0.5 is passed by t = 1) of ``LOOSE`` from rest, by the equation in phase space, 3e-7."""

EXITS = 0.6292312
"""P(|W| = 1 is passed by t = 1) of Brownian motion: 1 − (4/π) Σ (−1)^j e^(−(2j+1)² π²/8)/(2j+1)."""

SIGMAS = 5.0
"""Stated errors by which an answer may be off: a chance of 6e-7."""


SEED = 391
"""Seed of the random systems."""

LAWS: tuple[tuple[str, float], ...] = (("bilinear", 1.0), ("hertz", 1.5), ("power", 2.0))


@dataclass(frozen=True)
class Drawn:
    """A random system, a limit of first passage from a start, and two times, ascending."""

    system: System
    limit: Limit
    start: Start
    times: Array
    row: int
    size: float  # rms of q of mass `row` at the last time, of the free system from rest


def drawn(number: int) -> Drawn:
    """Return the random system of a number: one mass or two, with a stop or without."""
    r = np.random.default_rng([SEED, number])
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
    mean = 0.5 * float(np.sum(energies))
    of_energy, near = r.random() < 1 / 3, r.random() < 2 / 3
    value = (mean if of_energy else size) * 10.0 ** r.uniform(-0.5, 0.5)
    value = value if near else 10.0 ** r.uniform(-3.0, 3.0)
    share, begins = r.uniform(0.5, 0.99), r.random() < 0.25
    start = REST
    if begins and of_energy:
        start = Start("energy", {"H": share * value})
    elif begins:
        start = Start("state", {f"q{row + 1}": share * value})
    contacts: tuple[Contact, ...] = ()
    if stop:
        clearance = size * r.uniform(0.0, 2.0) if of_energy else value * r.uniform(0.2, 1.2)
        law, power = LAWS[r.integers(3)]
        B = mass[row] * (10.0 ** r.uniform(0.0, 2.5) / t) ** 2 / size ** (power - 1.0)
        contacts = (
            Contact(row + 1, ("left", "right", "both")[r.integers(3)], B, clearance, law=law,
                    **({"exponent": power} if law == "power" else {})),
        )  # fmt: skip
    system = System(mass, stiffness, damping, noise, contacts=contacts)
    name = "H" if of_energy else f"q{row + 1}"
    limit = parse_limit(f"{name}={value!r}", n)
    before = r.uniform(0.0, 3.0 if r.random() < 0.5 else 0.3)
    return Drawn(system, limit, start, np.array([t * 10.0**-before, t]), row, size)


def off(answer: tuple[Any, Any], reference: tuple[Any, Any]) -> float:
    """The largest distance of (values, errors) from a reference, in units of both errors."""
    value, error, right, own = (np.asarray(x, dtype=float) for x in (*answer, *reference))
    both = np.hypot(error, own)
    return float(np.max(np.abs(value - right) / np.where(both > 0.0, both, 1e-300)))


def passed(system: System, limit: str, times: Any, start: str = "rest", **settings: Any) -> Passage:
    """First passage by simulation to the last time, as a run of a scene asks for it."""
    method = MonteCarlo(**({"threads": 1, "time": max(times)} | settings))
    end, begin = parse_limit(limit, system.n), parse_start(start, system)
    return method.passage(system, end, begin, np.array(times))


@pytest.mark.parametrize(
    ("limit", "right"), [("q1=0.5", PASSES), ("H=0.5", EXITS)], ids=["displacement", "energy"]
)
def test_a_loose_mass_passes_a_limit_within_a_small_part_of_its_period(
    limit: str, right: float
) -> None:
    answer = passed(LOOSE, limit, [1e-3, 1.0])
    assert answer.certificate.certified and answer.survival[0] == 1.0
    assert abs(1.0 - answer.survival[1] - right) < SIGMAS * answer.survival_error[1] < 0.05


def test_a_rate_is_given_from_when_the_start_is_forgotten() -> None:
    # By the equation the mean is 1.4565036, the rate 1.1035251; at t = 0.5 a tenth of that.
    short, long = (passed(LOOSE, "q1=0.5", [t], paths=32768) for t in (0.5, 1.5))
    assert short.certificate.certified and 0.0 < short.survival_error[0] < 1e-3
    assert short.rate is None and short.mean.error == short.variance.error == inf
    assert long.rate is not None and "continued" in long.settings
    for number, right in ((long.mean, 1.4565036), (long.rate, 1.1035251)):
        assert abs(number.value - right) < SIGMAS * number.error < 0.5 * right


def test_two_loose_masses_are_two_of_one() -> None:
    # k, c → 0: nothing couples them.
    pair = System([1.0, 1.0], [1e-8, 1e-8], [1e-8, 1e-8], [0.5, 0.5])
    answer = passed(pair, "q2=0.5", [1.0])
    assert answer.certificate.certified
    assert abs(1.0 - answer.survival[0] - PASSES) < SIGMAS * answer.survival_error[0] < 0.05
    settings = Splitting(replicas=256, repetitions=8, threads=1)
    rare = rare_failure(pair, parse_limit("q2=0.5", 2), REST, 1.0, settings=settings)
    assert abs(rare.probability - PASSES) < SIGMAS * rare.error < 0.3


def test_the_averaged_energy_is_stepped_by_the_limit_and_the_times() -> None:
    method, times = AveragedSimulation("nonintegrable", threads=1, paths=2048), [0.01, 1.0]
    limit = parse_limit("H=0.5", 1)
    answer = method.passage(LOOSE, limit, REST, np.array(times), tol=None, progress=silent)
    # In closed form: dH = D dt + √(2 D H) dB, to 1e-4 of it.
    assert answer.certificate.certified and answer.survival[0] == 1.0
    assert abs(answer.survival[1] - 0.376849) < SIGMAS * answer.survival_error[1] < 0.1


@pytest.mark.parametrize(
    ("limit", "start", "times"),
    [("q1=1e-3", "q1=0.999e-3", [1e-4, 1e-2]), ("H=1e-7", "H=0.99e-7", [1e-11, 1e-7])],
)
def test_a_limit_near_the_start_is_seen_passed(limit: str, start: str, times: Any) -> None:
    answer = passed(LOOSE, limit, times, start)
    finer = passed(LOOSE, limit, times, start, step_factor=0.05, seed=2)
    assert answer.certificate.certified and np.all(answer.survival_error < 0.01)
    assert 1.0 > answer.survival[0] > answer.survival[1] > 0.0
    right = finer.survival, finer.survival_error
    assert off((answer.survival, answer.survival_error), right) < SIGMAS


@pytest.mark.parametrize("limit", ["q1={0!r}", "H={0!r}"])
def test_a_limit_in_other_units_is_passed_in_other_units_of_time(limit: str) -> None:
    # Free motion: q scales as t^1.5, H as t.
    unit, power = 1e-12, 2.0 / 3.0 if limit[0] == "q" else 1.0
    one = passed(LOOSE, limit.format(0.5), [0.5, 1.0])
    times = [0.5 * unit**power, unit**power]
    other = passed(LOOSE, limit.format(0.5 * unit), times, seed=2)
    assert other.certificate.certified
    known = one.survival, one.survival_error
    assert off((other.survival, other.survival_error), known) < SIGMAS


def test_a_step_of_ones_own_that_is_too_long_is_not_certified() -> None:
    answer = passed(LOOSE, "q1=0.5", [1.0], dt=15.7)
    assert any("not all is seen" in words for words in answer.certificate.failures)
    with pytest.raises(InvalidInput, match=r"dt = 15\.7: is too long"):
        rare_failure(LOOSE, parse_limit("q1=0.5", 1), REST, 1.0, settings=Splitting(dt=15.7))


def test_a_number_that_the_step_makes_is_not_certified() -> None:
    # 40 and 4 of 1000 fail: the next halving may add as many again.
    fine, coarse = np.full((2, 1000), inf)
    fine[:40], coarse[:4] = np.linspace(0.5, 0.9, 40), np.linspace(0.5, 0.9, 4)
    known: Any = {"limit": "q1=1", "step": 0.01, "memory": 1.0}
    until, times = np.ones(1000), np.array([1.0])
    answer = estimated(fine, coarse, until, times, **known)
    assert any("changes by" in words for words in answer.certificate.failures)
    coarse[:38] = fine[:38]
    answer = estimated(fine, coarse, until, times, **known)
    assert not any("changes by" in words for words in answer.certificate.failures)


def test_no_rate_is_given_from_a_time_in_which_the_start_is_not_forgotten() -> None:
    """From t = 1 on the rate is 1, and before 0: 150 of 1000 have failed when they are cut."""
    fine = np.append(1.0 - np.log1p(-np.arange(150) / 1000.0), np.full(850, inf))
    until, times = np.full(1000, 1.163), np.array([1.1, 20.0])
    cut = estimated(fine, fine, until, times, limit="q1=1", step=0.001, memory=1.1)
    assert cut.rate is None and cut.mean.error == inf == cut.survival_error[1]
    assert cut.survival[0] == pytest.approx(np.exp(-0.1), abs=2e-3)
    assert not cut.certificate.certified


@pytest.mark.parametrize(("error", "certified"), [(0.1, True), (0.11, False), (inf, False)])
def test_a_probability_that_is_known_to_tenths_only_is_not_certified(
    error: float, certified: bool
) -> None:
    number, measured = Number(1.0, 0.1), Measured(0.1, None, 0.0, None, None)
    survival = np.array([1.0, 0.4]), np.array([0.0, error])
    certificate = certify(measured, tol=inf, sampled=True)
    answer = Passage(number, number, None, np.array([0.0, 2.0]), *survival, "sampling", certificate)
    assert answer.certificate.certified == certified
    assert certified or "P(T > 2)" in answer.certificate.failures[0]


def test_steps_grow_with_the_time_since_the_start() -> None:
    steps = list(stages(1e-6, 0.3, 1e3, most=256))
    ends = np.cumsum([h * many for h, many in steps])
    assert max(h for h, _ in steps) == 0.3 and max(many for _, many in steps) == 256
    assert 1e3 <= ends[-1] < 1e3 + 0.3 * (1.0 + 1e-9)
    for (h, _), begin in zip(steps[1:], ends[:-1], strict=True):
        assert h <= max(begin / STEPS_SINCE_START, 1e-6) * (1.0 + 1e-9)
    assert list(stages(0.25, 0.25, 2.0, most=256)) == [(0.25, 8)]


def spring(stiffness: float, *, damping: float = 0.0, held: float = 1e-8) -> System:
    """A loose mass between bilinear stops that it always touches: a spring, of any method."""
    stop = Contact(1, "both", stiffness, 0.0, law="bilinear")
    return System([1.0], [held], [damping], [0.5], contacts=(stop,))


def test_undamped_motion_against_a_stop_has_a_transient() -> None:
    # Of kT = ∞ no step follows, nor from the 1e5 periods of rest: from the energy by then it does.
    free = System([1.0], [2.0 + 1e-8], [0.0], [0.5])
    at, times, q = np.linspace(-1.0, 1.0, 5), np.array([0.5, 3.0]), parse_observable("q1", 1)
    answer = MonteCarlo(threads=1).transient(spring(2.0), q, REST, times, (at,))
    for k, t in enumerate(times):
        variance = flow_covariance(drift_matrix(free), diffusion_matrix(free), t)[1][0, 0]
        exact = norm.pdf(at, scale=np.sqrt(variance))
        assert np.all(np.abs(answer.values[k] - exact) < SIGMAS * answer.errors[k])
    assert answer.certificate.certified and np.all(answer.errors < 0.1)


@pytest.mark.parametrize(
    ("system", "start", "words"),
    [
        (spring(2.0), "noise=1", "not damped"),
        (System([1.0], [1.0], [0.0], [0.0]), "rest", "no noise"),
    ],
)
def test_what_never_settles_or_moves_is_refused(system: System, start: str, words: str) -> None:
    with pytest.raises(NotApplicable, match=words):
        passed(system, "q1=0.5", [1.0], start)
    begin, q = parse_start(start, system), parse_observable("q1", 1)
    with pytest.raises(NotApplicable, match=words):
        MonteCarlo().transient(system, q, begin, np.ones(1), (np.zeros(1),))


def test_an_autocovariance_is_sampled_within_the_periods_between_stops() -> None:
    # The spring between the stops is 1e4 times that of the system, its period a hundredth.
    asked, at = parse_observable("q1", 1), np.array([0.0, 1.5, 3.0, 9.0])
    method = MonteCarlo(threads=1, paths=4096, time=50.0)
    answer = method.correlation(spring(1.0, damping=0.2, held=1e-4), asked, at)
    right = Linear().correlation(System([1.0], [1.0001], [0.2], [0.5]), asked, at)
    assert answer.certificate.certified and np.all(answer.errors < 0.1)
    assert np.all(np.abs(answer.values - right.values) < SIGMAS * answer.errors)


@pytest.mark.parametrize(
    "number", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(60) if k != 1)]
)
def test_random_systems_are_within_their_stated_errors(number: int) -> None:
    # Against the equation where it is of one mass without a stop, else a tenth of the step. Where
    # nearly all or none fail, the stated error is that of one path of all: so it is of both.
    d = drawn(number)
    asked, method = (d.system, d.limit, d.start), MonteCarlo(time=float(d.times[-1]), threads=1)
    fine = replace(method, step_factor=0.1, seed=2)
    try:
        answer = method.passage(*asked, d.times)
    except NotApplicable as reason:
        assert "is so far within the contacts" in str(reason)  # the shell of a start
        return
    exact = d.system.n == 1 and d.limit.kind == "q" and not d.system.contacts
    last = d.times[1:] if exact else d.times  # the equation takes long over early times
    reference = (PhaseSpace() if exact else fine).passage(*asked, last)
    known = answer.survival[-last.size :], answer.survival_error[-last.size :]
    right = reference.survival, reference.survival_error
    assert not answer.certificate.certified or np.all(answer.survival_error <= 0.1)
    if answer.certificate.certified:
        assert off(known, right) < SIGMAS
        if exact:  # else both are continued at a rate
            for x, y in ((answer.mean, reference.mean), (answer.rate, reference.rate)):
                if x is None or y is None or x.error == inf:
                    continue  # the start is not forgotten
                assert off((x.value, x.error), (y.value, y.error)) < SIGMAS
    try:
        settings = Splitting(replicas=128, repetitions=8, threads=1, seconds=5.0)
        rare = rare_failure(*asked, float(d.times[-1]), settings=settings)
    except NotCertified:  # too few repetitions in the time
        return
    if rare.error <= 0.5 * rare.probability:
        assert off((rare.probability, rare.error), (1.0 - right[0][-1:], right[1][-1:])) < SIGMAS


@pytest.mark.parametrize(
    "number", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 60))]
)
def test_random_transients_are_within_their_stated_errors(number: int) -> None:
    # Against the Gaussian of a linear system from rest, else a tenth of the step.
    d, at = drawn(number), np.array([-1.2, -0.4, 0.3, 1.0])
    q, points = parse_observable(f"q{d.row + 1}", d.system.n), (d.size * at,)
    answer = MonteCarlo(threads=1).transient(d.system, q, REST, d.times, points)
    if d.system.contacts:
        fine = MonteCarlo(threads=1, step_factor=0.1, seed=2)
        right = fine.transient(d.system, q, REST, d.times, points)
        reference = right.values, right.errors
    else:
        A, b = drift_matrix(d.system), diffusion_matrix(d.system)
        scales = [sqrt(flow_covariance(A, b, t)[1][d.row, d.row]) for t in d.times]
        reference = np.array([norm.pdf(points[0], scale=scale) for scale in scales]), 0.0
    z = off((answer.values, answer.errors), reference)
    assert z < SIGMAS or not answer.certificate.certified
