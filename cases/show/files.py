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
    """Write ``text`` in UTF-8 to ``path``, replacing what was there in one step."""
    write_by(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_by(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it there in one step.

    Raises ``BadInput`` with one line when the folder or the disk does not allow it; what was at
    ``path`` is kept then.
    """
    refusal = readable_errors(path, *NOT_WRITTEN)
    with refusal, TemporaryDirectory(prefix=PREFIX, dir=path.parent) as folder:
        temporary = Path(folder) / path.name
        write(temporary)
        os.replace(temporary, path)


def make_folder(path: Path) -> Path:
    """Return the folder at ``path``, made where it is missing; ``BadInput`` where it cannot be."""
    with readable_errors(path, *NOT_WRITTEN):
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=PREFIX, dir=path):
            pass
    return path


@contextmanager
def output_folder(path: Path) -> Iterator[None]:
    """Make the folder at ``path``, if it is missing, that of one command alone in a context.

    What killed processes have left half-written there is removed. Raises ``Unavailable`` where
    another command has it, ``BadInput`` where it cannot be written.
    """
    with lock_file(make_folder(path) / LOCK, needed=False):
        for left in path.glob(f"{PREFIX}{'?' * 8}"):
            rmtree(left, ignore_errors=True)
        yield
