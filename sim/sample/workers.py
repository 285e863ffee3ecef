"""How long simulations run: by workers, in pieces, with states saved on disk, and until Ctrl-C.

Workers are threads of this process or of a Dask cluster. There each piece of time of some batches
is a task that gets their arrays and returns them; when a worker dies, Dask gives its tasks to
another: the answer is bitwise that of one machine with the same kind of processor. Dask is imported
when it is wanted: it takes a second.
"""

import os
import signal
import threading
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from importlib import import_module
from io import BytesIO
from math import inf
from pathlib import Path
from secrets import token_hex
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fpk.numeric.compiling import ROOT, abandon, checksum
from fpk.numeric.errors import NotCertified, Unavailable
from fpk.numeric.machine import lock_file, working_time
from fpk.numeric.recognition import fingerprint

INTERVAL = 2.0
"""Seconds between two saved states."""
PATIENCE = 10.0
"""Seconds in which the scheduler must answer; in six times as many it must have a worker."""
PIECE = 0.5
"""Seconds after which workers come back with an ensemble, so that Ctrl-C waits for that; eight
times as long on a cluster, as the arrays of the ensemble travel with each piece."""
PROGRAM = ("fpk", "averaging", "sim", "cases")
"""All packages: any number may depend on their sources."""


def program_checksum(root: Path = ROOT, rooms: Sequence[str] = ("fpk", "sim")) -> int:
    """Return a checksum of the sources in ``rooms``; ``FileNotFoundError`` where one is missing."""
    own = [root / room for room in rooms]
    return checksum([f for r in own for f in (r / "__init__.py", *sorted(r.rglob("*.py")))])


@dataclass(frozen=True, eq=False)
class Workers:
    """An executor of ``threads``, which comes back with an ensemble after ``piece`` seconds."""

    executor: Executor
    threads: int
    piece: float = PIECE
    remote_errors: tuple[type[Exception], ...] = ()  # of a lost cluster: ``NotCertified``

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
    """Yield threads here, or those of a cluster; ``Unavailable`` if it has not this program."""
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


@dataclass(eq=False)
class Checkpoint:
    """Advances an ensemble in pieces and saves its state every ``INTERVAL`` seconds.

    States are saved as NumPy's .npz at ``path`` (None: not at all), with ``identity``, a hash of
    all that the numbers depend on, and ``notes``, arrays that the caller needs to go on. It ends
    where ``stopped()`` says so, and at the ``deadline``, a value of ``working_time``.
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
        """Remove parts left by killed processes; ``Unavailable`` where one uses this state."""
        if self.path is None:
            yield
            return
        with lock_file(self.path.with_suffix(".lock")):
            for part in self.path.parent.glob(f"{self.path.name}.*.part"):
                part.unlink(missing_ok=True)
            yield

    def save(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Replace the former state by a whole one, or raise ``Unavailable`` and leave it."""
        if self.path is None:
            return
        part = self.path.with_name(f"{self.path.name}.{token_hex(4)}.part")
        arrays: dict[str, Any] = {**state, **self.notes}
        try:
            with part.open("xb") as stream:
                np.savez(stream, about=[self.identity, *arrays], **arrays)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, self.path)
        except OSError as error:
            raise Unavailable(
                f"{self.path}: cannot be written: {error.strerror or error}"
            ) from None
        finally:
            part.unlink(missing_ok=True)
        self._saved = working_time()

    def load(self) -> dict[str, NDArray[Any]]:
        """Return state and notes, if any; ``Unavailable`` if damaged or of another simulation."""
        if self.path is None or not self.path.exists():
            return {}
        try:
            content = BytesIO(self.path.read_bytes())
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be read: {error.strerror or error}") from None
        try:
            with np.load(content, allow_pickle=False) as saved:
                # NumPy checks only as much of a member as its header says, and misses none that is
                # gone: hence ``testzip``, and the names in ``about``.
                whole, arrays = saved.zip.testzip() is None, dict(saved)
            identity, *names = arrays.pop("about").tolist()
        except (BadZipFile, EOFError, KeyError, OSError, RuntimeError, ValueError):
            whole = False
        if not whole or names != list(arrays):
            raise Unavailable(f"{self.path}: is damaged; remove it to begin anew")
        if identity != self.identity:
            words = "is of another simulation (other system, settings or version)"
            raise Unavailable(f"{self.path}: {words}; give another folder or remove it")
        return arrays

    def advance(self, ensemble: Any, steps: int, *, stride: int = 1, saving: bool = True) -> bool:
        """Advance by ``steps``; return whether it was stopped (at least a piece is done)."""
        ended = False
        while steps > 0 and not ended:
            piece, start = min(steps, self._piece), working_time()
            ensemble.advance(piece, stride=stride)
            now = working_time()
            # Pieces grow gently: the first ones are short, and may have been loaded.
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
    """Return the checkpoint in ``folder`` of ``settings``, less fields as of ``canonical``."""
    if folder is None:
        return Checkpoint()
    identity = fingerprint([program_checksum(), settings], less)
    return Checkpoint(folder / f"{name}-{identity[:16]}.checkpoint", identity)


@contextmanager
def interruptible(partial: bool) -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed; a second one interrupts as usual.

    The first one interrupts, too, unless an answer may be ``partial``, and while the simulation is
    compiled. Only the main thread of a program receives signals: elsewhere the answer is no.
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
