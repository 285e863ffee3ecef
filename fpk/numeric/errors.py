"""Exceptions of the program; each message says what was given and what to do."""

from pathlib import PurePath
from typing import Any


class InvalidInput(ValueError):
    """A value of the system or of a request that cannot be used, with a remedy.

    An example::

        try:
            fpk.System([-1.0], [1.0], [0.1], [0.05])
        except fpk.InvalidInput as error:
            print(error, error.key, error.remedy)
    """

    def __init__(self, key: str, value: Any, remedy: str) -> None:
        """Store the name ``key``, the ``value`` and the ``remedy``; the text joins the three."""
        self.key, self.value, self.remedy = key, value, remedy
        super().__init__(f"{key} = {one_line_repr(value)}: {remedy}")


class NotApplicable(ValueError):
    """The system does not meet the conditions of a theory or method; the message is the reason.

    An example::

        try:
            fpk.solve(system, ["q2"], methods=["exact"])
        except fpk.NotApplicable as reason:
            print(reason)
    """


class NotCertified(RuntimeError):
    """No answer exists that could be certified; the message says which check failed.

    An answer that only misses its tolerance is returned, and its certificate says so. An example::

        try:
            p = fpk.solve(system, ["q2"], methods=["nonintegrable/fem"], tol=1e-10)["q2"]
        except fpk.NotCertified as failure:
            print(failure)
        else:
            print(p.certificate.certified, p.certificate.failures)
    """


class Unavailable(RuntimeError):
    """A request needs a file, package or cluster that cannot be used; the message is one line."""


def require(fits: Any, key: str, value: Any, remedy: str) -> None:
    """Raise ``InvalidInput(key, value, remedy)`` unless ``fits``."""
    if not fits:
        raise InvalidInput(key, value, remedy)


def one_line_repr(value: Any, *, width: int = 60) -> str:
    """Return the repr of ``value`` on one line, cut to ``width`` characters, for messages. The last
    of them is "…" if it was cut; an array is shown as a list, a path as a string."""
    value = str(value) if isinstance(value, PurePath) else value
    text = repr(value.tolist() if hasattr(value, "tolist") else value).replace("\n", " ")
    return text if len(text) <= width else text[: width - 1] + "…"
