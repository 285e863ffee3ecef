"""Autocovariances by simulation: those of linear scenes, with contact, their mean, their sums."""

from typing import Any

import numpy as np
import pytest
from sim_systems import exact, fig6, linear

from cases.compare.routes import method_for
from fpk.answer.dynamics import Curve
from fpk.answer.method import silent
from fpk.answer.names import Coordinate
from fpk.numeric.errors import InvalidInput
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.curves import BEYOND, _curve, _products, _spline_error

Z = 4.5
"""|z| of 31 degrees of freedom and more that chance explains: of 12 lags 1e-3."""
AT = np.array([0.0, 0.05, 0.37, 1.0, 2.0, 3.3, 5.0, 7.3, 10.0, 20.0, 40.0])


def sampled(system: System, row: int, at: Any, **settings: Any) -> Curve:
    method = MonteCarlo(**({"threads": 1, "paths": 4096, "time": 100.0} | settings))
    return method.correlation(
        system, (Coordinate("q", row),), np.asarray(at), tol=None, progress=silent
    )


def by_method(name: str, system: System, row: int, at: Any) -> Any:
    method = method_for(name, threads=1)
    return method.correlation(system, (Coordinate("q", row),), at)


@pytest.mark.parametrize("masses", [1, 2])
def test_a_linear_system_has_the_exponential_of_its_drift(masses: int) -> None:
    system = linear(masses)
    answer, expected = sampled(system, masses - 1, AT), by_method("linear", system, masses - 1, AT)
    assert answer.certificate.certified and answer.error_kind == "sampling"
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)
    assert np.all(answer.errors < 0.02 * expected.values[0])
    wrong = by_method("linear", linear(masses + 1), masses - 1, AT)
    assert np.max(np.abs(answer.values - wrong.values) / answer.errors) > Z


@pytest.mark.parametrize("spacing", [0.1, 0.3, 0.6])
def test_the_spline_between_the_samples_is_as_good_as_it_says(spacing: float) -> None:
    # Exact products, ω = 1: the error of the spline falls as the fourth power of the spacing.
    system, lags = System([1.0], [1.0], [0.2], [0.1]), np.linspace(0.0, 20.0, 371)
    samples = spacing * np.arange(2 * np.ceil(10.0 / spacing) + BEYOND + 1)
    products = np.tile(by_method("linear", system, 0, samples).values, (2, 1))
    rounds = [(products, np.zeros_like(products), np.zeros((2, 1)))]
    exact_values = by_method("linear", system, 0, lags).values
    error = np.max(np.abs(_curve(rounds, spacing, lags)[0] - exact_values))
    assert error < _spline_error(rounds, spacing) < 4.0 * error


def test_lagged_products_are_those_of_their_definition() -> None:
    q = np.random.default_rng(20261123).normal(size=(2, 37, 128)) + 3.0
    products, sums, means = _products(q, 20)
    assert products.shape == sums.shape == (2, 18)
    for k in range(18):
        first, later = q[:, :20], q[:, k : k + 20]
        np.testing.assert_allclose(products[:, k], np.mean(first * later, axis=(1, 2)), rtol=1e-12)
        np.testing.assert_allclose(sums[:, k], np.mean(first + later, axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(means[:, 0], q.mean(axis=(1, 2)), rtol=1e-12)


def test_the_mean_of_a_system_with_one_stop_is_no_part_of_it() -> None:
    # The phase-space solution is the judge; E q is −0.11, and σ_q 0.42.
    system = System(
        [2.0], [1.0], [0.4], [0.1], contacts=(Contact(1, "right", 10.0, 0.3),)
    )  # fmt: skip
    answer, expected = sampled(system, 0, AT), by_method("phase-space", system, 0, AT)
    assert answer.certificate.certified
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors + expected.errors)
    assert np.max(np.abs(answer.values + 0.11**2 - expected.values) / answer.errors) > Z
    assert answer.settings["coarse dt"] == 2.0 * answer.settings["dt"]


@pytest.mark.slow
@pytest.mark.parametrize("system", [fig6(), exact()])
def test_two_masses_with_contact_have_the_autocovariance_of_phase_space(system: System) -> None:
    answer = sampled(system, 1, AT, time=None, paths=8192)
    expected = by_method("phase-space", system, 1, AT)
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors + expected.errors)
    free = by_method("phase-space", fig6(clearance=0.55), 1, AT)
    assert np.max(np.abs(answer.values - free.values) / answer.errors) > Z


def test_the_same_for_any_threads_and_a_tolerance_is_met_or_not_certified() -> None:
    one, two = (sampled(linear(1), 0, AT, threads=k) for k in (1, 2))
    np.testing.assert_array_equal(one.values, two.values)
    method = MonteCarlo(paths=4096, threads=1, time=100.0, longest=0.2)
    short = method.correlation(linear(1), (Coordinate("q", 0),), AT, tol=1e-6)
    assert any("exceeds the tolerance" in words for words in short.certificate.failures)


def test_products_begin_in_less_time_where_memory_ends_them(monkeypatch: Any) -> None:
    system = System([1.0], [1.0], [0.002], [0.001])
    monkeypatch.setattr("sim.questions.curves.MOST_SUMS", 1 << 16)
    answer, expected = sampled(system, 0, AT, time=None), by_method("linear", system, 0, AT)
    assert answer.settings["time"] < 200.0 < 20.0 / 0.001
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)


def test_too_few_blocks_to_take_an_error_from_are_not_certified(monkeypatch: Any) -> None:
    monkeypatch.setattr("sim.questions.rounds.MOST_SUMS", 1)
    for all_at_once in ("MOST_STEPS", "MOST_SAMPLES"):
        monkeypatch.setattr(f"sim.questions.rounds.{all_at_once}", 1 << 60)
    answer = sampled(linear(1), 0, AT, seconds=1e-9)
    assert answer.settings["paths"] == 2 * 128
    assert answer.certificate.failures == ("it ended after 256 trajectories of 4096",)


@pytest.mark.parametrize("lag", [-1.0, np.nan, 1e9])
def test_what_is_no_lag_or_too_long_is_refused(lag: float) -> None:
    with pytest.raises(InvalidInput, match=r"^at = "):
        sampled(linear(1), 0, [0.0, lag])


def test_in_units_far_from_one_the_variance_is_that_of_equipartition() -> None:
    # kT/k = 1e90/1e60/1e60; without balance of the flow 6 % off, 40 errors, and certified.
    answer = sampled(System([1e60], [1e60], [1e60], [1e90]), 0, [0.0])
    assert answer.certificate.certified and abs(answer.values[0] - 1e-30) < Z * answer.errors[0]
    assert Z * answer.errors[0] < 0.06e-30
