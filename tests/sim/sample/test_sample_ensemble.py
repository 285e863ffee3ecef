"""Ensembles: bitwise the same however they are run, begun where it is said, only what is asked."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sim_systems import fig6, limit_cycle, linear, mixed, ranged
from test_step_damping import HARDENED

from fpk.answer.names import Coordinate
from fpk.numeric.compiling import ROOT
from fpk.numeric.errors import NotApplicable
from fpk.system.system import System
from sim.sample.diagnostics import moment_products
from sim.sample.ensemble import Ensemble, ensemble_from
from sim.sample.plan import observation_arrays, step_arrays
from sim.sample.workers import program_checksum, workers_of
from sim.step.arrays import LANES, in_rows
from sim.step.kernel import COMPILED, KernelKey, kernel_checksum
from sim.step.schemes import SCHEMES

EXACT_FLOW = SCHEMES["exact_flow"]
LONGER = replace(EXACT_FLOW, small=8)
H = (Coordinate("H"),)
RUNS = {
    "mixed": (mixed, EXACT_FLOW, 0.1, ("q1", "p3", "H", "q3,p3")),
    "long steps": (lambda: fig6(stiffness=1e3), LONGER, 0.16, ("q2", "p2", "q2,p2")),
    "terms": (lambda: HARDENED, EXACT_FLOW, 0.1, ("H",)),
}


def run(name: str, threads: int, chunks: tuple[int, ...], paths: int = 5 * LANES - 17) -> Ensemble:
    make, scheme, dt, names = RUNS[name]
    system = make()
    ensemble = Ensemble(system, scheme, dt, paths, 31, threads)
    products = moment_products(system.n, terms=bool(system.damping_terms))
    ensemble.watch(ranged(system, names) if names else (), products)
    ensemble.advance(20, stride=0)
    for steps in chunks:
        ensemble.advance(steps, stride=3)
    return ensemble


@pytest.mark.parametrize("name", RUNS)
def test_bitwise_the_same_for_any_threads_chunks_and_number_of_paths(name: str) -> None:
    reference = run(name, 1, (30, 30))
    for threads, chunks in ((1, (60,)), (2, (1, 7, 20, 32))):
        other = run(name, threads, chunks)
        np.testing.assert_array_equal(reference.states, other.states)
        np.testing.assert_array_equal(reference.counts, other.counts)
        np.testing.assert_array_equal(reference.batch_means(), other.batch_means())
        assert reference.samples == other.samples == 20
    # Dead lanes are not counted, and more paths change none.
    assert reference.counts.sum() == len(RUNS[name][3]) * 20 * reference.paths
    more = run(name, 1, (60,), 9 * LANES).phase_points()[0]
    np.testing.assert_array_equal(more[: reference.paths], reference.phase_points()[0])


def test_what_is_not_in_the_scene_is_not_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a law was compiled")

    monkeypatch.setattr("sim.step.kernel.compile_laws", refuse)
    system = linear(2)
    step = Ensemble(system, EXACT_FLOW, 0.5, 2 * LANES, 1, 1).step
    assert observation_arrays(system, EXACT_FLOW, step, (), ())[0] == KernelKey()
    assert step.stop_slot.size == step.slot_mass.size == 0 and step.maps == 1
    for name, energy in (("q2", False), ("p1", False), ("H", True)):
        key, _ = observation_arrays(system, EXACT_FLOW, step, ranged(system, [name]), ())
        assert key == KernelKey(energy=energy)
    step = step_arrays(fig6(), EXACT_FLOW, 0.1)
    assert observation_arrays(fig6(), EXACT_FLOW, step, (), ())[0] == KernelKey(laws=("hertz",))
    # A stop that is equal on both sides is evaluated once.
    assert step.stops[:, 0].tolist() == [0.0]
    assert step_arrays(mixed(), EXACT_FLOW, 0.1).stops[:, 0].tolist() == [1, 0, -1]


def test_an_edit_changes_the_checksums_of_what_depends_on_it(tmp_path: Path) -> None:
    """Of compiled files both, of others in any room that of the program, by which the workers of a
    cluster are held to run the same one; a missing file is an error."""
    for room in ("sim", "fpk", "averaging", "cases"):
        shutil.copytree(ROOT / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))

    def checksums(root: Path) -> tuple[int, int]:
        return kernel_checksum(("hertz",), root), program_checksum(root)

    assert checksums(tmp_path) == checksums(ROOT)
    for name, compiled in (
        ("sim/step/forces.py", True),
        ("fpk/system/laws/hertz.py", True),
        ("fpk/system/laws/power.py", False),
        *((f"{room}/__init__.py", False) for room in ("sim", "averaging", "cases")),
    ):
        before = checksums(tmp_path)
        with (tmp_path / name).open("a") as file:
            file.write("\n# edited\n")
        after = checksums(tmp_path)
        assert (after[0] != before[0]) == compiled and after[1] != before[1]
    (tmp_path / "sim/step/random.py").unlink()
    with pytest.raises(FileNotFoundError):
        kernel_checksum(("hertz",), tmp_path)
    with pytest.raises(FileNotFoundError):
        program_checksum(tmp_path / "nowhere")


def test_whatever_is_compiled_is_in_the_checksum() -> None:
    files = {ROOT / name for name in COMPILED}
    sources = {p: p.read_text("utf-8") for p in (ROOT / "sim").rglob("*.py")}
    decorated = re.compile(r"@(njit\(|njit_inline|cached_njit\()")
    compiled = {p for p, text in sources.items() if decorated.search(text)}
    assert len(compiled) == 6 and compiled <= files <= set(sources)


SECOND_PROCESS = """
import sys
import sim
from fpk.answer.method import ROUTES
assert ROUTES["montecarlo", "simulation"].make() == sim.MonteCarlo()
print([name for name in ("numba", "distributed", "sim.step.kernel") if name in sys.modules])
from sim.sample.ensemble import Ensemble
from sim.step.kernel import kernel_for
from sim.step.schemes import SCHEMES
from sim_systems import fig6
e = Ensemble(fig6(), SCHEMES["exact_flow"], 0.2, 128, 1, 1)
e.advance(2)
stats = kernel_for(e._key).stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def test_importing_the_room_compiles_nothing_and_a_second_process_finds_the_kernel() -> None:
    rooms = ("", "tests", "tests/averaging", "tests/sim")
    path = os.pathsep.join(str(ROOT / room) for room in rooms)
    for _ in range(2):  # the first may compile: this process need not have the cache of others
        done = subprocess.run(
            [sys.executable, "-c", SECOND_PROCESS],
            env={**os.environ, "PYTHONPATH": path}, cwd=ROOT, capture_output=True, text=True,
        )  # fmt: skip
    assert (done.stdout, done.stderr) == ("[]\n1 0\n", "")


def states(system: System, size: float = 0.6) -> Any:
    return size * np.random.default_rng(1).normal(size=(2, 3 * LANES, system.n))


@pytest.mark.parametrize("system", [linear(), fig6(), mixed(), limit_cycle()])
def test_the_first_observed_state_is_the_start(system: System) -> None:
    q, p = states(system)
    first = in_rows(ensemble_from(system, q, p, 0.03, 1, energies=H).last)
    assert first[:, : system.n] == pytest.approx(q, abs=1e-12)
    assert first[:, system.n : 2 * system.n] == pytest.approx(p, abs=1e-12)
    assert first[:, -1] == pytest.approx(system.hamiltonian(q, p), rel=1e-11)


def test_a_step_that_begins_in_no_start_is_refused() -> None:
    with pytest.raises(NotApplicable, match="use a smaller dt"):
        ensemble_from(fig6(), *states(fig6(), 8.0), 0.6, 1)


def test_halved_steps_are_the_same_motion_but_for_the_error_of_the_step() -> None:
    # Exactly so without contact; with it the kicks differ by O(dt²), 4 to 1 in a short time.
    def apart(system: System, dt: float) -> float:
        start = states(system)
        fine = ensemble_from(system, *start, 0.5 * dt, 1)
        coarse = ensemble_from(system, *start, dt, 1, halved=True)
        for motion, many in ((fine, 2), (coarse, 1)):
            motion.advance(many * round(1.0 / dt))
        assert (fine.time, fine.next_word) == (coarse.time, coarse.next_word)
        return float(np.sqrt(np.mean((fine.last - coarse.last) ** 2)))

    assert apart(linear(), 0.25) < 1e-13
    assert 3.0 * apart(fig6(), 0.0625) < apart(fig6(), 0.125) < 2e-3


def record(trace: Any, samples: int, done: int, rows: Any) -> None:
    rows[:, done + 1 : done + samples + 1] = trace[:, 1 : samples + 1, 0]


def test_motions_are_bitwise_the_same_for_any_threads_pieces_and_strides() -> None:
    system = mixed()
    start = states(system)

    def read(threads: int, parts: tuple[int, ...]) -> Any:
        with workers_of(None, threads) as workers:
            motion = ensemble_from(system, *start, 0.05, 3, energies=H, workers=workers)
            rows = np.zeros((3, 201, LANES))
            for part in parts:
                motion.advance(part, rows, read=record)
        return rows, motion

    rows, motion = read(1, (200,))
    for other in (read(2, (1, 63, 136)), read(3, (200,))):
        np.testing.assert_array_equal(rows, other[0])
    every = ensemble_from(system, *start, 0.05, 3, energies=H)
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
    motion = ensemble_from(fig6(), *states(fig6()), 0.05, 3, energies=H)
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
