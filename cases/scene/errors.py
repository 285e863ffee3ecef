"""Refused input: the exception ``BadInput``, for exit status 2, and the parts of its messages."""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import date, time
from itertools import islice, zip_longest
from typing import Any

from fpk.numeric.errors import InvalidInput, one_line_repr

LONGEST = 600
"""Largest length of a message in characters; longer messages are cut in the middle."""

WIDTH = 60
"""Largest length of a quoted value in characters."""


class BadInput(ValueError):
    """Input that cannot be used; the message is one line that says how to correct it."""

    def __init__(self, message: str) -> None:
        """Store ``message`` as one line, its middle left out beyond ``LONGEST`` characters."""
        super().__init__(one_line(message))


@contextmanager
def readable_errors(label: object, words: str, remedy: str) -> Iterator[None]:
    """Turn an ``OSError`` of the block into ``BadInput``: "label: words: reason; remedy".

    ``label`` names the file, ``words`` say which step failed; the reason is the system's. A
    ``ValueError`` becomes ``BadInput`` only if ``label`` contains a NUL, else it is not changed.
    """
    try:
        yield
    except (OSError, ValueError) as error:
        if isinstance(error, ValueError) and "\0" not in str(label):  # which no name may hold
            raise
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"{label}: {words}: {reason}; {remedy}") from None


@contextmanager
def about_key(key: str, value: object) -> Iterator[None]:
    """Re-raise an ``InvalidInput`` of the block with this ``key`` and ``value`` and its remedy."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(key, value, error.remedy) from None


def misspelt(word: str, known: Iterable[str]) -> str | None:
    """Return the first of ``known`` of which ``word`` is a misspelling, None if there is none.

    A misspelling of a word of at least three letters leaves out, adds or replaces one letter or
    swaps two neighbours, as four of five do (Damerau 1964), or is the word itself. Capitals and
    leading dashes are ignored. A common beginning alone is no misspelling.
    """
    for name in known:
        a, b = (text.casefold().lstrip("-") for text in (word, name))
        same = next((k for k, (x, y) in enumerate(zip_longest(a, b)) if x != y), len(a))
        long, a, b = max(len(a), len(b)) >= 3, a[same:], b[same:]
        one = a[1:] in (b, b[1:]) or a == b[1:]
        if long and (one or (a[:2] == b[1::-1] and a[2:] == b[2:])):
            return name
    return None


def toml_value(value: Any) -> str:
    """Return ``value`` on one line as TOML writes it, cut with … to at most ``WIDTH`` characters.

    A whole number of more than 20 digits is replaced by words.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = json.dumps(value[: 2 * WIDTH], ensure_ascii=False)
        return text if len(text) <= WIDTH else text[: WIDTH - 2] + '…"'
    if isinstance(value, int) and abs(value) >= 10**20:
        return f"(a whole number of {value.bit_length() * 30103 // 100000 + 1} digits)"
    if isinstance(value, (date, time)):
        return value.isoformat()
    if isinstance(value, list):
        text = f"[{', '.join(map(toml_value, islice(value, WIDTH)))}]"
    elif isinstance(value, dict):
        pairs = islice(value.items(), WIDTH)
        text = f"{{{', '.join(f'{key} = {toml_value(entry)}' for key, entry in pairs)}}}"
    else:
        text = one_line_repr(value)
    return text if len(text) <= WIDTH else text[: WIDTH - 1] + "…"


def one_line(text: str) -> str:
    """Return ``text`` with line breaks and other unprintable characters as Python's escapes.

    Beyond ``LONGEST`` characters an ellipsis replaces the middle.
    """
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    half = (LONGEST - 1) // 2
    return line if len(line) <= LONGEST else f"{line[:half]}…{line[-half:]}"
