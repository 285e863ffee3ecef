"""First passage of averaged energies by simulation, against the square-root process."""

from typing import Any

import numpy as np
import pytest
from numba import njit
from sim_systems import fig6, linear
from test_sim_passage import CIR_MEAN, CIR_RATE, oscillator

from cases.compare.averaged import AveragedSimulation
from fpk.answer.dynamics import Passage
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.system import System
from sim.questions.averaged.square_root import (
    square_root_form,
    square_root_step,
)
from sim.questions.limits import CHUNK
from sim.questions.passing import distance_to
from sim.questions.rounds import Watch


def passed(theory: Any, system: System, limit: str, start: str = "rest", times: Any = (),
           **settings: Any) -> Passage:  # fmt: skip
    return AveragedSimulation(
        theory, **({"threads": 1, "paths": 1024, "step": 0.2} | settings)
    ).passage(
        system,
        parse_limit(limit, system.n),
        parse_start(start, system),
        np.array(times, dtype=float),
        tol=None,
        progress=silent,
    )


@pytest.mark.parametrize("theory", ["integrable", "nonintegrable"])
def test_failure_rate_of_the_square_root_process_is_the_exact_one(theory: Any) -> None:
    # c = 0.1, kT = 0.5, Hf = 3 kT: λ = 0.013742123052434; 4 errors, which hold the step's bias.
    answer = passed(theory, oscillator(0.1), "H=1.5", times=[10.0, 80.0], paths=4096)
    assert answer.certificate.certified
    for number, exact in ((answer.rate, 0.1 * CIR_RATE), (answer.mean, CIR_MEAN / 0.1)):
        assert number is not None
        assert abs(number.value - exact) < 4.0 * number.error < 0.2 * exact


@njit
def called_distances(limit: Any, H: Any, variance: Any, growth: Any, at_rest: Any) -> Any:
    far = np.empty(H.size)
    for k in range(H.size):
        far[k] = distance_to(limit, H[k], variance[k], growth[k], at_rest)
    return far


def distances(limits: Any, form: Any, X: Any) -> Any:
    """How far the first limit is, as the compiled readers have it."""
    weights, values = limits
    p, of = np.sqrt(X), form.diffusion(weights)
    forms = (np.einsum("pi,ij,pj->p", p, form[0], p) for form in (of.variance, of.growth))
    return called_distances(values[0], (X @ weights.T)[:, 0], *forms, of.at_rest[0])


def failed_by(dt: float, until: float, *, bridge: bool) -> float:
    """The share of 65536 paths from 0.8 of the limit that failed by a time, at kT = 1.

    By the product of the chances that no bridge passed: no random number is in that.
    """
    form = square_root_form(AveragedSimulation("integrable")._process(oscillator(1.0, 1.0)))
    limits = AveragedSimulation("integrable").limits(form, parse_limit("H1=1.5", 1))
    stream = np.random.default_rng(4)
    X = np.full((65536, 1), 1.2)
    survived, before = np.ones(len(X)), distances(limits, form, X)
    for _ in range(round(until / dt)):
        X = square_root_step(form, X, dt, stream)
        after = distances(limits, form, X)
        passed = np.exp(-2.0 * before * after / dt) if bridge else 0.0
        survived *= np.where((after > 0.0) & (survived > 0.0), 1.0 - passed, 0.0)
        before = after
    return float(1.0 - survived.mean())


def test_the_bridge_has_a_higher_order_than_a_look_at_the_steps() -> None:
    # Steps of the process are exact: all that differs is what is seen. One error of a share is
    # 0.002, of a difference of two 0.0028. The loss of the naive reader falls as √dt, by 2 to dt/4.
    dts = (0.2, 0.05, 0.0125)
    bridged = np.array([failed_by(dt, 1.0, bridge=True) for dt in dts])
    naive = np.array([failed_by(dt, 1.0, bridge=False) for dt in dts])
    lost = bridged[-1] - naive
    assert np.all(np.abs(bridged - bridged[-1]) < 4.0 * 0.0028)
    assert np.all(lost > 10.0 * 0.0028)
    assert np.all((lost[:-1] / lost[1:] > 1.6) & (lost[:-1] / lost[1:] < 2.4))


def test_distance_of_a_sum_is_that_of_one_energy_of_equal_modes() -> None:
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05, 0.05])
    form = square_root_form(AveragedSimulation("integrable")._process(system))
    X = np.random.default_rng(1).exponential(0.5, (50, 2))
    limits = np.ones((1, 2)), np.array([2.0])
    expected = 2.0 * (np.sqrt(2.0) - np.sqrt(X.sum(axis=1))) / np.sqrt(form.slope[0])
    assert distances(limits, form, X) == pytest.approx(expected, rel=1e-12)
    assert np.isfinite(distances(limits, form, 0.0 * X)).all()


def test_with_contact_and_from_any_start() -> None:
    system, late = fig6(), [1000.0]
    rest = passed("nonintegrable", system, "H=0.5", times=late)
    state = passed("nonintegrable", system, "H=0.5", "q2=0.5", times=late)
    level = float(system.hamiltonian(np.array([0.0, 0.5]), np.zeros(2)))
    energy = passed("nonintegrable", system, "H=0.5", f"H={level!r}", times=late)
    noise = passed("nonintegrable", system, "H=0.5", "noise=0.2", times=late)
    assert state.mean == energy.mean
    assert state.mean.value < noise.mean.value < rest.mean.value + 4.0 * rest.mean.error
    assert rest.survival[0] == 0.0 and rest.certificate.certified


def test_the_integrable_theory_knows_each_mode_and_their_sum() -> None:
    system = linear(2)
    both = passed("integrable", system, "H1=0.9,H2=1.0", "H1=0.1,H2=0.2", times=[20.0])
    one = passed("integrable", system, "H1=0.9", "H1=0.1,H2=0.2", times=[20.0], seed=2)
    two = passed("integrable", system, "H2=1.0", "H1=0.1,H2=0.2", times=[20.0], seed=3)
    product = one.survival[0] * two.survival[0]
    error = np.hypot(both.survival_error[0], np.hypot(one.survival_error[0], two.survival_error[0]))
    assert abs(both.survival[0] - product) < 4.0 * error
    spread = passed("integrable", system, "H=1.2", "H=0.5")
    line = passed("nonintegrable", system, "H=1.2", "H=0.5")
    # Equal decay of both modes: H is the same process in both theories, but for c_ij of the modes.
    assert abs(spread.mean.value - line.mean.value) < 0.1 * line.mean.value


def test_energies_are_inverted() -> None:
    simulation = AveragedSimulation("nonintegrable")
    form = simulation._form(simulation._process(fig6()))
    H = np.array([[1e-6], [0.1], [0.4], [1.3]])
    assert form.energies(form.inverse(H)) == pytest.approx(H, rel=1e-12)


@pytest.mark.parametrize(
    ("error", "words", "change"),
    [
        (NotApplicable, "limits of H only", {"limit": "q2=1"}),
        (NotApplicable, "limits of H only", {"limit": "H1=1"}),
        (NotApplicable, "leave H open", {"start": "H1=0.1,H2=0.1"}),
        (InvalidInput, "beyond", {"start": "H=2"}),
        (InvalidInput, "ascend", {"times": [1.0, 1.0]}),
    ],
)
def test_bad_input_is_one_line(error: Any, words: str, change: dict[str, Any]) -> None:
    asked: Any = {"theory": "nonintegrable", "system": fig6(), "limit": "H=1"} | change
    with pytest.raises(error, match=words) as raised:
        passed(**asked)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("contact", [False, True])
def test_seconds_end_it_and_enough_of_them_change_nothing(contact: bool) -> None:
    # Steps are exact without contact, and of two kinds with it; as many paths at both.
    system, limit = (fig6(), "H=0.5") if contact else (oscillator(0.1), "H=1.5")
    short = passed("nonintegrable", system, limit, seconds=1e-9)
    assert float(short.settings["followed until"]) <= float(short.settings["coarse dt"])
    assert not short.certificate.certified
    long, whole = (passed("nonintegrable", system, limit, seconds=s) for s in (1e6, None))
    assert (long.mean, long.rate) == (whole.mean, whole.rate) and long.certificate.certified


def test_an_end_by_the_wall_time_has_no_bias(monkeypatch: pytest.MonkeyPatch) -> None:
    # Each round of 512 paths ends after another number of looks at the time, 4 to 13.
    monkeypatch.setattr("sim.questions.averaged.paths.MOST_SUMS", 512 * CHUNK)
    numbers, left = iter(range(10**6)), [0]

    def ends(_: Any) -> bool:
        left[0] -= 1
        if left[0] < 0:
            left[0] = 4 + 7 * next(numbers) % 10
        return left[0] == 0

    monkeypatch.setattr("sim.questions.rounds.Watch.ends", ends)
    monkeypatch.setattr("sim.questions.rounds.Watch.until", until_the_last)
    answer = passed("integrable", oscillator(0.1), "H=1.5", paths=8192)
    assert int(answer.settings["not failed"]) > 200 and answer.certificate.certified
    assert abs(answer.mean.value - CIR_MEAN / 0.1) < 4.0 * answer.mean.error


def until_the_last(watch: Watch, answer: Any, *, least: int, most: int) -> list[str]:
    """Every round, whatever the time."""
    for number in range(most):
        answer(number)
    return []
