"""Exceptions of the program, each with a message that a user can act on."""

from pathlib import PurePath
from typing import Any


class InvalidInput(ValueError):
    """A value of the system or of a request that cannot be used, and what would do.

    An example::

        try:
            fpk.System([-1.0], [1.0], [0.1], [0.05])
        except fpk.InvalidInput as error:
            print(error, error.key, error.remedy)
    """

    def __init__(self, key: str, value: Any, remedy: str) -> None:
        """Keep the key, the value and the remedy; the message is one line of the three."""
        self.key, self.value, self.remedy = key, value, remedy
        super().__init__(f"{key} = {one_line_repr(value)}: {remedy}")


class NotApplicable(ValueError):
    """A theory or method whose conditions the system does not meet; the message is the reason.

    An example::

        try:
            fpk.solve(system, ["q2"], methods=["exact"])
        except fpk.NotApplicable as reason:
            print(reason)
    """


class NotCertified(RuntimeError):
    """No answer could be certified, so that there is none; the message says which check failed.

    An answer that misses its tolerance is returned, and its certificate says so. An example::

        try:
            p = fpk.solve(system, ["q2"], methods=["nonintegrable/fem"], tol=1e-10)["q2"]
        except fpk.NotCertified as failure:
            print(failure)
        else:
            print(p.certificate.certified, p.certificate.failures)
    """


class Unavailable(RuntimeError):
    """Something outside that a request needs and cannot use: a file, a cluster; one line."""


def require(fits: Any, key: str, value: Any, remedy: str) -> None:
    """Raise ``InvalidInput`` of the three unless the value ``fits``."""
    if not fits:
        raise InvalidInput(key, value, remedy)


def one_line_repr(value: Any, *, width: int = 60) -> str:
    """Return ``value`` on one line of at most ``width`` characters, as messages quote it."""
    value = str(value) if isinstance(value, PurePath) else value
    text = repr(value.tolist() if hasattr(value, "tolist") else value).replace("\n", " ")
    return text if len(text) <= width else text[: width - 1] + "…"
