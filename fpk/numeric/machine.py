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
    """Return the cores that this process may run on; all there are where the system can't say."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def working_time() -> float:
    """Return seconds of wall time since some moment, without those in ``pause_working_time``."""
    with _lock:
        now = perf_counter()
        return now - _left_out - (now - _begun if _within else 0.0)


@contextmanager
def pause_working_time() -> Iterator[None]:
    """Do not count the time of what is within as work: compiling and loading of compiled code."""
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
    """Hold the lock on the file ``path``, made where it is missing, in a context.

    The operating system lifts it when the process ends, killed or not; the empty file stays, as
    another process could lock a file that is being removed. Raises ``Unavailable`` where another
    process or thread holds the lock, or the file system has no locks and one is ``needed``.
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
