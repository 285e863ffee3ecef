"""One process at a time writes the files of a run: a lock that ends with its process."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EACCES, EAGAIN
from pathlib import Path

from fpk.errors import Unavailable, reason_of

if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _take(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def locked(path: Path, *, needed: bool = True) -> Iterator[None]:
    """Hold the lock on the file ``path``, made where it is missing, in a context.

    The operating system lifts it when the process ends, killed or not; the empty file stays, as
    another process could otherwise lock a file that is being removed. Raises ``Unavailable``, one
    line, where another process or thread holds the lock, or, unless it is not ``needed``, where the
    file system has no locks.
    """
    words = f"{path}: cannot be locked"
    try:
        file = path.open("ab")
    except OSError as error:
        raise Unavailable(f"{words}: {reason_of(error)}") from None
    with file:
        try:
            _take(file.fileno())
        except OSError as error:
            if error.errno in (EAGAIN, EACCES):
                raise Unavailable(
                    f"{path.parent}: another process is using this folder; wait until it has"
                    " ended, or give another folder"
                ) from None
            if needed:
                raise Unavailable(f"{words}: {reason_of(error)}; give another folder") from None
        yield
