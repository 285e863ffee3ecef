"""States of unfinished simulations on disk, and Ctrl-C between two pieces of one."""

import hashlib
import io
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.errors import Unavailable, reason_of
from sim.sources import program_checksum

INTERVAL = 2.0
"""Seconds between two checkpoints, and the longest that a simulation takes to notice Ctrl-C."""

FIRST_PIECE = 256
"""Steps after which the time of a step is known."""

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Checkpoint:
    """A file that holds one state of one simulation, whole or not at all.

    ``identity`` is a hash of all that the numbers depend on. The file is NumPy's .npz of the arrays
    and of the identity behind its own SHA-256: the checksums of a zip archive leave its directory
    out.
    """

    path: Path
    identity: str

    def save(self, arrays: Arrays) -> None:
        """Write ``arrays`` beside the file, to the disk itself, and move them there in one step.

        Raises ``Unavailable`` where that is not possible; what was in the file stays.
        """
        content = io.BytesIO()
        entries: dict[str, Any] = {**arrays, "identity": np.array(self.identity)}
        np.savez(content, **entries)
        part = self.path.with_suffix(".part")
        try:
            with part.open("wb") as stream:
                stream.write(hashlib.sha256(content.getbuffer()).digest())
                stream.write(content.getbuffer())
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, self.path)
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be written: {reason_of(error)}") from None

    def load(self) -> dict[str, NDArray[Any]] | None:
        """Return the arrays saved last, None where there are none.

        Raises ``Unavailable`` for a file that is damaged or of another simulation.
        """
        try:
            whole = self.path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be read: {reason_of(error)}") from None
        size = hashlib.sha256().digest_size
        if hashlib.sha256(whole[size:]).digest() != whole[:size]:
            raise Unavailable(f"{self.path}: is damaged; remove it to begin anew")
        with np.load(io.BytesIO(whole[size:]), allow_pickle=False) as saved:
            arrays = dict(saved)
        if str(arrays.pop("identity")) != self.identity:
            raise Unavailable(
                f"{self.path}: is of another simulation (other system, settings or"
                " version); give another folder or remove it"
            )
        return arrays


def checkpoint_of(folder: Path, settings: Any) -> Checkpoint:
    """Return the checkpoint in ``folder`` of the simulation that has these settings.

    ``settings`` is anything made of records, arrays and numbers, of which every digit counts;
    the program counts, too.
    """
    text = json.dumps([program_checksum(), settings], default=_listed)
    identity = hashlib.sha256(text.encode()).hexdigest()
    return Checkpoint(folder / f"montecarlo-{identity[:16]}.checkpoint", identity)


def _listed(value: Any) -> Any:
    """Array, or record by the fields that it was made from, as JSON has it."""
    if is_dataclass(value):
        return [type(value).__name__, *(getattr(value, f.name) for f in fields(value) if f.init)]
    return value.tolist()


@dataclass(eq=False)
class Autosave:
    """Advances an ensemble in pieces of about ``INTERVAL`` seconds and saves the state after each.

    ``notes`` are arrays saved with the state: what the loop around needs to go on. Without a
    checkpoint and anything that may stop it there is one piece.
    """

    checkpoint: Checkpoint | None = None
    stopped: Callable[[], bool] | None = None
    notes: dict[str, NDArray[Any]] = field(default_factory=dict)
    interrupted: bool = False
    _piece: int = FIRST_PIECE
    _saved: float = field(default_factory=perf_counter)

    def load(self) -> dict[str, NDArray[Any]]:
        """Return the state and the notes of the checkpoint, nothing where there is none."""
        return (self.checkpoint.load() if self.checkpoint else None) or {}

    def save(self, ensemble: Any) -> None:
        """Save the state now, if there is a checkpoint."""
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
            self._piece = max(1, min(4 * piece, int(piece * INTERVAL / max(now - start, 1e-9))))
            steps -= piece
            self.interrupted = self.stopped is not None and self.stopped()
            if self.interrupted or now - self._saved >= INTERVAL:
                self.save(ensemble)
            if self.interrupted:
                return True
        return False


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed; a second one interrupts as usual.

    Only the main thread of a program receives signals: elsewhere the answer is no.
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
