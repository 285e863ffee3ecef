"""Workers, checkpoints on disk, and Ctrl-C.

Workers are threads of this process or of a Dask cluster. On a cluster a task gets the arrays of
some batches, advances them, and returns them; when a worker dies, Dask gives its tasks to another:
the answer is bitwise that of one machine with the same kind of processor. Dask is imported only for
a cluster: it takes a second.
"""

import os
import signal
import threading
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from io import BytesIO
from math import inf
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.numeric.compiling import ROOT, abandon, checksum
from fpk.numeric.errors import NotCertified, Unavailable
from fpk.numeric.machine import lock_file, working_time
from fpk.numeric.recognition import fingerprint

INTERVAL = 2.0
"""Seconds between two saved states. An ensemble is advanced in pieces of a quarter of this time,
on a cluster, where arrays travel with each piece, of twice this time; Ctrl-C ends it after one."""
SCHEDULER_TIMEOUT = 10.0
"""Seconds in which a Dask scheduler must answer; in six times as many it must have a worker."""


def program_checksum(root: Path = ROOT) -> int:
    """Return a checksum of all sources of the program; ``FileNotFoundError`` if one is missing."""
    own = [root / package for package in ("fpk", "averaging", "sim", "cases")]
    return checksum([f for r in own for f in (r / "__init__.py", *sorted(r.rglob("*.py")))])


@dataclass(frozen=True, eq=False)
class Workers:
    """An executor with ``threads``; one piece of a simulation takes about ``piece`` seconds.

    ``remote_errors`` are raised if a cluster is lost, and become ``NotCertified``; none for threads
    of this process.
    """

    executor: Executor
    threads: int
    piece: float = 0.25 * INTERVAL
    remote_errors: tuple[type[Exception], ...] = ()

    def map(self, task: Callable[..., Any], *columns: Iterable[Any]) -> list[Any]:
        """Return the results of ``task(*row)`` for each row of ``columns``, in their order.

        The task may change its arguments in place; on a cluster it gets copies. Raises
        ``NotCertified`` if the cluster is lost, as ``as_finished`` does.
        """
        own = deepcopy if self.remote_errors else tuple  # arguments from Dask are read-only
        rows = list(zip(*columns, strict=True))
        return list(self._unless_lost(self.executor.map(lambda row: task(*own(row)), rows)))

    def as_finished(self, tasks: Sequence[Callable[[], Any]]) -> Iterator[Any]:
        """Submit ``tasks`` without arguments; return their results in the order of their end.

        The iterator raises the exception of a task, and ``NotCertified`` if the cluster is lost.
        """
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
    """Yield ``threads`` of this process, or, with an ``address``, the threads of a Dask cluster.

    Raises ``Unavailable`` if Dask is not installed, the scheduler does not answer or has no worker,
    or the workers have other sources of this program.
    """
    if address is None:
        with ThreadPoolExecutor(threads) as executor:
            try:
                yield Workers(executor, threads)
            finally:  # after an exception no further task begins
                executor.shutdown(wait=False, cancel_futures=True)
        return

    def unavailable(words: str) -> Unavailable:
        return Unavailable(f"cluster {address}: {words}")

    try:
        distributed = import_module("distributed")
        client = distributed.Client(address, timeout=SCHEDULER_TIMEOUT, set_as_default=False)
    except ImportError:
        raise unavailable("needs dask, the extra: pip install 'vibro-fpk[cluster]'") from None
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        words = f"no Dask scheduler answers ({type(error).__name__}); give tcp://HOST:PORT"
        raise unavailable(words) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=6.0 * SCHEDULER_TIMEOUT)
            stamp = client.submit(program_checksum, pure=False).result()
        except TimeoutError:
            raise unavailable("has no worker; start one") from None
        except ImportError as error:
            words = f"its workers cannot import this program ({error}); install vibro-fpk there"
            raise unavailable(words) from None
        if stamp != program_checksum():
            raise unavailable("its workers run another version of this program; install the same")
        lost = distributed.KilledWorker, distributed.CancelledError, OSError
        threads = max(1, sum(client.nthreads().values()))
        quiet = {"distributed.admin.large-graph-warning-threshold": "1PiB"}
        with import_module("dask").config.set(quiet):
            yield Workers(client.get_executor(pure=False), threads, 2.0 * INTERVAL, lost)


@dataclass(eq=False)
class Checkpoint:
    """Advances an ensemble in pieces and saves its state every ``INTERVAL`` seconds.

    States are saved as a NumPy .npz file at ``path`` (None: never), with ``identity``, a hash of
    everything that the numbers depend on, and ``notes``, arrays of the caller. The simulation ends
    when ``stopped()`` is true, or at the ``deadline``, a value of ``working_time``.
    """

    path: Path | None = None
    identity: str = ""
    stopped: Callable[[], bool] = lambda: False
    notes: dict[str, NDArray[Any]] = field(default_factory=dict)
    deadline: float = inf
    interrupted: bool = False
    _piece: int = 1
    _saved: float = field(default_factory=working_time)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Lock the state, and remove incomplete files that killed processes have left.

        Raises ``Unavailable`` if another process uses it.
        """
        if self.path is None:
            yield
            return
        with lock_file(self.path.with_suffix(".lock")):
            for part in self.path.parent.glob(f"{self.path.name}.*.part"):
                part.unlink(missing_ok=True)
            yield

    def save(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Replace the file by ``state`` and ``notes``; without a path do nothing.

        Raises ``Unavailable`` if it cannot be written; the old file then stays.
        """
        if self.path is None:
            return
        part, stream = self.path.with_name(f"{self.path.name}.{token_hex(4)}.part"), BytesIO()
        arrays: dict[str, Any] = {"identity": self.identity, **state, **self.notes}
        np.savez(stream, **arrays)
        try:
            with part.open("xb") as file:
                file.write(stream.getbuffer())
                file.write(sha256(stream.getbuffer()).digest())
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, self.path)
        except OSError as error:
            words = f"{self.path}: cannot be written: {error.strerror or error}"
            raise Unavailable(words) from None
        finally:
            part.unlink(missing_ok=True)
        self._saved = working_time()

    def load(self) -> dict[str, NDArray[Any]]:
        """Return the saved arrays by name, notes included; an empty dictionary without a file.

        Raises ``Unavailable`` if the file is damaged or belongs to another simulation.
        """
        if self.path is None or not self.path.exists():
            return {}
        try:
            content = self.path.read_bytes()
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be read: {error.strerror or error}") from None
        if sha256(content[:-32]).digest() != content[-32:]:
            raise Unavailable(f"{self.path}: is damaged; remove it to begin anew")
        with np.load(BytesIO(content[:-32]), allow_pickle=False) as saved:
            arrays = dict(saved)
        if arrays.pop("identity") != self.identity:
            words = "is of another simulation (other system, settings or version)"
            raise Unavailable(f"{self.path}: {words}; give another folder or remove it")
        return arrays

    def advance(self, ensemble: Any, steps: int, *, stride: int = 1, saving: bool = True) -> bool:
        """Advance ``ensemble`` by ``steps``, observed every ``stride``, in pieces.

        Ctrl-C or the deadline ends it after a piece; return True if Ctrl-C was pressed, which sets
        ``interrupted``, or if steps are missing. The state is saved at intervals if ``saving``.
        """
        ended = False
        while steps > 0 and not ended:
            piece, start = min(steps, self._piece), working_time()
            ensemble.advance(piece, stride=stride)
            now = working_time()
            # At most four times the last piece: short pieces are a poor measure of the speed.
            left = min(ensemble.workers.piece, max(self.deadline - now, 0.0))
            in_time = int(piece * left / max(now - start, 1e-9))
            self._piece = max(1, min(4 * self._piece, in_time))
            steps -= piece
            self.interrupted = self.stopped()
            ended = self.interrupted or now >= self.deadline
            if saving and (ended or now - self._saved >= INTERVAL):
                self.save(ensemble.saved())
        return self.interrupted or steps > 0


def checkpoint_of(
    folder: Path | None, settings: Any, name: str = "montecarlo", *, less: Container[str] = ()
) -> Checkpoint:
    """Return the checkpoint of a simulation with ``settings``; without a ``folder`` none is saved.

    Settings that differ only in the fields ``less`` ("Class.field") share a file, whose name begins
    with ``name``.
    """
    if folder is None:
        return Checkpoint()
    identity = fingerprint([program_checksum(), settings], less)
    return Checkpoint(folder / f"{name}-{identity[:16]}.checkpoint", identity)


@contextmanager
def interruptible(partial: bool) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed; a second raises KeyboardInterrupt.

    Unless an answer may be ``partial``, and during compilation, the first Ctrl-C raises it, too.
    Only the main thread receives signals: in other threads the function returns False.
    """
    pressed = threading.Event()
    if not partial or threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def note(number: int, frame: Any) -> None:
        pressed.set()
        abandon()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)
