"""A simulation that was killed goes on bitwise; damaged and foreign files are refused."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sim_systems import fig6

from fpk.answer.names import parse_observable
from fpk.numeric.errors import Unavailable
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import Report
from sim.sample.ensemble import Ensemble
from sim.sample.workers import Checkpoint, checkpoint_of, interruptible
from sim.step.arrays import LANES
from sim.step.schemes import SCHEMES

METHOD = MonteCarlo(paths=4096, time=2000.0, dt=0.2, seed=17, threads=1)
OBSERVABLES = [parse_observable(name, 2) for name in ("q2", "p1", "q2,p2")]

IN_PIECES = """
import sys
from pathlib import Path
import numpy as np
import sim.sample.workers
from dataclasses import replace
from test_sim_checkpoint import METHOD, OBSERVABLES, arrays_of
from sim_systems import fig6
sim.sample.workers.INTERVAL = float(sys.argv[3])
method = replace(METHOD, checkpoint=Path(sys.argv[1]), time=float(sys.argv[4]))
print("begun", flush=True)
sys.stdin.readline()
np.savez(sys.argv[2], **arrays_of(method.solve(fig6(), OBSERVABLES)))
"""


def arrays_of(result: Any) -> dict[str, Any]:
    """Everything that is found: densities of every batch, edges, means and what is said of them."""
    found = {}
    for k, density in enumerate(result.densities):
        found |= {f"values{k}": density.values, f"batches{k}": density.batch_values}
        found |= {f"edges{k}.{axis}": edges for axis, edges in enumerate(density.edges)}
        found[f"failures{k}"] = np.array(density.certificate.failures, dtype=str)
    clocks = {"ns_per_particle_step", "threads"}
    numbers = [v for k, v in result.settings.items() if k not in clocks and not isinstance(v, str)]
    return {**found, "numbers": np.array(numbers, dtype=float)}


def same(a: Any, b: Any) -> None:
    assert len(a) > 5
    same_arrays(a, b)


def same_arrays(a: Any, b: Any) -> None:
    assert set(a) == set(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def in_pieces(folder: Path, out: Path, time: float) -> "subprocess.Popen[str]":
    """A process that has imported all and simulates when it is sent a line."""
    tests = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": f"{tests.parents[1]}{os.pathsep}{tests}"}
    process = subprocess.Popen(
        [sys.executable, "-c", IN_PIECES, str(folder), str(out), "0.05", str(time)],
        env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    return process


def let_go(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def wait_for_another(folder: Path, process: "subprocess.Popen[str]") -> None:
    """Wait until the process has replaced the checkpoint, or has ended."""

    def written() -> list[int]:
        return [path.stat().st_mtime_ns for path in folder.glob("*.checkpoint")]

    before = written()
    while process.poll() is None and written() == before:
        time.sleep(0.005)


def assert_kills_change_nothing(method: MonteCarlo, kills: int, folder: Path) -> None:
    """Kill a simulation so many times, at random moments; the answer is that of one never killed.

    A second process on the same folder is refused while the first one lives, and leaves its
    answer alone. Two in three live until they have kept a state, or there would be no end under
    load.
    """
    expected = arrays_of(method.solve(fig6(), OBSERVABLES))
    draw, refused, out = random.Random(20261121), 0, folder / "found.npz"
    for number in range(kills):
        process = in_pieces(folder, out, method.time)
        second = in_pieces(folder, folder / "second.npz", method.time) if number % 3 else None
        let_go(process)
        if second is not None:
            wait_for_another(folder, process)
            _, err = second.communicate("\n")
            assert second.returncode == 1 and "another process is using this folder" in err
            refused += 1
        time.sleep(draw.uniform(0.0, 0.3))
        process.kill()
        process.communicate()
        assert process.returncode == -signal.SIGKILL  # it had not ended by itself
    assert refused >= kills // 2 and any(folder.glob("*.checkpoint"))
    assert not (folder / "second.npz").exists()
    process = in_pieces(folder, out, method.time)
    process.communicate("\n")
    assert process.returncode == 0 and not list(folder.glob("*.part"))
    with np.load(out) as answer:
        same(answer, expected)
    # Once more from its last state: nothing is left to do, and the answer stays.
    same(arrays_of(replace(method, checkpoint=folder).solve(fig6(), OBSERVABLES)), expected)


def test_killed_twice_the_answer_is_bitwise_the_same(tmp_path: Path) -> None:
    assert_kills_change_nothing(replace(METHOD, time=4000.0), 2, tmp_path)


@pytest.mark.slow
def test_killed_twenty_times_the_answer_is_bitwise_the_same(tmp_path: Path) -> None:
    assert_kills_change_nothing(replace(METHOD, time=30000.0), 20, tmp_path)


def stopped_after(pieces: int) -> Callable[[], bool]:
    """What says after so many pieces that it is time to stop."""
    left = [pieces]

    def stopped() -> bool:
        left[0] -= 1
        return left[0] < 0

    return stopped


def test_the_state_goes_to_disk_and_comes_back(tmp_path: Path) -> None:
    ensembles = [Ensemble(fig6(), SCHEMES["exact_flow"], 0.2, 3 * LANES, 1, 1) for _ in range(2)]
    checkpoint = Checkpoint(tmp_path / "state.checkpoint", "one", stopped_after(0))
    assert checkpoint.load() == Checkpoint().load() == {}
    checkpoint.notes["note"] = np.array([2.5, np.inf])
    assert checkpoint.advance(ensembles[0], 10**6) and checkpoint.interrupted
    loaded = checkpoint.load()
    ensembles[1].restore(loaded)
    assert ensembles[1].done == ensembles[0].done == 1
    np.testing.assert_array_equal(ensembles[1].states, ensembles[0].states)
    np.testing.assert_array_equal(loaded["note"], [2.5, np.inf])
    assert [p.name for p in tmp_path.iterdir()] == ["state.checkpoint"]


def test_no_damaged_state_and_no_other_identity_is_ever_read(tmp_path: Path) -> None:
    """Of any one flipped bit: refused, or in a field of the archive that no number depends on."""
    arrays = {"a": np.arange(5), "b": np.ones((6, 6))}
    path = tmp_path / "state.checkpoint"
    checkpoint, refused = Checkpoint(path, "one"), 0
    checkpoint.save(arrays)
    whole = path.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            same_arrays(checkpoint.load(), arrays)
        except Unavailable as refusal:
            assert "\n" not in str(refusal)
            refused += 1
    assert refused > 0.8 * len(whole)
    for short in (whole[:-1], whole[:20], b""):
        path.write_bytes(short)
        with pytest.raises(Unavailable, match="damaged"):
            checkpoint.load()
    path.write_bytes(whole)
    with pytest.raises(Unavailable, match="another simulation"):
        replace(checkpoint, identity="two").load()
    same_arrays(checkpoint.load(), arrays)


def test_where_nothing_can_be_written_it_is_one_line_and_what_was_there_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = Checkpoint(tmp_path / "state.checkpoint", "one")
    checkpoint.save({"a": np.arange(5)})

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(Unavailable, match="No space left"):
        checkpoint.save({"a": np.arange(6)})
    assert checkpoint.load()["a"].size == 5
    with pytest.raises(Unavailable, match="cannot be written"):
        Checkpoint(tmp_path / "none" / "state.checkpoint", "one").save({})

    assert [p.name for p in tmp_path.iterdir()] == ["state.checkpoint"]  # no .part of a full disk


def test_two_writers_of_one_state_never_damage_it(tmp_path: Path) -> None:
    """Without the lock, too: each writes a part of its own name."""
    path, size = tmp_path / "state.checkpoint", 200_000
    failures: list[BaseException] = []

    def write(number: int) -> None:
        try:
            for _ in range(30):
                Checkpoint(path, "one").save({"a": np.full(size, number)})
                saved = Checkpoint(path, "one").load()["a"]
                assert saved.size == size and saved.min() == saved.max()
        except BaseException as failure:
            failures.append(failure)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures and [p.name for p in tmp_path.iterdir()] == ["state.checkpoint"]


def test_a_state_is_of_one_simulation_at_a_time_and_parts_of_killed_ones_are_removed(
    tmp_path: Path,
) -> None:
    first, second = (Checkpoint(tmp_path / "state.checkpoint", "one") for _ in range(2))
    left = tmp_path / "state.checkpoint.0123.part"
    left.write_bytes(b"half")
    with first.alone():
        assert not left.exists()
        with pytest.raises(Unavailable, match="another process is using this folder") as refusal:
            second.alone().__enter__()
        assert "\n" not in str(refusal.value)
    with second.alone(), Checkpoint().alone(), Checkpoint().alone():
        pass
    with pytest.raises(Unavailable, match="cannot be locked"):
        Checkpoint(tmp_path / "none" / "state.checkpoint", "one").alone().__enter__()


def test_whatever_the_numbers_depend_on_is_in_the_identity(tmp_path: Path) -> None:
    settings = [fig6(), fig6(clearance=0.5000000000000001), fig6(clearance=0.6)]
    names = {
        checkpoint_of(tmp_path, (s, 0.2, 4096, seed)).path for s in settings for seed in (1, 2)
    }
    assert len(names) == 6
    assert checkpoint_of(tmp_path, (fig6(), 0.2, 4096, 1)).path in names


def test_control_c_leaves_a_partial_result_that_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = arrays_of(METHOD.solve(fig6(), OBSERVABLES))
    method = replace(METHOD, partial=True, checkpoint=tmp_path)
    monkeypatch.setattr("sim.sample.workers.INTERVAL", 0.02)
    monkeypatch.setattr("sim.sample.simulation.interruptible", lambda partial: _pressed_after(10))
    found = method.solve(fig6(), OBSERVABLES)
    assert found.partial and isinstance(found.report, Report)
    assert found.report.interrupted.startswith("partial: interrupted after")
    assert found.report.interrupted in found.densities[0].certificate.failures
    assert found.settings["partial"] == found.report.interrupted
    assert found.report.diagnosis is None and 0 < found.report.time < METHOD.time
    assert np.all(np.isfinite(found.densities[0].values))
    monkeypatch.undo()
    same(arrays_of(replace(method, partial=False).solve(fig6(), OBSERVABLES)), expected)


class _pressed_after:
    """A Ctrl-C after so many pieces."""

    def __init__(self, pieces: int) -> None:
        self.pieces = pieces

    def __enter__(self) -> Callable[[], bool]:
        return stopped_after(self.pieces)

    def __exit__(self, *_: object) -> None:
        pass


def test_a_second_control_c_interrupts_at_once() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interruptible(True) as pressed:
        assert not pressed()
        signal.raise_signal(signal.SIGINT)
        assert pressed()
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_do_not_receive_it() -> None:
    answers: list[bool] = []

    def listen() -> None:
        with interruptible(True) as pressed:
            answers.append(pressed())

    thread = threading.Thread(target=listen)
    thread.start()
    thread.join()
    assert answers == [False]
