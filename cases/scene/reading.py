"""Reading a TOML file that may be anything: too large, not text, not a file, nested without end."""

import re
import stat
import tomllib
from pathlib import Path
from typing import Any

from cases.scene.errors import BadInput, readable_errors

MAX_BYTES = 1 << 20
"""A scene is a page of text; what is larger than this is something else."""

MAX_DEPTH = 16
"""Levels of tables and lists, and parts of a dotted key; a scene needs five. Some hundreds exhaust
the stack of what follows, and the parser takes a time of n² for a key of n parts."""

NO_KEY = re.compile(
    r""""{3}(?:\\.?|[^\\])*?(?:"{3}|\Z) | '{3}.*?(?:'{3}|\Z)
      | "(?:\\.|[^"\\\n])*+"? | '[^'\n]*+'? | \#[^\n]* | \d\.\d""",
    re.VERBOSE | re.DOTALL,
)
"""Texts, comments and decimal points: the dots that are left in a line are those of dotted keys."""


def read_toml(path: Path, label: str) -> tuple[dict[str, Any], str]:
    """Return the tables of the TOML file at ``path`` and its text, without a byte order mark.

    ``label`` names the file in messages. Raises ``BadInput`` with one line for everything that can
    be wrong with the file.
    """
    text = read_text(path, label, most=MAX_BYTES, what="a scene").removeprefix("\ufeff")
    if not text.strip():
        raise BadInput(f"{label}: the file is empty; a scene needs at least the table [system]")
    too_deep = BadInput(f"{label}: nested too deeply; a scene has at most {MAX_DEPTH} levels")
    if any(line.count(".") > MAX_DEPTH for line in NO_KEY.sub("", text).splitlines()):
        raise too_deep
    try:
        tables = tomllib.loads(text)
        depth = _depth(tables)
    except RecursionError:
        raise too_deep from None
    except ValueError as error:  # TOMLDecodeError and numbers of thousands of digits
        raise BadInput(f"{label}: is not valid TOML: {error}; correct it there") from None
    if depth > MAX_DEPTH:
        raise too_deep
    return tables, text


def read_text(path: Path, label: str, *, most: int, what: str) -> str:
    """Return the UTF-8 text of a regular file of at most ``most`` bytes, ``what`` it should be.

    Nothing is read of a file that is larger, of a folder, a pipe or a device, which may have no
    end. Raises ``BadInput`` with one line that begins with ``label``.
    """
    with readable_errors(label, "cannot be read", "give another file"):
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise BadInput(f"{label}: is a folder; {what} is a file in it")
        if not stat.S_ISREG(mode):
            raise BadInput(f"{label}: is not a regular file; {what} is one")
        with path.open("rb") as stream:
            content = stream.read(most + 1)
    if len(content) > most:
        few = f"{what} has at most {most} ({most >> 20} MiB)"
        raise BadInput(f"{label}: has more than {most} bytes; {few}")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(
            f"{label}: is not UTF-8 text: byte 0x{content[error.start]:02x} at position"
            f" {error.start}; save the file as UTF-8"
        ) from None


def _depth(value: Any) -> int:
    """Levels of tables and lists."""
    if not isinstance(value, (dict, list)):
        return 0
    return 1 + max(map(_depth, value.values() if isinstance(value, dict) else value), default=0)
