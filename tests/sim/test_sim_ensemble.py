"""Ensembles: bitwise the same however they are run, and only what is asked for."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sim_systems import fig6, linear, mixed, ranged

from fpk.answer.names import parse_observable
from fpk.numeric.compiling import ROOT
from sim.sample.diagnostics import moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.plan import step_arrays, watched
from sim.sample.workers import program_checksum
from sim.step.arrays import LANES
from sim.step.kernel import COMPILED, KernelKey, kernel_checksum
from sim.step.schemes import SCHEMES

EXACT_FLOW = SCHEMES["exact_flow"]


def run(threads: int, chunks: tuple[int, ...], paths: int = 5 * LANES - 17) -> Ensemble:
    system = mixed()
    ensemble = Ensemble(system, EXACT_FLOW, 0.1, paths, 31, threads)
    observables = [parse_observable(name, 3) for name in ("q1", "p3", "H", "q3,p3")]
    q = np.array([[-1.0] * 3, [1.0] * 3])
    ensemble.watch(ranged(system, observables, q, q), moment_products(3))
    for steps in chunks:
        ensemble.advance(steps, stride=3)
    return ensemble


@pytest.mark.parametrize(("threads", "chunks"), [(1, (60,)), (2, (1, 7, 20, 32)), (4, (60,))])
def test_bitwise_the_same_for_any_threads_and_chunks(threads: int, chunks: tuple[int, ...]) -> None:
    reference, other = run(1, (30, 30)), run(threads, chunks)
    np.testing.assert_array_equal(reference.states, other.states)
    np.testing.assert_array_equal(reference.counts, other.counts)
    np.testing.assert_array_equal(reference.batch_means(), other.batch_means())
    assert reference.samples == other.samples == 20


def test_dead_lanes_are_not_counted() -> None:
    ensemble = run(1, (60,))
    assert ensemble.counts.sum() == 4 * ensemble.samples * ensemble.paths
    more = run(1, (60,), 5 * LANES)
    q, _ = ensemble.phase_points()
    np.testing.assert_array_equal(q, more.phase_points()[0][: ensemble.paths])


def test_what_is_not_in_the_scene_is_not_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a law was compiled")

    monkeypatch.setattr("sim.step.kernel.compiled_laws", refuse)
    system = linear(2)
    ensemble = Ensemble(system, EXACT_FLOW, 0.5, 2 * LANES, 1, 1)
    assert watched(system, EXACT_FLOW, ensemble.step, (), ())[0] == KernelKey()
    assert ensemble.step.stop_slot.size == ensemble.step.slot_mass.size == 0
    q = np.array([[-1.0] * 2, [1.0] * 2])
    for name, energy in (("q2", False), ("p1", False), ("H", True)):
        h = ranged(system, [parse_observable(name, 2)], q, q)
        key = watched(system, EXACT_FLOW, ensemble.step, h, ())[0]
        assert key == KernelKey(energy=energy)
    step = step_arrays(fig6(), EXACT_FLOW, 0.1)
    assert watched(fig6(), EXACT_FLOW, step, (), ())[0].laws == ("hertz",)


def test_a_stop_equal_on_both_sides_is_evaluated_once() -> None:
    both = Ensemble(fig6(), EXACT_FLOW, 0.1, LANES, 1, 1).step
    assert both.stops[:, 0].tolist() == [0.0]
    assert Ensemble(mixed(), EXACT_FLOW, 0.1, LANES, 1, 1).step.stops[:, 0].tolist() == [1, 0, -1]


def test_an_edit_changes_the_checksums_of_what_depends_on_it(tmp_path: Path) -> None:
    """Of compiled files both, of others that of the program only; a missing file is an error."""
    for room in ("sim", "fpk"):
        shutil.copytree(ROOT / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))

    def checksums(root: Path) -> tuple[int, int]:
        return kernel_checksum(("hertz",), root), program_checksum(root)

    assert checksums(tmp_path) == checksums(ROOT)
    for name, compiled in (
        ("sim/step/forces.py", True),
        ("sim/step/lanes.py", True),
        ("fpk/system/laws/hertz.py", True),
        ("fpk/system/laws/power.py", False),
        ("sim/sample/diagnostics.py", False),
        ("fpk/system/damping.py", False),
    ):
        before = checksums(tmp_path)
        with (tmp_path / name).open("a") as file:
            file.write("\n# edited\n")
        after = checksums(tmp_path)
        assert (after[0] != before[0]) == compiled
        assert after[1] != before[1]
    (tmp_path / "sim/step/random.py").unlink()
    with pytest.raises(FileNotFoundError):
        kernel_checksum(("hertz",), tmp_path)
    with pytest.raises(FileNotFoundError):
        program_checksum(tmp_path / "nowhere")


def test_whatever_is_compiled_is_in_the_checksum() -> None:
    files = {ROOT / name for name in COMPILED}
    sources = {p: p.read_text("utf-8") for p in (ROOT / "sim").rglob("*.py")}
    decorated = re.compile(r"@(njit\(|inlined|cached_njit\()")
    compiled = {p for p, text in sources.items() if decorated.search(text)}
    assert len(compiled) == 6 and compiled <= files
    assert files <= set(sources)


SECOND_PROCESS = """
from sim.sample.ensemble import Ensemble
from sim.step.kernel import compiled_kernel
from sim.step.schemes import SCHEMES
from sim_systems import fig6
e = Ensemble(fig6(), SCHEMES["exact_flow"], 0.2, 128, 1, 1)
e.advance(2)
stats = compiled_kernel(e._key).stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def test_a_second_process_finds_the_kernel_in_the_disk_cache() -> None:
    Ensemble(fig6(), EXACT_FLOW, 0.2, LANES, 1, 1).advance(2)  # the first process is this one
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{root}/tests/sim"}
    done = subprocess.run(
        [sys.executable, "-c", SECOND_PROCESS],
        env=environment, cwd=root, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["1", "0"]
