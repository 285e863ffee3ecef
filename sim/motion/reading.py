"""Compiled readers of traces: made at their first call, cached on disk until a source changes."""

from collections.abc import Callable
from functools import cache, wraps
from threading import Lock
from typing import Any

from fpk.compiling import ROOT, checksum
from sim.ensemble import Reader

SOURCES = (
    "sim/arrays.py",
    *(f"sim/motion/{name}.py" for name in ("between", "counting", "passing")),
)
"""Files that the readers are compiled from."""


def reader(make: Callable[[int], Any]) -> Reader:
    """Return the reader that ``make(sources)`` compiles, with the name and docstring of ``make``.

    ``sources`` is the checksum of ``SOURCES``, which the compiled function returns as a constant.
    """
    lock, compiled = Lock(), cache(lambda: make(checksum([ROOT / name for name in SOURCES])))

    @wraps(make)
    def read(*arrays: Any, **numbers: Any) -> None:
        with lock:  # two threads would compile it twice
            function = compiled()
        function(*arrays, **numbers)

    return read
