"""Options and disk cache of compiled code: liberties of arithmetic, checksums of its sources."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar
from zlib import crc32

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

FLAGS = {"contract", "nsz", "arcp", "afn"}
"""Liberties of arithmetic that are taken: none that assumes there is no NaN, and no reassociation,
which would undo exact differences."""

NO_FOLDER = "no locator available"
"""Message of numba where neither the source's cache folder nor the user's can be written."""

_njit: Any = numba.njit


def cached_where_possible(compiled: Callable[..., Any]) -> Any:
    """Return ``compiled(cache=True)``, or ``compiled()`` where no cache folder can be written.

    It is then compiled again in every process. Any other error of numba is raised.
    """
    try:
        return compiled(cache=True)
    except RuntimeError as error:
        if NO_FOLDER not in str(error):
            raise
        return compiled()


def cached_njit(flags: set[str] = FLAGS) -> Callable[[Function], Function]:
    """Return the decorator of a compiled function with a disk cache where one can be written."""

    def decorated(function: Function) -> Function:
        options = {"fastmath": flags, "error_model": "numpy", "nogil": True}
        cached: Function = cached_where_possible(
            lambda **cache: _njit(**cache, **options)(function)
        )
        return cached

    return decorated


def inlined(function: Function) -> Function:
    """Return the function compiled as a part of each compiled function that calls it.

    It cannot be called from Python, as compiling the code for that takes long.
    """
    options = {"fastmath": FLAGS, "error_model": "numpy", "forceinline": True}
    compiled: Function = _njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)
    return compiled


ROOT = Path(__file__).parents[1]


def checksum(files: Sequence[Path]) -> int:
    """Return a checksum of source files; one that is missing raises ``FileNotFoundError``.

    The disk cache of a compiled function reads the function's own file only. A function that closes
    over the checksum of all that it is compiled from, and returns it, is compiled again when any of
    it was edited.
    """
    return crc32(b"".join(file.read_bytes() for file in files))
