"""Workers of ensembles: threads of this process, or those of a Dask cluster.

On a cluster every piece of time of a batch is a task that gets the arrays of the batch and returns
them. When a worker dies, Dask gives its tasks to another: the answer is bitwise that of one machine
with the same kind of processor. Dask is imported when it is wanted: it takes a second.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

from fpk.errors import NotCertified, Unavailable
from sim.checkpoint import program_checksum

PATIENCE = 10.0
"""Seconds in which the scheduler must answer."""

WORKERS_IN = 60.0
"""Seconds in which it must have a worker."""

TASKS_PER_THREAD = 8
"""Tasks into which the batches of a thread are divided: fewer cost less to hand out, more leave
less to wait for at the end, and after Ctrl-C."""


class Threads:
    """Workers of an ensemble: ``threads`` of this process.

    ``piece`` are the seconds after which they come back with the ensemble: Ctrl-C waits for that.
    """

    piece = 0.5

    def __init__(self, threads: int = 1) -> None:
        """Begin no thread before there is work."""
        self.threads, self._pool = threads, ThreadPoolExecutor(threads)

    def map(self, task: Callable[..., Any], *columns: Iterable[Any]) -> list[Any]:
        """Return what ``task`` makes of every row of ``columns``."""
        rows = list(zip(*columns, strict=True))
        size = -(-len(rows) // (TASKS_PER_THREAD * self.threads))
        parts = [rows[k : k + size] for k in range(0, len(rows), size)]
        answers = self._pool.map(lambda part: [task(*row) for row in part], parts)
        return [answer for part in answers for answer in part]


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Yield a client of the Dask scheduler at ``address`` that has a worker.

    Raises ``Unavailable`` without dask, an answer, or a worker with the same program.
    """

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
            client.wait_for_workers(1, timeout=WORKERS_IN)
            stamp = client.submit(program_checksum, pure=False).result()
        except TimeoutError:
            raise unavailable("has no worker; start one") from None
        except ImportError as error:
            words = f"its workers cannot import this program ({error}); install vibro-fpk there"
            raise unavailable(words) from None
        if stamp != program_checksum():
            raise unavailable("its workers run another version of this program; install the same")
        yield client


def gathered(client: Any, futures: Sequence[Any]) -> list[Any]:
    """Return the results of ``futures``; raise ``NotCertified`` when the cluster is lost."""
    distributed = import_module("distributed")
    try:
        return list(client.gather(list(futures)))
    except (distributed.KilledWorker, distributed.CancelledError, OSError) as error:
        words = " ".join(f"{type(error).__name__} {error}".split())
        raise NotCertified(f"the cluster was lost on the way: {words[:200]}") from None


def as_finished(client: Any, tasks: Sequence[Callable[[], Any]]) -> Iterator[Any]:
    """Yield what pure tasks without arguments return, in the order in which they are finished."""
    futures = [client.submit(task, pure=False) for task in tasks]
    for future in import_module("distributed").as_completed(futures, loop=client.loop):
        yield gathered(client, [future])[0]


@dataclass(frozen=True, eq=False)
class Cluster:
    """Workers of an ensemble on a Dask cluster: a task uses one thread of a worker.

    Pieces are longer than those of ``Threads``, as the arrays of the ensemble travel with each.
    """

    piece = 4.0
    client: Any

    @property
    def threads(self) -> int:
        """The threads of all workers."""
        return max(1, sum(map(int, self.client.nthreads().values())))

    def map(self, task: Callable[..., Any], *columns: Iterable[Any]) -> list[Any]:
        """Return what ``task`` makes of copies of every row of ``columns``."""
        quiet = {"distributed.admin.large-graph-warning-threshold": "1PiB"}
        with import_module("dask").config.set(quiet):
            futures = self.client.map(partial(on_copies, task), *columns, pure=False)
        return gathered(self.client, futures)


def on_copies(task: Callable[..., Any], *arguments: Any) -> Any:
    """Return the answer of a task that changes its arguments: those of Dask are read-only."""
    return task(*deepcopy(arguments))


@contextmanager
def workers_of(address: str | None, threads: int) -> Iterator[Any]:
    """Yield the workers of ensembles: ``threads`` here, or the cluster at ``address``."""
    if address is None:
        yield Threads(threads)
        return
    with connected(address) as client:
        yield Cluster(client)
