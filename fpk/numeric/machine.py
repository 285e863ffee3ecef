"""The machine that a process shares with others: its cores, its time, and locks on folders."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EACCES, EAGAIN
from pathlib import Path
from threading import Lock
from time import perf_counter

from fpk.numeric.errors import Unavailable

_lock = Lock()
_within = 0
_begun = _left_out = 0.0


def usable_cores() -> int:
    """Return how many cores this process may use; on systems without affinity, all cores."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def working_time() -> float:
    """Return wall time in seconds from an arbitrary zero, without the times during which any thread
    was within ``pause_working_time``."""
    with _lock:
        now = perf_counter()
        return now - _left_out - (now - _begun if _within else 0.0)


@contextmanager
def pause_working_time() -> Iterator[None]:
    """Stop the clock ``working_time`` of the process within the context, which compiles or loads
    compiled code. Contexts may overlap and be nested."""
    global _within, _begun, _left_out  # one clock for all threads
    with _lock:
        _begun = _begun if _within else perf_counter()
        _within += 1
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            _left_out += 0.0 if _within else perf_counter() - _begun


@contextmanager
def lock_file(path: Path, *, needed: bool = True) -> Iterator[None]:
    """Lock the file ``path`` exclusively within the context; create the file if it is missing.

    The operating system releases the lock when the process ends, killed or not. The empty file
    stays, as another process could lock a file that is being removed. Raises ``Unavailable``, at
    once, if another process or thread has locked the file, or if it cannot be opened. If the file
    system supports no locks, raises it too if ``needed``, or else continues without a lock.
    """
    words = f"{path}: cannot be locked"
    try:
        file = path.open("ab")
    except OSError as error:
        raise Unavailable(f"{words}: {error.strerror or error}") from None
    with file:
        try:
            if sys.platform == "win32":
                import msvcrt  # noqa: PLC0415  (Windows only)

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl  # noqa: PLC0415  (not on Windows)

                fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (EAGAIN, EACCES):
                raise Unavailable(
                    f"{path.parent}: another process is using this folder; wait until it has"
                    " ended, or give another folder"
                ) from None
            if needed:
                words += f": {error.strerror or error}; give another folder"
                raise Unavailable(words) from None
        yield
