"""Transient densities of the full system by simulation, against exact ones."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from sim_systems import exact, fig6, linear

from cases.compare.routes import method_for
from fpk.answer.dynamics import Transient
from fpk.answer.method import silent
from fpk.answer.names import parse_observable, parse_start
from fpk.numeric.errors import InvalidInput
from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.step.schemes import flow_covariance

Z = 4.5
"""|z| that chance explains: of some 40 points 3e-4."""


def sampled(
    system: System, of: str, start: str, times: Any, *at: Any, tol: float | None = None,
    **settings: Any,
) -> Transient:  # fmt: skip
    method = MonteCarlo(**({"threads": 1, "paths": 4096} | settings))
    return method.transient(
        system,
        parse_observable(of, system.n),
        parse_start(start, system),
        np.array(times, dtype=float),
        tuple(np.asarray(x, dtype=float) for x in at),
        tol=tol,
        progress=silent,
    )


def gaussian(system: System, t: float, start: Any) -> Any:
    """Mean and covariance of (q, p) at t from a state."""
    A, C = flow_covariance(drift_matrix(system), diffusion_matrix(system), t)
    return A @ np.asarray(start), C


def test_a_linear_system_from_a_state_is_gaussian_at_any_time() -> None:
    system, times = linear(2), [0.1, 2.0, 40.0]
    x = np.linspace(-1.5, 1.5, 13)
    answer = sampled(system, "q2", "q1=0.5,p2=0.2", times, x)
    assert answer.certificate.certified and answer.error_kind == "sampling"
    assert answer.values.shape == (3, 13)
    for k, t in enumerate(times):
        mean, C = gaussian(system, t, [0.5, 0.0, 0.0, 0.2])
        expected = norm(mean[1], np.sqrt(C[1, 1])).pdf(x)
        assert np.all(np.abs(answer.values[k] - expected) < Z * answer.errors[k])
        if t > 1.0:  # at 0.1 all of it is between two points
            wrong = norm(mean[1] + 0.2 * np.sqrt(C[1, 1]), np.sqrt(C[1, 1])).pdf(x)
            assert np.max(np.abs(answer.values[k] - wrong) / answer.errors[k]) > Z


def test_a_pair_of_a_linear_system_from_rest() -> None:
    system = linear(1)
    q, p = np.meshgrid(np.linspace(-0.8, 0.8, 5), np.linspace(-0.8, 0.8, 5))
    answer = sampled(system, "q1,p1", "rest", [3.0], q.ravel(), p.ravel())
    _, C = gaussian(system, 3.0, [0.0, 0.0])
    x = np.stack([q.ravel(), p.ravel()])
    square = np.einsum("ik,ij,jk->k", x, np.linalg.inv(C), x)
    expected = np.exp(-0.5 * square) / (2.0 * np.pi * np.sqrt(np.linalg.det(C)))
    assert np.all(np.abs(answer.values[0] - expected) < Z * answer.errors[0])


@pytest.mark.parametrize("start", ["noise=1", "H=0.4", "rest"])
def test_with_contact_it_ends_in_the_stationary_density(start: str) -> None:
    # After 20 of the slowest decay times, and from it (noise = 1) at any time.
    system, at = exact(), np.linspace(-0.8, 0.8, 9)
    time = 1.0 if start == "noise=1" else 150.0
    answer = sampled(system, "q2", start, [time], at)
    (density,) = method_for("exact", None).solve(system, [parse_observable("q2", 2)]).densities
    assert np.all(np.abs(answer.values[0] - density.at(at)[0]) < Z * answer.errors[0])
    other = exact(clearance=0.8)
    (wrong,) = method_for("exact", None).solve(other, [parse_observable("q2", 2)]).densities
    assert np.max(np.abs(answer.values[0] - wrong.at(at)[0]) / answer.errors[0]) > Z


def test_times_between_steps_and_the_number_of_times_change_nothing_but_chance() -> None:
    # The step is cut at every time that is asked for; both answers have their own steps.
    at = np.linspace(-0.6, 0.6, 7)
    alone = sampled(fig6(), "q2", "q2=0.45", [3.21], at)
    among = sampled(fig6(), "q2", "q2=0.45", [0.01, 0.5, 1.2345, 3.21], at, seed=5)
    error = np.hypot(alone.errors[0], among.errors[-1])
    assert np.all(np.abs(alone.values[0] - among.values[-1]) < Z * error)


def test_a_narrow_density_of_the_energy_is_resolved() -> None:
    # At t the energy of a shell E has moved by √(2 D ⟨v²⟩ t), of 2 % of E here, and its density has
    # no kink but that: Gaussian but for O(t). Judged by its integral and its width to 5 %.
    system, E, t = linear(1), 0.5, 0.002
    width = np.sqrt(2.0 * 0.05 * E * t)
    x = E + np.linspace(-4.0, 4.0, 81) * width
    answer = sampled(system, "H", f"H={E}", [t], x)
    mass = float(np.sum(answer.values[0]) * (x[1] - x[0]))
    second = float(np.sum(answer.values[0] * (x - E) ** 2) * (x[1] - x[0]))
    assert mass == pytest.approx(1.0, abs=0.02)
    assert np.sqrt(second) == pytest.approx(width, rel=0.05)


def test_the_same_for_any_threads_and_a_tolerance_takes_more() -> None:
    at = np.array([0.0, 0.2])
    one, two = (sampled(fig6(), "q2", "rest", [5.0], at, threads=k) for k in (1, 2))
    np.testing.assert_array_equal(one.values, two.values)
    finer = sampled(linear(1), "q1", "rest", [5.0], at, tol=0.008)
    assert finer.certificate.certified
    assert int(finer.settings["trajectories"]) > int(one.settings["trajectories"])
    never = sampled(linear(1), "q1", "rest", [5.0], at, tol=1e-4, longest=0.3)
    assert any("exceeds the tolerance" in words for words in never.certificate.failures)


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("ascend", {"times": [2.0, 1.0]}),
        ("ascend", {"times": [np.nan]}),
        ("one value at t = 0", {"times": [0.0]}),
        ("one value at t = 0", {"of": "H", "start": "H=0.3", "times": [0.0]}),
        ("exact_flow", {"scheme": "baoab"}),
    ],
)
def test_bad_input_is_one_line(words: str, change: dict[str, Any]) -> None:
    asked: Any = {"of": "q2", "start": "rest", "times": [1.0]} | change
    with pytest.raises(InvalidInput, match=words) as error:
        sampled(fig6(), asked.pop("of"), asked.pop("start"), asked.pop("times"), [0.0], **asked)
    assert "\n" not in str(error.value)
