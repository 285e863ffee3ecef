"""A simulation that was killed goes on bitwise, here or on a cluster; damaged files are refused."""

import logging
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asked import assert_refused
from sim_systems import fig6, ranged, slow

from fpk.answer.names import REST, parse_limit, parse_observable
from fpk.numeric.compiling import ROOT
from fpk.numeric.errors import NotCertified, Unavailable
from sim.montecarlo import MonteCarlo
from sim.questions.splitting import Splitting, rare_failure
from sim.sample.diagnostics import Report, moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.simulation import Record
from sim.sample.workers import Checkpoint, Workers, interruptible, workers_of
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
from test_sample_workers import METHOD, OBSERVABLES, arrays_of
from sim_systems import fig6
sim.sample.workers.INTERVAL = 0.05
method = replace(METHOD, checkpoint=Path(sys.argv[1]), time=float(sys.argv[3]))
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
    assert set(a) == set(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.mark.parametrize(("kills", "length"), [(1, 4000.0), slow(20, 30000.0)])
def test_killed_often_the_answer_is_bitwise_the_same(
    kills: int, length: float, tmp_path: Path
) -> None:
    """Kill a simulation so many times, at random moments; the answer is that of one never killed.

    Each process lives until it has kept a state, or there would be no end under load.
    """
    method, out = replace(METHOD, time=length), tmp_path / "found.npz"
    expected, draw = arrays_of(method.solve(fig6(), OBSERVABLES)), random.Random(20261121)
    rooms = ("tests", "tests/averaging", "tests/sim", "tests/sim/sample")
    paths, before = [ROOT, *(ROOT / room for room in rooms)], list[int]()

    def written() -> list[int]:
        return [path.stat().st_mtime_ns for path in tmp_path.glob("*.checkpoint")]

    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-c", IN_PIECES, str(tmp_path), str(out), str(length)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))},
        )
        while process.poll() is None and written() == before:
            time.sleep(0.005)
        time.sleep(draw.uniform(0.0, 0.3))
        process.kill()
        process.communicate()
        assert process.returncode == -signal.SIGKILL  # it had not ended by itself
        before = written()
    assert before and not out.exists()
    # From its last state to the end; once more there is nothing left to do.
    for _ in range(2):
        same(arrays_of(replace(method, checkpoint=tmp_path).solve(fig6(), OBSERVABLES)), expected)
    assert not list(tmp_path.glob("*.part"))


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
            same(checkpoint.load(), arrays)
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
    same(checkpoint.load(), arrays)


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


def test_a_state_is_of_one_simulation_at_a_time_and_parts_of_killed_ones_are_removed(
    tmp_path: Path,
) -> None:
    first, second = (Checkpoint(tmp_path / "state.checkpoint", "one") for _ in range(2))
    left = tmp_path / "state.checkpoint.0123.part"
    left.write_bytes(b"half")
    with first.alone():
        assert not left.exists()
        words = "another process is using this folder"
        assert_refused(Unavailable, words, second.alone().__enter__)
    with second.alone(), Checkpoint().alone(), Checkpoint().alone():
        pass
    with pytest.raises(Unavailable, match="cannot be locked"):
        Checkpoint(tmp_path / "none" / "state.checkpoint", "one").alone().__enter__()


def interrupt_after(pieces: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A Ctrl-C comes after so many pieces."""

    @contextmanager
    def pressed(partial: bool) -> Iterator[Callable[[], bool]]:
        left = iter(range(pieces))
        yield lambda: next(left, None) is None

    monkeypatch.setattr("sim.sample.workers.INTERVAL", 0.02)
    monkeypatch.setattr("sim.sample.simulation.interruptible", pressed)


def test_control_c_leaves_a_partial_result_that_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = arrays_of(METHOD.solve(fig6(), OBSERVABLES))
    method = replace(METHOD, partial=True, checkpoint=tmp_path)
    interrupt_after(10, monkeypatch)
    found = method.solve(fig6(), OBSERVABLES)
    assert found.partial and isinstance(found.report, Report)
    assert found.report.interrupted.startswith("partial: interrupted after")
    assert found.report.interrupted in found.densities[0].certificate.failures
    assert found.settings["partial"] == found.report.interrupted
    assert found.report.diagnosis is None and 0 < found.report.time < METHOD.time
    assert np.all(np.isfinite(found.densities[0].values))
    monkeypatch.undo()
    same(arrays_of(replace(method, partial=False).solve(fig6(), OBSERVABLES)), expected)


def test_the_speed_after_a_resumed_burn_in_counts_the_steps_that_were_timed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = replace(METHOD, partial=True, checkpoint=tmp_path, time=20.0)
    interrupt_after(2, monkeypatch)
    assert "of the burn-in" in method.solve(fig6(), OBSERVABLES).report.interrupted
    monkeypatch.undo()
    records = list[Record]()

    def recorded(*arguments: Any, **fields: Any) -> Record:
        records.append(Record(*arguments, **fields))
        return records[-1]

    monkeypatch.setattr("sim.sample.simulation.Record", recorded)
    report, (record,) = method.solve(fig6(), OBSERVABLES).report, records
    assert 0 < record.untimed < record.ensemble.done
    timed = (record.ensemble.done - record.untimed) * 4096
    assert report.ns_per_particle_step == pytest.approx(1e9 * record.elapsed / timed)


def test_a_second_control_c_interrupts_at_once_and_other_threads_do_not_receive_it() -> None:
    def answer_there() -> bool:
        with interruptible(True) as pressed:
            return pressed()

    with ThreadPoolExecutor(1) as executor:
        assert executor.submit(answer_there).result() is False
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interruptible(True) as pressed:
        assert not pressed()
        signal.raise_signal(signal.SIGINT)
        assert pressed()
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


PATHS = 5 * LANES - 17  # five batches of one block each


@contextmanager
def two_workers() -> Iterator[tuple[Workers, Any, str]]:
    """Two processes of one thread on this machine, a client of them, the address; none logs."""
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    with (
        dask.config.set({"distributed.logging.distributed": "critical"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        ) as local,
        workers_of(local.scheduler_address) as those,
        distributed.Client(local, set_as_default=False) as client,
    ):  # fmt: skip
        yield those, client, local.scheduler_address


def begun(workers: Any = None) -> Ensemble:
    ensemble = Ensemble(fig6(), SCHEMES["exact_flow"], 0.1, PATHS, 31, 2, workers)
    ensemble.advance(20)
    ensemble.watch(ranged(fig6(), ("q1", "q2,p2")), moment_products(2))
    return ensemble


def test_a_task_on_a_cluster_leaves_its_arguments_as_they_were() -> None:
    def add(array: Any, number: float) -> Any:
        array += number
        return array

    array = np.zeros(3)
    with ThreadPoolExecutor(1) as executor:
        (added,) = Workers(executor, 1, remote_errors=(OSError,)).map(add, [array], [1.0])
        np.testing.assert_array_equal(added, np.ones(3))
        assert not array.any()
        assert Workers(executor, 1).map(add, [array], [1.0])[0] is array  # of this process: none


def test_bitwise_the_same_on_two_workers_of_which_one_is_killed() -> None:
    """What is saved there goes on here."""
    expected = begun()
    expected.advance(93, stride=3)
    with two_workers() as (workers, client, _):
        ensemble = begun(workers)
        assert ensemble.threads == 2
        ensemble.advance(31, stride=3)
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        ensemble.advance(31, stride=3)
        stopped = begun()
        stopped.restore(ensemble.saved())
        for other in (ensemble, stopped):
            other.advance(31, stride=3)
            same(other.saved(), expected.saved())
            np.testing.assert_array_equal(other.phase_points(), expected.phase_points())
            np.testing.assert_array_equal(other.batch_means(), expected.batch_means())


def fail_with_the_system(share: int) -> int:
    os._exit(1)


@pytest.mark.slow
def test_splitting_on_a_cluster_and_a_task_that_kills_every_worker_ends_in_one_line() -> None:
    quick = Splitting(replicas=64, killed=4, repetitions=8, threads=1, seconds=1e6)
    failure: Any = fig6(), parse_limit("H=2", 2), REST, 20.0
    with two_workers() as (workers, _, address):
        there = rare_failure(*failure, settings=replace(quick, cluster=address))
        np.testing.assert_array_equal(there.values, rare_failure(*failure, settings=quick).values)
        assert_refused(NotCertified, "lost on the way", workers.map, fail_with_the_system, [1])


def test_an_address_that_does_not_answer_or_a_missing_package_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sim.sample.workers.SCHEDULER_TIMEOUT", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense", "", "tcp://[::1"):
        assert_refused(Unavailable, "no Dask scheduler", workers_of(address).__enter__)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert_refused(Unavailable, r"vibro-fpk\[cluster\]", workers_of("tcp://x:1").__enter__)
