"""States of unfinished simulations on disk, and Ctrl-C between two pieces of one."""

import hashlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from io import BytesIO
from pathlib import Path
from time import perf_counter
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fpk.compiling import ROOT, checksum
from fpk.errors import Unavailable, reason_of

INTERVAL = 2.0
"""Seconds between two saved states."""

FIRST_PIECE = 256
"""Steps of the first piece, which shows how long a step takes."""

DAMAGED = (BadZipFile, EOFError, KeyError, OSError, RuntimeError, ValueError)
"""Exceptions of NumPy and zipfile for bytes that are not the archive that was written."""


def program_checksum(root: Path = ROOT) -> int:
    """Return a checksum of all sources that the numbers of a simulation may depend on."""
    rooms = [root / "fpk", root / "sim"]
    # A room that is missing is an error, not empty.
    return checksum([f for r in rooms for f in (r / "__init__.py", *sorted(r.rglob("*.py")))])


def never() -> bool:
    """Return that nothing stops a simulation."""
    return False


@dataclass(eq=False)
class Checkpoint:
    """Advances an ensemble in pieces and saves its state every ``INTERVAL`` seconds.

    States are saved as NumPy's .npz at ``path``, or not at all where that is None, with
    ``identity``, a hash of all that the numbers depend on, and ``notes``, arrays that the caller
    needs to go on. ``stopped()`` says after every piece whether to stop.
    """

    path: Path | None = None
    identity: str = ""
    stopped: Callable[[], bool] = never
    notes: dict[str, NDArray[Any]] = field(default_factory=dict)
    interrupted: bool = False
    _piece: int = FIRST_PIECE
    _saved: float = field(default_factory=perf_counter)

    def save(self, ensemble: Any) -> None:
        """Write the state and the notes to another file and move it to ``path``.

        Raises ``Unavailable`` where that is not possible; what was in the file stays.
        """
        if self.path is None:
            return
        part = self.path.with_suffix(".part")
        arrays = {**ensemble.saved(), **self.notes}
        about = json.dumps({"identity": self.identity, "digest": _digest(arrays)})
        try:
            with part.open("wb") as stream:
                np.savez(stream, about=about, **arrays)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, self.path)
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be written: {reason_of(error)}") from None
        self._saved = perf_counter()

    def load(self) -> dict[str, NDArray[Any]]:
        """Return the state and the notes saved last, nothing where there are none.

        Raises ``Unavailable`` for a file that is damaged or of another simulation.
        """
        if self.path is None or not self.path.exists():
            return {}
        try:
            content = BytesIO(self.path.read_bytes())
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be read: {reason_of(error)}") from None
        try:
            with np.load(content, allow_pickle=False) as saved:
                arrays = dict(saved)
            about = json.loads(str(arrays.pop("about")))
            whole = about["digest"] == _digest(arrays)
        except DAMAGED:
            whole = False
        if not whole:
            raise Unavailable(f"{self.path}: is damaged; remove it to begin anew")
        if about["identity"] != self.identity:
            raise Unavailable(
                f"{self.path}: is of another simulation (other system, settings or"
                " version); give another folder or remove it"
            )
        return arrays

    def advance(self, ensemble: Any, steps: int, *, stride: int = 1) -> bool:
        """Advance by ``steps``; return whether it was stopped (at least a piece is done)."""
        while steps > 0 and not self.interrupted:
            piece, start = min(steps, self._piece), perf_counter()
            ensemble.advance(piece, stride=stride)
            now = perf_counter()
            # Pieces grow gently: the first ones may have been compiled.
            in_time = int(piece * ensemble.workers.piece / max(now - start, 1e-9))
            self._piece = max(1, min(4 * self._piece, in_time))
            steps -= piece
            self.interrupted = self.stopped()
            if self.interrupted or now - self._saved >= INTERVAL:
                self.save(ensemble)
        return self.interrupted


def checkpoint_of(folder: Path | None, settings: Any) -> Checkpoint:
    """Return the checkpoint in ``folder`` of the simulation with these settings.

    ``settings`` are records, arrays and numbers, every digit of which counts; so does the program.
    """
    if folder is None:
        return Checkpoint()
    text = json.dumps([program_checksum(), settings], default=_listed)
    identity = hashlib.sha256(text.encode()).hexdigest()
    return Checkpoint(folder / f"montecarlo-{identity[:16]}.checkpoint", identity)


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return a hash of names and numbers: the checksums of a zip archive leave its names out."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def _listed(value: Any) -> Any:
    """Array, or record by the fields that it was made from, as JSON has it."""
    if is_dataclass(value):
        return [type(value).__name__, *(getattr(value, f.name) for f in fields(value) if f.init)]
    return value.tolist()


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed; a second one interrupts as usual.

    Only the main thread of a program receives signals: elsewhere the answer is no.
    """
    if threading.current_thread() is not threading.main_thread():
        yield never
        return
    pressed: list[int] = []

    def note(number: int, frame: Any) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
