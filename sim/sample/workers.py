"""Workers of ensembles: an executor of threads of this process, or of a Dask cluster.

On a cluster every piece of time of some batches is a task that gets their arrays and returns them.
When a worker dies, Dask gives its tasks to another: the answer is bitwise that of one machine with
the same kind of processor. Dask is imported when it is wanted: it takes a second.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from fpk.numeric.errors import NotCertified, Unavailable
from sim.sample.checkpoint import PROGRAM, program_checksum

PATIENCE = 10.0
"""Seconds in which the scheduler must answer; in six times as many it must have a worker."""

TASKS_PER_THREAD = 8
"""Tasks of a thread in one piece of time: fewer cost less to hand out, more leave less to wait for
at the end, and after Ctrl-C."""

PIECE = 0.5
"""Seconds after which workers come back with an ensemble, so that Ctrl-C waits for that; eight
times as long on a cluster, as the arrays of the ensemble travel with each piece."""


@dataclass(frozen=True, eq=False)
class Workers:
    """An executor of ``threads`` in all, which comes back with an ensemble after ``piece`` seconds.

    ``remote_errors`` are the exceptions of a cluster that is lost; empty for threads of this
    process. ``NotCertified`` is raised in their place.
    """

    executor: Executor
    threads: int
    piece: float = PIECE
    remote_errors: tuple[type[Exception], ...] = ()

    def map(self, task: Callable[..., Any], *columns: Iterable[Any]) -> list[Any]:
        """Return what ``task`` makes of rows of ``columns``, which it may change, or of copies."""
        own = deepcopy if self.remote_errors else tuple  # arguments that Dask gives are read-only
        rows = list(zip(*columns, strict=True))
        return list(self._unless_lost(self.executor.map(lambda row: task(*own(row)), rows)))

    def as_finished(self, tasks: Sequence[Callable[[], Any]]) -> Iterator[Any]:
        """Return what tasks without arguments return, in the order in which they are finished."""
        futures = [self.executor.submit(task) for task in tasks]
        return self._unless_lost(future.result() for future in as_completed(futures))

    def _unless_lost(self, results: Iterable[Any]) -> Iterator[Any]:
        try:
            yield from results
        except self.remote_errors as error:
            words = " ".join(f"{type(error).__name__} {error}".split())
            raise NotCertified(f"the cluster was lost on the way: {words[:200]}") from None


@contextmanager
def workers_of(address: str | None, threads: int = 1) -> Iterator[Workers]:
    """Yield ``threads`` threads here, or those of the cluster whose scheduler has the ``address``.

    Raises ``Unavailable`` without dask, an answer, or a worker with the same program.
    """
    if address is None:
        with ThreadPoolExecutor(threads) as executor:
            yield Workers(executor, threads)
        return

    def unavailable(words: str) -> Unavailable:
        return Unavailable(f"cluster {address}: {words}")

    try:
        distributed = import_module("distributed")
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except ImportError:
        raise unavailable("needs dask, the extra: pip install 'vibro-fpk[cluster]'") from None
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        words = f"no Dask scheduler answers ({type(error).__name__}); give tcp://HOST:PORT"
        raise unavailable(words) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=6.0 * PATIENCE)
            stamp = client.submit(program_checksum, rooms=PROGRAM, pure=False).result()
        except TimeoutError:
            raise unavailable("has no worker; start one") from None
        except ImportError as error:
            words = f"its workers cannot import this program ({error}); install vibro-fpk there"
            raise unavailable(words) from None
        if stamp != program_checksum(rooms=PROGRAM):
            raise unavailable("its workers run another version of this program; install the same")
        lost = distributed.KilledWorker, distributed.CancelledError, OSError
        threads = max(1, sum(client.nthreads().values()))
        quiet = {"distributed.admin.large-graph-warning-threshold": "1PiB"}
        with import_module("dask").config.set(quiet):
            yield Workers(client.get_executor(pure=False), threads, 8.0 * PIECE, lost)
