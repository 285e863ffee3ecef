"""Motions: they begin where they are said to, and are the same however they are run."""

from typing import Any

import numpy as np
import pytest
from sim_systems import fig6, linear, mixed

from fpk.answer.names import Coordinate
from fpk.numeric.errors import NotApplicable
from fpk.system.damping import DampingTerm
from fpk.system.system import System
from sim.sample.ensemble import Ensemble, ensemble_from
from sim.sample.workers import workers_of
from sim.step.arrays import LANES, in_blocks, in_rows
from sim.step.schemes import SCHEMES

H = (Coordinate("H"),)


def with_terms() -> System:
    terms = (DampingTerm(1, 1, 0.05, q=((1, 2),)), DampingTerm(2, 2, 0.02, energy=1))
    base = fig6()
    return System(
        base.mass, base.stiffness, base.damping, base.noise_intensity, contacts=base.contacts,
        damping_terms=terms,
    )  # fmt: skip


def states(system: System, size: float = 0.6) -> Any:
    return size * np.random.default_rng(1).normal(size=(2, 3 * LANES, system.n))


@pytest.mark.parametrize("system", [linear(), fig6(), mixed(), with_terms()])
def test_the_first_observed_state_is_the_start(system: System) -> None:
    q, p = states(system)
    motion = ensemble_from(system, q, p, 0.03, 1, energies=H)
    first = in_rows(motion.last)
    assert first[:, : system.n] == pytest.approx(q, abs=1e-12)
    assert first[:, system.n : 2 * system.n] == pytest.approx(p, abs=1e-12)
    assert first[:, -1] == pytest.approx(system.hamiltonian(q, p), rel=1e-11)


def test_a_step_that_begins_in_no_start_is_refused() -> None:
    with pytest.raises(NotApplicable, match="use a smaller dt"):
        ensemble_from(fig6(), *states(fig6(), 8.0), 0.6, 1)


def test_halved_steps_are_the_same_motion_but_for_the_error_of_the_step() -> None:
    # Exactly so without contact; with it the kicks differ by O(dt²), 4 to 1 in a short time.
    def apart(system: System, dt: float) -> float:
        q, p = states(system)
        fine, coarse = (
            ensemble_from(system, q, p, 0.5 * dt, 1),
            ensemble_from(system, q, p, dt, 1, halved=True),
        )
        for motion, many in ((fine, 2), (coarse, 1)):
            motion.advance(many * round(1.0 / dt))
        assert (fine.time, fine.next_word) == (coarse.time, coarse.next_word)
        return float(np.sqrt(np.mean((fine.last - coarse.last) ** 2)))

    assert apart(linear(), 0.25) < 1e-13
    assert apart(fig6(), 0.125) < 2e-3
    assert apart(fig6(), 0.125) > 3.0 * apart(fig6(), 0.0625)


def record(trace: Any, samples: int, done: int, rows: Any) -> None:
    rows[:, done + 1 : done + samples + 1] = trace[:, 1 : samples + 1, 0]


def test_bitwise_the_same_for_any_threads_pieces_and_strides() -> None:
    system = mixed()
    q, p = states(system)

    def read(threads: int, parts: tuple[int, ...]) -> Any:
        with workers_of(None, threads) as workers:
            motion = ensemble_from(system, q, p, 0.05, 3, energies=H, workers=workers)
            rows = np.zeros((3, 201, LANES))
            for part in parts:
                motion.advance(part, rows, read=record)
        return rows, motion

    rows, motion = read(1, (200,))
    for other in (read(2, (1, 63, 136)), read(3, (200,))):
        np.testing.assert_array_equal(rows, other[0])
    every = ensemble_from(system, q, p, 0.05, 3, energies=H)
    every.advance(200, stride=25)
    np.testing.assert_array_equal(every.last, motion.last)
    resumed = ensemble_from(linear(), *states(linear()), 0.05, 3)
    resumed.advance(10)
    last = in_rows(resumed.last)
    on = ensemble_from(linear(), last[:, :2], last[:, 2:], 0.05, 3, word=resumed.next_word)
    for later in (resumed, on):
        later.advance(10)
    np.testing.assert_array_equal(resumed.last, on.last)


def test_lanes_that_are_kept_go_on_and_copies_part() -> None:
    system = fig6()
    motion = ensemble_from(system, *states(system), 0.05, 3, energies=H)
    motion.advance(5)
    before = in_rows(motion.last)
    motion.keep(np.array([7, 7, 200]))
    assert motion.last.shape[0] == 1
    np.testing.assert_array_equal(in_rows(motion.last)[:3], before[[7, 7, 200]])
    motion.advance(1)
    first = in_rows(motion.last)
    np.testing.assert_array_equal(first[0], first[1])  # the step that had been drawn
    motion.advance(1)
    later = in_rows(motion.last)
    assert np.all(later[0] != later[1])


def test_without_a_start_nothing_is_traced() -> None:
    ensemble = Ensemble(linear(), SCHEMES["exact_flow"], 0.5, 2 * LANES, 1, 1)
    assert ensemble.last.shape == (2, 0, LANES) and ensemble.step.maps == 1
    blocks = in_blocks(np.arange(2.0 * LANES)[:, None])
    assert blocks.shape == (2, 1, LANES) and in_rows(blocks)[-1, 0] == 2.0 * LANES - 1.0
