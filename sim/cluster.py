"""Workers of ensembles on a Dask cluster: batches stay there, and their results add up.

The state of a batch is a future, and every step forward a task that is a pure function of the
future before. When a worker dies Dask computes what it held again from the tasks that led there:
the answer is bitwise that of one machine (of the same kind of processor), however many workers
there are. Dask belongs to the extra ``cluster`` and is imported when it is wanted: it takes a
second.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from fpk.errors import NotCertified, Unavailable
from sim.batch import Threads
from sim.sources import program_checksum

PATIENCE = 10.0
"""Seconds in which the scheduler must answer."""

WORKERS_IN = 60.0
"""Seconds in which it must have a worker."""


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Yield a client of the Dask scheduler at ``address`` that has a worker.

    Raises ``Unavailable`` where dask is missing, nothing answers, or no worker of the same
    program is there.
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
    """Return the results of ``futures``; ``NotCertified`` when the cluster is lost on the way."""
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

    A worker with several threads works on as many batches at once; they stay where they are.
    """

    client: Any

    @property
    def threads(self) -> int:
        """The threads of all workers."""
        return max(1, sum(map(int, self.client.nthreads().values())))

    def map(self, task: Any, *columns: Any) -> list[Any]:
        """Return futures of what ``task`` makes of every batch, and wait for them."""
        quiet = {"distributed.admin.large-graph-warning-threshold": "1PiB"}
        with import_module("dask").config.set(quiet):
            rows = zip(*columns, strict=True)
            futures = [self.client.submit(on_copies, task, *row, pure=False) for row in rows]
        with self.client.as_current():
            import_module("distributed").wait(futures)
        return futures

    def values(self, answers: list[Any]) -> list[Any]:
        """Return the answers of ``map``, brought here."""
        return gathered(self.client, answers)


def on_copies(task: Any, *arguments: Any) -> Any:
    """Return the answer of a task that may change its arguments, which stay as they are."""
    return task(*deepcopy(arguments))


@contextmanager
def workers_of(address: str | None, threads: int) -> Iterator[Any]:
    """Yield the workers of ensembles: ``threads`` here, or the cluster at ``address``."""
    if address is None:
        yield Threads(threads)
        return
    with connected(address) as client:
        yield Cluster(client)
