"""Exceptions of the program, each with a message that a user can act on."""

from pathlib import PurePath
from typing import Any


class InvalidInput(ValueError):
    """A value of the system or of a request that cannot be used, and what would do."""

    def __init__(self, key: str, value: Any, remedy: str) -> None:
        """Keep the key, the value and the remedy; the message is one line of the three."""
        self.key, self.value, self.remedy = key, value, remedy
        super().__init__(f"{key} = {shown(value)}: {remedy}")


class NotApplicable(ValueError):
    """A theory or method whose conditions the system does not meet; the message is the reason."""


class NotCertified(RuntimeError):
    """A solver that could not certify its answer; the message says which check failed."""


class Unavailable(RuntimeError):
    """Something outside that a request needs and cannot use: a file, a cluster; one line."""


def reason_of(error: OSError) -> str:
    """Return what the operating system said."""
    return str(error.strerror or error)


def shown(value: Any, *, width: int = 60) -> str:
    """Return ``value`` on one line of at most ``width`` characters, as messages quote it."""
    value = str(value) if isinstance(value, PurePath) else value
    text = repr(value.tolist() if hasattr(value, "tolist") else value).replace("\n", " ")
    return text if len(text) <= width else text[: width - 1] + "…"
