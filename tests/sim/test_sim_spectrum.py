"""Power spectra by simulation: exact ones of linear scenes, leakage, folding."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from sim_systems import exact, linear

from cases.compare.routes import method_for
from fpk.answer.dynamics import Curve
from fpk.answer.method import silent
from fpk.answer.names import Coordinate
from fpk.system.contact import Contact
from fpk.system.linear import drift_matrix, stationary_covariance
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

Z = 4.5
"""|z| that chance explains: of 25 frequencies 2e-4."""


def sampled(system: System, row: int, at: Any, **settings: Any) -> Curve:
    method = MonteCarlo(**({"threads": 1, "paths": 4096} | settings))
    return method.spectrum(
        system, (Coordinate("q", row),), np.asarray(at), tol=None, progress=silent
    )


def by_method(name: str, system: System, row: int, at: Any) -> Any:
    return method_for(name, None).spectrum(
        system, (Coordinate("q", row),), at, tol=None, progress=silent
    )


@pytest.mark.parametrize("masses", [1, 2])
def test_a_linear_system_has_its_transfer_function(masses: int) -> None:
    system, at = linear(masses), np.linspace(0.0, 3.0, 25)
    answer, expected = sampled(system, masses - 1, at), by_method("linear", system, masses - 1, at)
    assert answer.certificate.certified and answer.error_kind == "sampling"
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)
    assert np.all(answer.errors < 0.05 * expected.values)
    wrong = by_method("linear", linear(masses + 1), masses - 1, at)
    assert np.max(np.abs(answer.values - wrong.values) / answer.errors) > Z
    both = sampled(system, masses - 1, [-1.0, 1.0])
    assert both.values[0] == both.values[1]


def windowed(system: System, row: int, omega: float, spacing: float, length: int) -> float:
    """What a Hann window of ``length`` samples makes of the exact spectrum: E |Σ w q e^(−iωt)|²."""
    C, A = stationary_covariance(system), drift_matrix(system)
    one, state, covariance = expm(A * spacing), C, np.zeros(length)
    for k in range(length):
        covariance[k] = state[row, row]
        state = one @ state
    w = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    overlap = np.correlate(w, w, "full")[length - 1 :]
    terms = overlap * covariance * np.cos(omega * spacing * np.arange(length))
    total = 2.0 * float(np.sum(terms)) - float(terms[0])
    return spacing * total / (2.0 * np.pi * float(np.sum(w**2)))


def test_leakage_is_what_the_windows_make_of_the_exact_spectrum_and_is_corrected() -> None:
    # A window of 20 decay times flattens the peak by some 3 %, one of 10 by 10 %.
    system, omega, decay = linear(1), 1.0, 20.0
    answer = sampled(system, 0, [omega], time=20.0 * decay, paths=16384)
    (expected,) = by_method("linear", system, 0, np.array([omega])).values
    spacing = float(answer.settings["sampled every"])
    length = round(float(answer.settings["window"]) / spacing)
    whole, half = (windowed(system, 0, omega, spacing, many) for many in (length, length // 2))
    leakage = (whole - half) / 3.0
    assert 0.02 < 1.0 - whole / expected < 0.05 and leakage / expected > 0.01
    # One error of a power is 1/√16384 of it; the difference of correlated ones has less.
    assert abs(answer.settings["largest leakage"] - leakage) < Z * expected / 128.0
    assert abs(answer.values[0] - whole - leakage) < Z * expected / 128.0 * 1.4
    assert answer.errors[0] >= answer.settings["largest leakage"]
    assert abs(answer.values[0] - expected) < Z * answer.errors[0]


@pytest.mark.slow
def test_the_mean_of_a_system_with_one_stop_is_no_part_of_its_spectrum() -> None:
    # exp(−2 H) is exact here; its phase-space solution is the judge, near ω = 0 too.
    system = System(
        [1.0], [1.0], [0.2], [0.1], contacts=(Contact(1, "right", 10.0, 0.2),)
    )  # fmt: skip
    at = np.array([0.0, 0.1, 0.5, 1.0, 1.3, 2.0, 3.0])
    answer, expected = sampled(system, 0, at), by_method("phase-space", system, 0, at)
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)


@pytest.mark.slow
def test_two_masses_with_contact_have_the_spectrum_of_phase_space() -> None:
    at = np.array([0.2, 0.6, 1.0, 1.6, 2.0])
    answer, expected = sampled(exact(), 1, at), by_method("phase-space", exact(), 1, at)
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors + expected.errors)


def test_the_same_for_any_threads_and_a_tolerance_is_met_or_not_certified() -> None:
    at = [0.5, 1.0]
    one, two = (sampled(linear(1), 0, at, time=100.0, threads=k) for k in (1, 2))
    np.testing.assert_array_equal(one.values, two.values)
    method = MonteCarlo(paths=4096, threads=1, time=100.0, longest=0.2)
    short = method.spectrum(
        linear(1), (Coordinate("q", 0),), np.array(at), tol=1e-6, progress=silent
    )
    assert any("exceeds the tolerance" in words for words in short.certificate.failures)
