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
"""Lock of a folder that a command writes to; how temporary folders begin, of eight more letters."""


def write_text(path: Path, text: str) -> None:
    """Write ``text`` in UTF-8 to ``path``; a file that was there is replaced in one step."""
    write_by(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_by(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it there in one step.

    Raises ``BadInput`` with one line if the folder or the disk does not allow it; the file that was
    at ``path`` is unchanged then.
    """
    refusal = readable_errors(path, *NOT_WRITTEN)
    with refusal, TemporaryDirectory(prefix=PREFIX, dir=path.parent) as folder:
        temporary = Path(folder) / path.name
        write(temporary)
        os.replace(temporary, path)


def make_folder(path: Path) -> Path:
    """Return the folder at ``path``, made if missing; ``BadInput`` if it cannot be written."""
    with readable_errors(path, *NOT_WRITTEN):
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=PREFIX, dir=path):
            pass
    return path


@contextmanager
def output_folder(path: Path) -> Iterator[None]:
    """Lock the folder at ``path`` for one command; it is made if it is missing.

    Half-written files of killed processes are removed from it. Raises ``Unavailable`` if another
    command writes to it, ``BadInput`` if it cannot be written.
    """
    with lock_file(make_folder(path) / LOCK, needed=False):
        for left in path.glob(f"{PREFIX}{'?' * 8}"):
            rmtree(left, ignore_errors=True)
        yield
