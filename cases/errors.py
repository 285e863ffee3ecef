"""Input that is refused: the one exception that the command line turns into exit status 2."""

import json
from typing import Any

from fpk.errors import shown


class BadInput(ValueError):
    """What a user gave and cannot be used; the message is one line that says what would do."""

    def __init__(self, message: str) -> None:
        """Keep ``message`` on one line, whatever was quoted in it."""
        super().__init__(one_line(message))


def refused(where: str, key: str, value: Any, remedy: str) -> BadInput:
    """Return the refusal of ``key = value`` in the file or option ``where``."""
    return BadInput(f"{where}: {key} = {toml_value(value)}: {remedy}")


def toml_value(value: Any) -> str:
    """Return ``value`` on one short line, written as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = json.dumps(value, ensure_ascii=False)
        return text if len(text) <= 60 else text[:58] + '…"'
    if isinstance(value, int) and abs(value) >= 10**20:
        return f"(a whole number of {value.bit_length() * 30103 // 100000 + 1} digits)"
    return shown(value)


def one_line(text: str) -> str:
    """Return ``text`` with every character that would break or hide the line written out."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
