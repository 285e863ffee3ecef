"""Ensembles on a Dask cluster: bitwise those of one process, whatever happens to the workers."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from sim_systems import fig6, ranged

from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotCertified, Unavailable
from sim.sample.diagnostics import moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram
from sim.sample.workers import Workers, workers_of
from sim.step.arrays import LANES
from sim.step.schemes import SCHEMES

dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
EXACT_FLOW = SCHEMES["exact_flow"]
PATHS = 5 * LANES - 17
"""Five batches of one block each."""
MANY = 70 * LANES - 17
"""Seventy blocks in sixty-four batches, of which some have two."""


@contextmanager
def cluster(workers: int) -> Iterator[tuple[Workers, Any]]:
    """Worker processes of one thread on this machine, and a client of them; they log nothing."""
    with (
        dask.config.set({"distributed.logging.distributed": "critical"}),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        ) as local,
        workers_of(local.scheduler_address) as those,
        distributed.Client(local, set_as_default=False) as client,
    ):  # fmt: skip
        yield those, client


def histograms() -> tuple[Histogram, ...]:
    q = np.array([[-1.0] * 2, [1.0] * 2])
    observables = [parse_observable(name, 2) for name in ("q1", "q2,p2")]
    return ranged(fig6(), observables, q, q)


def sampled(ensemble: Any, *, between: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """What is found in three chunks, ``between`` being called after each."""
    ensemble.advance(20)
    ensemble.watch(histograms(), moment_products(2))
    for _ in range(3):
        ensemble.advance(31, stride=3)
        between()
    q, p = ensemble.phase_points()
    found = {"q": q, "p": p, "means": ensemble.batch_means()}
    return {**ensemble.saved(), **found, "live": ensemble.live}


def assert_same(a: dict[str, Any], b: dict[str, Any]) -> None:
    assert a.keys() == b.keys()
    for key in a:
        np.testing.assert_array_equal(a[key], b[key], err_msg=key)


def here(paths: int = PATHS) -> Ensemble:
    return Ensemble(fig6(), EXACT_FLOW, 0.1, paths, 31, 2)


def there(workers: Workers, paths: int = PATHS) -> Ensemble:
    return Ensemble(fig6(), EXACT_FLOW, 0.1, paths, 31, workers=workers)


def kill_one(client: Any) -> Callable[[], None]:
    """What kills the first worker there is, once."""
    left = [signal.SIGKILL]

    def kill() -> None:
        if left:
            os.kill(next(iter(client.run(os.getpid).values())), left.pop())

    return kill


def test_what_was_saved_goes_on_in_another_ensemble() -> None:
    one, other = here(MANY), here(MANY)
    for ensemble in (one, other):
        ensemble.watch(histograms(), moment_products(2))
    one.advance(31, stride=3)
    other.restore(one.saved())
    for ensemble in (one, other):
        ensemble.advance(20, stride=3)
    assert_same({**one.saved()}, {**other.saved()})
    np.testing.assert_array_equal(one.batch_means(), other.batch_means())


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
    expected = sampled(here())
    with cluster(2) as (workers, client):
        ensemble = there(workers)
        assert ensemble.threads == 2
        assert_same(sampled(ensemble, between=kill_one(client)), expected)
        # What is saved here goes on there, and the other way round.
        stopped = here()
        stopped.advance(20)
        stopped.watch(histograms(), moment_products(2))
        stopped.advance(50, stride=3)
        ensemble = there(workers)
        ensemble.watch(histograms(), moment_products(2))
        ensemble.restore(stopped.saved())
        ensemble.advance(12, stride=3)
        stopped.restore(ensemble.saved())
        stopped.advance(31, stride=3)
        assert_same({**stopped.saved()}, {name: expected[name] for name in stopped.saved()})


@pytest.mark.slow
@pytest.mark.parametrize("kill", [False, True])
def test_bitwise_the_same_on_four_workers(kill: bool) -> None:
    with cluster(4) as (workers, client):
        between = kill_one(client) if kill else lambda: None
        assert_same(sampled(there(workers, MANY), between=between), sampled(here(MANY)))


def fail_with_the_system(share: int) -> int:
    os._exit(1)


@pytest.mark.slow
def test_a_task_that_kills_every_worker_ends_in_one_line() -> None:
    with cluster(2) as (workers, _):
        with pytest.raises(NotCertified, match="lost on the way") as end:
            workers.map(fail_with_the_system, [1])
        assert "\n" not in str(end.value)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "", "tcp://[::1"])
def test_an_address_that_does_not_answer_is_one_line(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.sample.workers.PATIENCE", 0.5)
    with pytest.raises(Unavailable, match="no Dask scheduler") as end, workers_of(address):
        pass
    assert "\n" not in str(end.value)


def test_where_dask_is_missing_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(Unavailable, match=r"vibro-fpk\[cluster\]"), workers_of("tcp://x:1"):
        pass
