"""States of unfinished simulations on disk, and Ctrl-C between two pieces of one."""

import os
import signal
import threading
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from math import inf
from pathlib import Path
from secrets import token_hex
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fpk.numeric.compiling import ROOT, abandon, checksum
from fpk.numeric.errors import Unavailable, reason_of
from fpk.numeric.machine import locked, working_time
from fpk.numeric.recognition import fingerprint

INTERVAL = 2.0
"""Seconds between two saved states."""

PROGRAM = ("fpk", "averaging", "sim", "cases")
"""All packages: any number may depend on their sources."""


def program_checksum(root: Path = ROOT, rooms: Sequence[str] = ("fpk", "sim")) -> int:
    """Return a checksum of the sources in ``rooms``: by default those that simulations depend on.

    Raises ``FileNotFoundError`` for a room that is missing.
    """
    own = [root / room for room in rooms]
    return checksum([f for r in own for f in (r / "__init__.py", *sorted(r.rglob("*.py")))])


@dataclass(eq=False)
class Checkpoint:
    """Advances an ensemble in pieces and saves its state every ``INTERVAL`` seconds.

    States are saved as NumPy's .npz at ``path``, or not at all where that is None, with
    ``identity``, a hash of all that the numbers depend on, and ``notes``, arrays that the caller
    needs to go on. ``stopped()`` says after every piece whether to stop; at the ``deadline``, a
    value of ``working_time``, it stops, too.
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
        """Keep other processes from this state, and remove the parts that killed ones have left.

        Raises ``Unavailable`` where another process does so.
        """
        if self.path is None:
            yield
            return
        with locked(self.path.with_suffix(".lock")):
            for part in self.path.parent.glob(f"{self.path.name}.*.part"):
                part.unlink(missing_ok=True)
            yield

    def save(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Write the arrays of a state and the notes to another file and move it to ``path``.

        Raises ``Unavailable`` where that is not possible; the former state stays.
        """
        if self.path is None:
            return
        part = self.path.with_name(f"{self.path.name}.{token_hex(4)}.part")
        arrays: dict[str, Any] = {**state, **self.notes}
        try:
            try:
                with part.open("xb") as stream:
                    np.savez(stream, about=[self.identity, *arrays], **arrays)
                    stream.flush()
                    os.fsync(stream.fileno())
                os.replace(part, self.path)
            finally:
                part.unlink(missing_ok=True)
        except OSError as error:
            raise Unavailable(f"{self.path}: cannot be written: {reason_of(error)}") from None
        self._saved = working_time()

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
                # NumPy checks only as much of a member as its header says, and misses none that is
                # gone: hence ``testzip``, and the names in ``about``.
                whole, arrays = saved.zip.testzip() is None, dict(saved)
            identity, *names = arrays.pop("about").tolist()
        except (BadZipFile, EOFError, KeyError, OSError, RuntimeError, ValueError):
            whole = False
        if not whole or names != list(arrays):
            raise Unavailable(f"{self.path}: is damaged; remove it to begin anew")
        if identity != self.identity:
            raise Unavailable(
                f"{self.path}: is of another simulation (other system, settings or"
                " version); give another folder or remove it"
            )
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
    """Return the checkpoint in ``folder`` of the simulation with these settings, named ``name``-.

    ``settings`` and ``less`` as of ``canonical``; the program counts, too.
    """
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
