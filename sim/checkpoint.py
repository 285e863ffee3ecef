"""States of unfinished simulations on disk, and Ctrl-C between two pieces of one."""

import hashlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpk.errors import Unavailable, reason_of
from fpk.observable import Observable
from sim.histogram import Histogram
from sim.sources import program_stamp

FORMAT = "vibro-fpk checkpoint 1"

EVERY = 2.0
"""Seconds between two checkpoints, and those for which a simulation does not hear Ctrl-C."""

FIRST_PIECE = 256
"""Steps after which the time of a step is known."""

PIECE = 1 << 20
"""Bytes of a file that are read at a time to check it."""

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Checkpoint:
    """A file that holds one state of one simulation, whole or not at all.

    ``identity`` is a hash of all that the numbers depend on. The file is a line of JSON, the
    arrays one after the other in NumPy's own format, and the SHA-256 of everything before.
    """

    path: Path
    identity: str

    def save(self, arrays: Arrays) -> None:
        """Write ``arrays`` beside the file, to the disk itself, and move them there in one step.

        Raises ``Unavailable`` where that is not possible; what was in the file stays.
        """
        head = {"format": FORMAT, "identity": self.identity, "arrays": list(arrays)}
        part = self.path.with_suffix(".part")
        try:
            with part.open("wb") as stream:
                hashed = _Hashed(stream)
                hashed.write(json.dumps(head).encode() + b"\n")
                for array in arrays.values():
                    np.save(hashed, array, allow_pickle=False)
                stream.write(hashed.sum.digest())
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, self.path)
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)  # the new name, too
            finally:
                os.close(folder)
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be written: {reason_of(error)}") from None

    def load(self) -> dict[str, NDArray[Any]] | None:
        """Return the arrays saved last, None where there are none.

        Raises ``Unavailable`` for a file that is damaged or of another simulation.
        """
        try:
            with self.path.open("rb") as stream:
                if not _whole(stream):
                    raise Unavailable(f"{self.path}: is damaged; remove it to begin anew")
                head = json.loads(stream.readline())
                if (head["format"], head["identity"]) != (FORMAT, self.identity):
                    raise Unavailable(
                        f"{self.path}: is of another simulation (other system, settings or"
                        " version); give another folder or remove it"
                    )
                return {name: np.load(stream, allow_pickle=False) for name in head["arrays"]}
        except FileNotFoundError:
            return None
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be read: {reason_of(error)}") from None


def _whole(stream: BinaryIO) -> bool:
    """Return whether a file ends with the hash of all before, read a piece at a time; rewind it."""
    hashed = hashlib.sha256()
    left = os.fstat(stream.fileno()).st_size - hashed.digest_size
    while left > 0 and (piece := stream.read(min(left, PIECE))):
        hashed.update(piece)
        left -= len(piece)
    found = left == 0 and stream.read() == hashed.digest()
    stream.seek(0)
    return found


@dataclass
class _Hashed:
    """A stream that takes the hash of what is written to it."""

    stream: Any
    sum: Any = field(default_factory=hashlib.sha256)

    def write(self, part: Any) -> int:
        self.sum.update(part)
        return int(self.stream.write(part))


def checkpoint_of(folder: Path, settings: Any) -> Checkpoint:
    """Return the checkpoint in ``folder`` of the simulation that has these settings.

    ``settings`` is anything made of records, arrays and numbers; program and format count, too.
    """
    try:
        program = version("vibro-fpk")
    except PackageNotFoundError:
        program = "(not installed)"
    whole = [FORMAT, program, program_stamp(), settings]
    identity = hashlib.sha256(json.dumps(_plain(whole), sort_keys=True).encode()).hexdigest()
    return Checkpoint(folder / f"montecarlo-{identity[:16]}.checkpoint", identity)


def _plain(value: Any) -> Any:
    """Anything as JSON, of which every digit counts: NaN and infinity have names there."""
    if hasattr(value, "__dataclass_fields__"):
        return [type(value).__name__, _plain(asdict(value))]
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if hasattr(value, "tolist"):
        return value.tolist()
    return value if isinstance(value, (str, int, float, bool, type(None))) else repr(value)


def edges_of(histograms: Sequence[Histogram]) -> dict[str, NDArray[Any]]:
    """Return the edges of histograms as arrays with names."""
    return {
        f"edges_{m}_{axis}": edges
        for m, histogram in enumerate(histograms)
        for axis, edges in enumerate(histogram.edges)
    }


def histograms_of(saved: Arrays, observables: Sequence[Observable]) -> tuple[Histogram, ...]:
    """Return the histograms of ``observables`` whose ``edges_of`` were saved."""
    return tuple(
        Histogram(o, tuple(saved[f"edges_{m}_{axis}"] for axis in range(len(o))))
        for m, o in enumerate(observables)
    )


@dataclass(eq=False)
class Keeper:
    """Advances an ensemble in pieces of about ``EVERY`` seconds; after each the state is kept.

    ``notes`` are arrays saved with the state: what the loop around needs to go on. Without a
    checkpoint and anything that may stop it, a piece is all.
    """

    checkpoint: Checkpoint | None = None
    stopped: Callable[[], bool] | None = None
    notes: dict[str, NDArray[Any]] = field(default_factory=dict)
    interrupted: bool = False
    _piece: int = FIRST_PIECE
    _saved: float = field(default_factory=perf_counter)

    def load(self) -> dict[str, NDArray[Any]]:
        """Return the state and the notes of the checkpoint, nothing where there is none."""
        found = None if self.checkpoint is None else self.checkpoint.load()
        return found or {}

    def save(self, ensemble: Any) -> None:
        """Keep the state now."""
        if self.checkpoint is not None:
            self.checkpoint.save({**ensemble.saved(), **self.notes})
            self._saved = perf_counter()

    def advance(self, ensemble: Any, steps: int, *, stride: int = 1) -> bool:
        """Advance by ``steps``; return whether it was stopped before (at least a piece is done)."""
        if self.checkpoint is None and self.stopped is None:
            ensemble.advance(steps, stride=stride)
            return False
        while steps > 0:
            piece, start = min(steps, self._piece), perf_counter()
            ensemble.advance(piece, stride=stride)
            now = perf_counter()
            # Pieces grow gently: the first ones may have been compiled.
            self._piece = max(1, min(4 * piece, int(piece * EVERY / max(now - start, 1e-9))))
            steps -= piece
            stopped = self.stopped is not None and self.stopped()
            if stopped or now - self._saved >= EVERY:
                self.save(ensemble)
            if stopped:
                self.interrupted = True
                return True
        return False


@contextmanager
def heard_interrupt() -> Iterator[Callable[[], bool]]:
    """Yield what tells whether Ctrl-C was pressed; a second one interrupts as usual.

    Only the main thread of a program hears signals: elsewhere the answer is no.
    """
    pressed: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return

    def note(number: int, frame: Any) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
