"""Upcrossing rates by simulation: Rice's formula, the exact density with contact, the cubic."""

from typing import Any

import numpy as np
import pytest
from sim_systems import exact, fig6, linear

from cases.compare.routes import method_for
from fpk.answer.dynamics import Curve
from fpk.answer.method import silent
from fpk.answer.names import Coordinate
from fpk.numeric.errors import NotApplicable
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.passing import count_upcrossings
from sim.sample.ensemble import ensemble_from
from sim.step.arrays import LANES, in_blocks, in_rows

Z = 4.5
"""|z| that chance explains: of 11 levels, as if independent, 8e-5."""


def counted(system: System, row: int, at: Any, **settings: Any) -> Curve:
    method = MonteCarlo(**({"threads": 1, "paths": 4096} | settings))
    return method.crossings(
        system, (Coordinate("q", row),), np.asarray(at), tol=None, progress=silent
    )


def by_method(name: str, system: System, row: int, at: Any) -> Any:
    return method_for(name, None).crossings(
        system, (Coordinate("q", row),), at, tol=None, progress=silent
    )


@pytest.mark.parametrize("masses", [1, 3])
def test_a_linear_system_crosses_as_rice_says(masses: int) -> None:
    system, at = linear(masses), np.linspace(-2.0, 2.0, 11)
    answer, expected = counted(system, masses - 1, at), by_method("linear", system, masses - 1, at)
    assert answer.certificate.certified and answer.error_kind == "sampling"
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)
    middle = at.size // 2
    assert answer.errors[middle] < 0.005 * answer.values[middle]
    wrong = by_method("linear", linear(masses + 1), masses, at)
    assert np.max(np.abs(answer.values - wrong.values) / answer.errors) > Z


def test_what_the_noise_crosses_within_a_step_is_extrapolated() -> None:
    # Zero is crossed once a period 2π. Steps of 0.2 lose 0.7 % of that, those of 0.4 twice as much.
    system = System([1.0], [1.0], [0.5], [0.25])
    answer = counted(system, 0, [0.0], dt=0.4, paths=16384)
    off = answer.values[0] - 0.5 / np.pi
    bias = float(answer.settings["largest step bias"])
    sampling = np.sqrt(answer.errors[0] ** 2 - bias**2)
    assert bias > 6.0 * sampling > 0.0 and answer.errors[0] >= bias
    assert abs(off) < 4.0 * sampling


def test_with_contact_the_rates_are_those_of_the_exact_density() -> None:
    system, at = exact(), np.linspace(-0.8, 0.8, 9)
    answer = counted(system, 1, at)
    expected = by_method("exact", system, 1, at)
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors)
    free = by_method("exact", exact(clearance=0.55), 1, at)
    assert np.max(np.abs(answer.values - free.values) / answer.errors) > Z


@pytest.mark.slow
def test_with_contact_and_any_noise_the_rates_are_those_of_phase_space() -> None:
    system, at = fig6(), np.linspace(-0.8, 0.8, 9)
    answer = counted(system, 1, at)
    expected = by_method("phase-space", system, 1, at)
    assert np.all(np.abs(answer.values - expected.values) < Z * answer.errors + expected.errors)


def counts_of(dt: float, level: float, steps: int) -> tuple[float, float]:
    """Upcrossings a period by cosines of random phases: counted, and by the signs at the steps."""
    system = System([1.0], [1.0], [0.0], [1e-24])
    phase = np.random.default_rng(2).random((8 * LANES, 1)) * 2.0 * np.pi
    motion = ensemble_from(system, np.cos(phase), -np.sin(phase), dt, 1)
    counts, signs = np.zeros((8, 2), dtype=np.int64), 0
    for _ in range(steps):
        before = in_rows(motion.last)[:, 0]
        motion.advance(
            1, counts, read=lambda *a: count_upcrossings(*a, dt, 0, 1, 1.0, np.array([level]))
        )
        signs += np.count_nonzero((before < level) & (in_rows(motion.last)[:, 0] >= level))
    time = 8 * LANES * steps * dt
    return counts[:, 0].sum() / time * 2.0 * np.pi, signs / time * 2.0 * np.pi


def test_a_level_passed_up_and_down_within_a_step_is_counted() -> None:
    # cos crosses 0.97 upwards once a period and is above it for 0.08 of that: of steps of 1/7 the
    # signs see it with the chance 0.08 · 7 = 0.55. The cubic is 5e-4 off at most, (2π/7)⁴/384 at
    # its middle, which shifts the top by less than 1 − 0.97; counts are whole to a step of 1024.
    cubic, signs = counts_of(2.0 * np.pi / 7.0, 0.97, 70)
    assert cubic == pytest.approx(1.0, abs=0.005)
    assert signs == pytest.approx(7.0 * np.arccos(0.97) / np.pi, abs=0.05)


def test_any_cubic_is_counted_as_its_dense_samples() -> None:
    # Random ends and slopes: several turns within a step. Levels lie between samples by chance.
    rng = np.random.default_rng(7)
    q, p = rng.normal(size=(2, 2 * LANES)), 6.0 * rng.normal(size=(2, 2 * LANES))
    levels = np.linspace(-2.0, 2.0, 9)
    trace = np.stack(
        [np.stack([in_blocks(x[k][:, None])[:, 0] for x in (q, p)], axis=1) for k in (0, 1)], axis=1
    )
    counts = np.zeros((2, levels.size + 1), dtype=np.int64)
    count_upcrossings(trace, 1, 0, counts, 1.0, 0, 1, 1.0, levels)
    s = np.linspace(0.0, 1.0, 20001)[:, None]
    change = q[1] - q[0]
    path = q[0] + s * (p[0] + s * (3 * change - 2 * p[0] - p[1] + s * (p[0] + p[1] - 2 * change)))
    for m, level in enumerate(levels):
        dense = np.count_nonzero((path[:-1] < level) & (path[1:] >= level))
        assert abs(int(np.cumsum(counts, axis=1)[:, m].sum()) - dense) <= 1


def test_levels_in_any_order_and_the_same_for_any_threads() -> None:
    system = fig6()
    one = counted(system, 0, [0.1, -0.2, 0.1], time=20.0)
    two = counted(system, 0, [-0.2, 0.1, 0.1], time=20.0, threads=2)
    np.testing.assert_array_equal(one.values, two.values[[1, 0, 2]])
    np.testing.assert_array_equal(one.errors, two.errors[[1, 0, 2]])


def test_a_level_never_reached_has_the_error_of_one_visit() -> None:
    answer = counted(linear(1), 0, [40.0], time=20.0)
    assert answer.values[0] == 0.0
    assert answer.errors[0] == pytest.approx(1.0 / (4096 * 20.0), rel=0.05)


def test_too_large_an_error_and_too_short_a_burn_in_are_not_certified() -> None:
    method = MonteCarlo(paths=4096, threads=1, time=5.0, longest=0.5)
    answer = method.crossings(
        linear(1), (Coordinate("q", 0),), np.array([0.0]), tol=1e-5, progress=silent
    )
    assert any("exceeds the tolerance" in words for words in answer.certificate.failures)
    with pytest.raises(NotApplicable, match="not damped"):
        counted(System([1.0], [1.0], [0.0], [0.1]), 0, [0.0])
