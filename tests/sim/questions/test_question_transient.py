"""Transient densities of the full system by simulation, against exact ones; their resolution."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from asked import assert_refused
from scipy.linalg import block_diag
from scipy.special import i0e
from scipy.stats import norm
from sim_systems import exact, exact_density, fig6, linear, transient

from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.system.contact import Contact
from fpk.system.linear import diffusion_matrix, drift_matrix, flow_covariance, natural_modes
from fpk.system.system import System

Z = 4.5
"""|z| that chance explains: of some 40 points 3e-4, of 100 1e-3."""


def gaussian(system: System, t: float, start: Any) -> Any:
    """Mean and covariance of (q, p) at t from a state."""
    A, C = flow_covariance(drift_matrix(system), diffusion_matrix(system), t)
    return A @ np.asarray(start), C


def test_a_linear_system_from_a_state_is_gaussian_at_any_time() -> None:
    system, times = linear(2), [0.1, 2.0, 40.0]
    x = np.linspace(-1.5, 1.5, 13)
    answer = transient(system, "q2", "q1=0.5,p2=0.2", times, x)
    assert answer.certificate.certified and answer.error_kind == "sampling"
    assert answer.values.shape == (3, 13)
    for k, t in enumerate(times):
        mean, C = gaussian(system, t, [0.5, 0.0, 0.0, 0.2])
        s = np.sqrt(C[1, 1])
        off = np.abs(answer.values[k] - norm(mean[1], s).pdf(x)) / answer.errors[k]
        wrong = np.abs(answer.values[k] - norm(mean[1] + 0.2 * s, s).pdf(x)) / answer.errors[k]
        assert np.all(off < Z) and (t < 1.0 or np.max(wrong) > Z)  # at 0.1 it is between two points


def test_a_pair_of_a_linear_system_from_rest() -> None:
    grid = np.linspace(-0.8, 0.8, 5)
    x = np.stack([a.ravel() for a in np.meshgrid(grid, grid)])
    answer = transient(linear(1), "q1,p1", "rest", [3.0], *x)
    _, C = gaussian(linear(1), 3.0, [0.0, 0.0])
    square = np.einsum("ik,ij,jk->k", x, np.linalg.inv(C), x)
    expected = np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(np.linalg.det(C)))
    assert np.all(np.abs(answer.values[0] - expected) < Z * answer.errors[0])


@pytest.mark.parametrize("start", ["noise=1", "H=0.4"])
def test_with_contact_it_ends_in_the_stationary_density(start: str) -> None:
    # After 20 of the slowest decay times, and from it (noise = 1) at any time.
    at, time = np.linspace(-0.8, 0.8, 9), 1.0 if start == "noise=1" else 150.0
    answer = transient(exact(), "q2", start, [time], at)
    z = []
    for system in (exact(), exact(clearance=0.8)):
        right = exact_density(system, "q2")(at)
        z.append(np.max(np.abs(answer.values[0] - right) / answer.errors[0]))
    assert z[0] < Z < z[1]


def test_a_narrow_density_of_the_energy_is_resolved() -> None:
    # At t the energy of a shell E has moved by √(2 D ⟨v²⟩ t), of 2 % of E here, and its density has
    # no kink but that: Gaussian but for O(t). Judged by its integral and its width to 5 %.
    E, t = 0.5, 0.002
    width = np.sqrt(2.0 * 0.05 * E * t)
    x = E + np.linspace(-4.0, 4.0, 81) * width
    p = transient(linear(1), "H", f"H={E}", [t], x).values[0] * (x[1] - x[0])
    assert float(np.sum(p)) == pytest.approx(1.0, abs=0.02)
    assert np.sqrt(np.sum(p * (x - E) ** 2)) == pytest.approx(width, rel=0.05)


def test_undamped_motion_against_a_stop_has_a_transient() -> None:
    # Of kT = ∞ no step follows, nor from the 1e5 periods of rest: from the energy by then it does.
    stop = Contact(1, "both", 2.0, 0.0, law="bilinear")  # always touched: a spring
    held, free = (
        System([1.0], [k], [0.0], [0.5], contacts=c) for k, c in ((1e-8, (stop,)), (2, ()))
    )
    at, times = np.linspace(-1.0, 1.0, 5), [0.5, 3.0]
    answer = transient(held, "q1", "rest", times, at, paths=8192)
    for k, t in enumerate(times):
        right = norm.pdf(at, scale=np.sqrt(gaussian(free, t, [0.0, 0.0])[1][0, 0]))
        assert np.all(np.abs(answer.values[k] - right) < 5.0 * answer.errors[k])
    assert answer.certificate.certified and np.all(answer.errors < 0.1)


def test_the_same_for_any_threads_and_a_tolerance_takes_more() -> None:
    at = np.array([0.0, 0.2])
    one, two = (transient(fig6(), "q2", "rest", [5.0], at, threads=k) for k in (1, 2))
    np.testing.assert_array_equal(one.values, two.values)
    finer = transient(linear(1), "q1", "rest", [5.0], at, tol=0.008)
    assert finer.certificate.certified
    assert int(finer.settings["trajectories"]) > int(one.settings["trajectories"])
    never = transient(linear(1), "q1", "rest", [5.0], at, tol=1e-4, longest=0.3)
    assert any("exceeds the tolerance" in words for words in never.certificate.failures)


def test_bad_input_is_one_line() -> None:
    for words, change in (
        ("ascend", {"times": [2.0, 1.0]}),
        ("ascend", {"times": [np.nan]}),
        ("one value at t = 0", {"times": [0.0]}),
        ("one value at t = 0", {"of": "H", "start": "H=0.3", "times": [0.0]}),
        ("exact_flow", {"scheme": "baoab"}),
    ):
        asked: Any = {"of": "q2", "start": "rest", "times": [1.0]} | change
        own = [asked.pop(name) for name in ("of", "start", "times")]
        assert_refused(InvalidInput, words, partial(transient, **asked), fig6(), *own, [0.0])


def energy_density(system: System, t: float, E: Array) -> Array:
    """p(H) of one mass at rest before, m = k = 1: 2 H = a x² + b y², x and y standard normals.

    a and b are the eigenvalues of the covariance of (q, p).
    """
    C = gaussian(system, t, [0.0, 0.0])[1]
    middle, product = 0.5 * np.trace(C), np.linalg.det(C)
    a = middle + np.sqrt(middle**2 - product)
    b = product / a
    return np.asarray(np.exp(-E / a) * i0e(0.5 * (1.0 / b - 1.0 / a) * E) / np.sqrt(a * b))


@pytest.mark.parametrize("t", [1e-9, 0.3])
def test_a_spike_of_the_energy_has_an_error(t: float) -> None:
    # At early times p(H) ~ H^(−1/2) down to H ~ D t³, where it ends at √3/(D t²).
    x = 0.1 * t * np.concatenate([[0.0, 1e-9, 1e-5], np.linspace(1e-3, 0.1, 30)])
    answer = transient(linear(1), "H", "rest", [t], x, paths=8192)
    right, error = energy_density(linear(1), t, x), answer.errors[0]
    assert np.all(np.abs(answer.values[0] - right) < Z * error)
    assert answer.certificate.certified and np.all(error[-5:] < 0.1 * right[-5:])


def test_energies_of_two_masses_have_an_error_at_a_spike_and_at_rest() -> None:
    """p(0, 0) = 1/(ω₁ ω₂ √det C), C the covariance of the modes' displacements and momenta.

    p(H) ~ H vanishes at H = 0, in far less than a bin: 5 standard errors above 0 by bins alone.
    """
    system, times = linear(2), [1e-3, 30.0]
    shapes, omega = natural_modes(system)
    to_modes = block_diag(shapes.T * system.mass, shapes.T)
    for t in times:
        C = to_modes @ gaussian(system, t, [0.0] * 4)[1] @ to_modes.T
        right = 1.0 / (np.prod(omega) * np.sqrt(np.linalg.det(C)))
        answer = transient(system, "H1,H2", "rest", [t], [0.0], [0.0])
        assert abs(answer.values[0, 0] - right) < Z * answer.errors[0, 0]
    assert answer.errors[0, 0] < 0.2 * right
    answer = transient(system, "H", "rest", times, [0.0], paths=8192)
    assert np.all(np.abs(answer.values) < Z * answer.errors)
