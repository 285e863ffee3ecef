"""Files appear under their names whole or not at all."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

from cases.scene.errors import readable_errors
from fpk.numeric.machine import lock_file

NOT_WRITTEN = "cannot be written", "what was there is kept; make room or give another --out"

LOCK, PREFIX = ".fpk.lock", ".fpk-"
"""Name of the lock file in a folder that a command writes to, and beginning of the names of
temporary folders, which have eight more letters."""


def write_text(path: Path, text: str) -> None:
    """Write ``text`` in UTF-8 to ``path``, replacing a file there; raises as ``write_by``."""
    write_by(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_by(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a temporary path, to which it writes, then move that file to ``path``.

    Raises ``BadInput`` if the folder, which must exist, or the disk does not allow it. A file that
    was at ``path`` is replaced in one step, or unchanged after an error.
    """
    refusal = readable_errors(path, *NOT_WRITTEN)
    with refusal, TemporaryDirectory(prefix=PREFIX, dir=path.parent) as folder:
        temporary = Path(folder) / path.name
        write(temporary)
        os.replace(temporary, path)


def make_folder(path: Path) -> Path:
    """Return ``path``, a folder made with its parents if missing; ``BadInput`` if not writable."""
    with readable_errors(path, *NOT_WRITTEN):
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=PREFIX, dir=path):
            pass
    return path


@contextmanager
def output_folder(path: Path) -> Iterator[None]:
    """Return a context in which one command alone writes to the folder ``path``, made if missing.

    Half-written files of killed processes are removed first. Raises ``Unavailable`` if another
    command writes to the folder, ``BadInput`` if it cannot be written.
    """
    with lock_file(make_folder(path) / LOCK, needed=False):
        for left in path.glob(f"{PREFIX}{'?' * 8}"):
            rmtree(left, ignore_errors=True)
        yield
