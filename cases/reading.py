"""Reading a TOML file that may be anything: too large, not text, not a file, nested without end."""

import stat
import tomllib
from pathlib import Path
from typing import Any

from cases.errors import BadInput

MAX_BYTES = 1 << 20
"""A scene is a page of text; what is larger than this is something else."""


def read_toml(path: Path, label: str) -> tuple[dict[str, Any], str]:
    """Return the tables of the TOML file at ``path`` and its text.

    ``label`` names the file in messages. Raises ``BadInput`` with one line for everything that can
    be wrong with the file.
    """
    text = _text(path, label)
    if not text.strip():
        raise BadInput(f"{label}: the file is empty; a scene needs at least the table [system]")
    try:
        return tomllib.loads(text), text
    except RecursionError:
        raise BadInput(
            f"{label}: nested too deeply; a scene needs no more than two levels"
        ) from None
    except ValueError as error:  # TOMLDecodeError and numbers of thousands of digits
        raise BadInput(f"{label}: is not valid TOML: {_first(str(error))}") from None


def _text(path: Path, label: str) -> str:
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise BadInput(f"{label}: is a folder; give the scene file in it")
        if not stat.S_ISREG(status.st_mode):
            raise BadInput(f"{label}: is not a regular file; a scene is a TOML file")
        if status.st_size > MAX_BYTES:
            raise BadInput(
                f"{label}: has {status.st_size} bytes; a scene has at most {MAX_BYTES} (1 MiB)"
            )
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise BadInput(f"{label}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a NUL character in the name
        raise BadInput(f"{label}: cannot be read: {error}") from None
    try:
        return content[:MAX_BYTES].decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(
            f"{label}: is not UTF-8 text: byte 0x{content[error.start]:02x} at position"
            f" {error.start}; save the file as UTF-8"
        ) from None


def _first(text: str) -> str:
    return text if len(text) <= 160 else text[:159] + "…"
