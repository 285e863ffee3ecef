"""Upcrossings, power spectra and autocovariances by simulation, against exact ones."""

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from sim_systems import curve, exact, fig6, linear, slow_clock

from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import stationary_covariance
from fpk.system.system import System
from sim.questions.curves import EXTRA_LAGS, autocovariance, products_at_lags, spline_error
from sim.questions.passing import count_upcrossings
from sim.step.arrays import LANES, in_blocks

Z = 4.5
"""|z| that chance explains: of 25 independent points 2e-4; of 31 degrees of freedom 1e-3."""
LAGS = np.array([0.0, 0.05, 0.37, 1.0, 2.0, 3.3, 5.0, 7.3, 10.0, 20.0, 40.0])
POINTS = {"crossings": np.linspace(-2.0, 2.0, 11), "spectrum": np.linspace(0.0, 3.0, 25)}
LENGTHS: dict[str, Any] = {"correlation": {"time": 100.0}}


@pytest.mark.parametrize(
    ("question", "masses", "most"),
    [("crossings", 3, 0.005), ("spectrum", 2, 0.05), ("correlation", 2, 0.02)],
)  # fmt: skip
def test_a_linear_system_has_its_exact_curve(question: str, masses: int, most: float) -> None:
    """Rice's formula, the transfer function, the exponential of the drift; not of more masses."""
    at, asked = POINTS.get(question, LAGS), (question, linear(masses), masses - 1)
    answer = curve(*asked, at, **LENGTHS.get(question, {}))
    expected = curve(*asked, at, route="linear")
    assert answer.certificate.certified and answer.error_kind == "sampling"
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)
    scale = {"crossings": at.size // 2, "correlation": 0}
    where = scale.get(question, slice(None))
    assert np.all(answer.errors[where] < most * expected.values[where])
    other = linear(masses + 1)
    wrong = curve(question, other, masses - (question != "crossings"), at, route="linear")
    assert np.max(np.abs(answer.values - wrong.values) / answer.errors) > Z
    if question == "spectrum":
        both = curve(*asked, [-1.0, 1.0])
        assert both.values[0] == both.values[1]
        # Tolerances are relative to (rms q)³/(rms v).
        q, v = np.sqrt(np.diag(stationary_covariance(asked[1]))[[1, 3]])
        v /= asked[1].mass[1]
        share = answer.certificate.l1_error * q**3 / v
        assert share == pytest.approx(answer.errors.max(), rel=0.1)


def test_what_the_noise_crosses_within_a_step_is_extrapolated() -> None:
    # Zero is crossed once a period 2π. Steps of 0.2 lose 0.7 % of that, those of 0.4 twice as much.
    system = System([1.0], [1.0], [0.5], [0.25])
    answer = curve("crossings", system, 0, [0.0], dt=0.4, paths=16384)
    bias = float(answer.settings["largest step bias"])
    sampling = np.sqrt(answer.errors[0] ** 2 - bias**2)
    assert bias > 6.0 * sampling > 0.0 and answer.errors[0] >= bias
    assert abs(answer.values[0] - 0.5 / np.pi) < 4.0 * sampling


def test_with_contact_the_rates_are_those_of_the_exact_density() -> None:
    at = np.linspace(-0.8, 0.8, 9)
    answer = curve("crossings", exact(), 1, at)
    expected = curve("crossings", exact(), 1, at, route="exact")
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)
    wrong = curve("crossings", exact(clearance=0.55), 1, at, route="exact")
    assert np.max(np.abs(answer.values - wrong.values) / answer.errors) > Z


ONE_STOP = System([1.0], [1.0], [0.2], [0.1], contacts=(Contact(1, "right", 10.0, 0.2),))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("question", "system", "at"),
    [("crossings", fig6(), np.linspace(-0.8, 0.8, 9)),
     ("spectrum", ONE_STOP, np.array([0.0, 0.1, 0.5, 1.0, 1.3, 2.0, 3.0])),
     ("spectrum", exact(), np.array([0.2, 0.6, 1.0, 1.6, 2.0])),
     ("correlation", fig6(), LAGS), ("correlation", exact(), LAGS)],
)  # fmt: skip
def test_with_contact_the_curve_is_that_of_phase_space(question: str, system: System, at) -> None:
    asked = question, system, system.n - 1, at
    answer, expected = curve(*asked, paths=8192), curve(*asked, route="phase-space")
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors + expected.errors)


def test_any_cubic_is_counted_as_its_dense_samples() -> None:
    # Random ends and slopes: several turns within a step. Levels lie between samples by chance.
    rng = np.random.default_rng(7)
    q, p = rng.normal(size=(2, 2 * LANES)), 6.0 * rng.normal(size=(2, 2 * LANES))
    levels = np.linspace(-2.0, 2.0, 9)
    states = [np.stack([in_blocks(x[k][:, None])[:, 0] for x in (q, p)], axis=1) for k in (0, 1)]
    counts = np.zeros((2, levels.size + 1), dtype=np.int64)
    count_upcrossings(np.stack(states, axis=1), 1, 0, counts, 1.0, 0, 1, 1.0, levels)
    path = CubicHermiteSpline([0.0, 1.0], q, p)(np.linspace(0.0, 1.0, 20001))
    for m, level in enumerate(levels):
        dense = np.count_nonzero((path[:-1] < level) & (path[1:] >= level))
        assert abs(int(np.cumsum(counts, axis=1)[:, m].sum()) - dense) <= 1


@pytest.mark.parametrize("question", ["crossings", "spectrum", "correlation"])
def test_in_any_order_for_any_threads_and_a_tolerance_is_met_or_not_certified(question) -> None:
    one = curve(question, linear(1), 0, [0.1, 0.5, 0.1], time=20.0)
    two = curve(question, linear(1), 0, [0.5, 0.1, 0.1], time=20.0, threads=2)
    np.testing.assert_array_equal(one.values, two.values[[1, 0, 2]])
    np.testing.assert_array_equal(one.errors, two.errors[[1, 0, 2]])
    short = curve(question, linear(1), 0, [0.0, 0.5], time=5.0, longest=0.5, tol=1e-6)
    assert any("exceeds the tolerance" in words for words in short.certificate.failures)


def test_a_level_never_reached_has_the_error_of_one_visit() -> None:
    answer = curve("crossings", linear(1), 0, [40.0], time=20.0)
    assert answer.values[0] == 0.0
    assert answer.errors[0] == pytest.approx(1.0 / (4096 * 20.0), rel=0.05)


def test_leakage_of_the_windows_is_in_the_error() -> None:
    # A window of 20 decay times flattens the peak by some 3 %, one of 10 by 10 %.
    answer = curve("spectrum", linear(1), 0, [1.0], time=400.0, paths=16384)
    (expected,) = curve("spectrum", linear(1), 0, [1.0], route="linear").values
    assert answer.errors[0] >= float(answer.settings["largest leakage"]) > 0.01 * expected
    assert abs(answer.values[0] - expected) < Z * answer.errors[0]


@pytest.mark.parametrize("spacing", [0.1, 0.6])
def test_the_spline_between_the_samples_is_as_good_as_it_says(spacing: float) -> None:
    # Exact products, ω = 1: the error of the spline falls as the fourth power of the spacing.
    system, lags = System([1.0], [1.0], [0.2], [0.1]), np.linspace(0.0, 20.0, 371)
    samples = spacing * np.arange(2 * np.ceil(10.0 / spacing) + EXTRA_LAGS + 1)
    products = np.tile(curve("correlation", system, 0, samples, route="linear").values, (2, 1))
    rounds = [(products, np.zeros_like(products), np.zeros((2, 1)))]
    right = curve("correlation", system, 0, lags, route="linear").values
    error = np.max(np.abs(autocovariance(rounds, spacing, lags)[0] - right))
    assert error < spline_error(rounds, spacing) < 4.0 * error


def test_lagged_products_are_those_of_their_definition() -> None:
    q = np.random.default_rng(20261123).normal(size=(2, 37, 128)) + 3.0
    products, sums, means = products_at_lags(q, 20)
    assert products.shape == sums.shape == (2, 18)
    for k in range(18):
        first, later = q[:, :20], q[:, k : k + 20]
        np.testing.assert_allclose(products[:, k], np.mean(first * later, axis=(1, 2)), rtol=1e-12)
        np.testing.assert_allclose(sums[:, k], np.mean(first + later, axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(means[:, 0], q.mean(axis=(1, 2)), rtol=1e-12)


def test_the_mean_of_a_system_with_one_stop_is_no_part_of_its_autocovariance() -> None:
    # The phase-space solution is the judge; E q is −0.11, and σ_q 0.42.
    system = System([2.0], [1.0], [0.4], [0.1], contacts=(Contact(1, "right", 10.0, 0.3),))
    answer = curve("correlation", system, 0, LAGS, time=100.0)
    expected = curve("correlation", system, 0, LAGS, route="phase-space")
    assert answer.certificate.certified
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors + expected.errors)
    assert np.max(np.abs(answer.values + 0.11**2 - expected.values) / answer.errors) > Z
    assert answer.settings["coarse dt"] == 2.0 * answer.settings["dt"]


def test_an_autocovariance_is_sampled_within_the_periods_between_stops() -> None:
    # The spring between the stops is 1e4 times that of the system, its period a hundredth.
    stop, at = Contact(1, "both", 1.0, 0.0, law="bilinear"), np.array([0.0, 1.5, 3.0, 9.0])
    held, free = System([1.0], [1e-4], [0.2], [0.5], contacts=(stop,)), [1.0001]
    answer = curve("correlation", held, 0, at, time=50.0)
    right = curve("correlation", System([1.0], free, [0.2], [0.5]), 0, at, route="linear")
    assert answer.certificate.certified and np.all(answer.errors < 0.1)
    assert np.all(np.abs(answer.values - right.values) < 5.0 * answer.errors)


def test_products_begin_in_less_time_where_memory_ends_them(monkeypatch: Any) -> None:
    system = System([1.0], [1.0], [0.002], [0.001])
    monkeypatch.setattr("sim.questions.curves.MOST_SUMS", 1 << 16)
    answer = curve("correlation", system, 0, LAGS)
    expected = curve("correlation", system, 0, LAGS, route="linear")
    assert answer.settings["time"] < 200.0 < 20.0 / 0.001
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)


def test_too_few_blocks_to_take_an_error_from_are_not_certified(monkeypatch: Any) -> None:
    monkeypatch.setattr("sim.questions.rounds.MOST_SUMS", 1)
    for all_at_once in ("MOST_STEPS", "MOST_SAMPLES"):
        monkeypatch.setattr(f"sim.questions.rounds.{all_at_once}", 1 << 60)
    answer = curve("correlation", linear(1), 0, LAGS, time=100.0, seconds=1e-9)
    assert answer.settings["paths"] == 2 * 128
    assert answer.certificate.failures == ("it ended after 256 trajectories of 4096",)


def test_in_units_far_from_one_the_variance_is_that_of_equipartition() -> None:
    # kT/k = 1e90/1e60/1e60; without balance of the flow 6 % off, 40 errors, and certified.
    answer = curve("correlation", System([1e60], [1e60], [1e60], [1e90]), 0, [0.0], time=100.0)
    assert answer.certificate.certified and abs(answer.values[0] - 1e-30) < Z * answer.errors[0]
    assert Z * answer.errors[0] < 0.06e-30


@pytest.mark.parametrize(
    ("question", "at", "settings", "words"),
    [
        *(("correlation", [0.0, lag], {}, r"^at = ") for lag in (-1.0, np.nan, 1e9)),
        ("spectrum", np.linspace(1.0, 2.0, 1025), {}, "ask for 1024"),
        ("spectrum", [0.0], {"seconds": 1e-9}, "first 4096 windows"),
        ("correlation", [0.0], {"seconds": 1e-9}, "first 4096 windows"),
    ],
)
def test_what_cannot_be_answered_is_refused(question: str, at, settings, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        curve(question, linear(1), 0, at, **settings)
    with pytest.raises(NotApplicable, match="not damped"):
        curve(question, System([1.0], [1.0], [0.0], [0.1]), 0, [0.0])


def test_chunks_of_unequal_lengths_or_cut_short_show_no_drift(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # 30 steps in 20 chunks: of lengths 1 and 2 the first one would be by half below the rest.
    answer = curve("crossings", linear(1), 0, [0.0], dt=0.25, time=7.5)
    assert answer.certificate.certified, answer.certificate.failures
    with monkeypatch.context() as clock:
        slow_clock(clock)
        answer = curve("crossings", fig6(), 0, [0.0], seconds=2.5, dt=0.02)
    assert not any("drift by" in words for words in answer.certificate.failures)
    # A burn-in of 2e10 time units is one step; the rest ends within the first chunk or after it.
    answer = curve("crossings", System([1.0], [1.0], [1e-9], [1e-9]), 0, [0.0], seconds=0.1)
    (words,) = answer.certificate.failures
    assert "first chunk" in words or "second chunk" in words
    assert abs(answer.values[0] - 0.5 / np.pi) < 4.5 * answer.errors[0]
