"""Wall time of work, by which limits of time are kept: not that in which code is compiled."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from time import perf_counter

_lock = Lock()
_within = 0
_begun = _left_out = 0.0


def working_time() -> float:
    """Return seconds of wall time since some moment, without those ``left_out`` in any thread."""
    with _lock:
        now = perf_counter()
        return now - _left_out - (now - _begun if _within else 0.0)


@contextmanager
def left_out() -> Iterator[None]:
    """Do not count the time of what is within as work: compiling, and loading what was compiled."""
    global _within, _begun, _left_out  # one clock for all threads
    with _lock:
        _begun = _begun if _within else perf_counter()
        _within += 1
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            _left_out += 0.0 if _within else perf_counter() - _begun
