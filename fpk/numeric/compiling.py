"""Options and disk cache of compiled code; Ctrl-C does not wait for compiling.

The cache holds checksums of its files and of the sources that they were made from.
"""

import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import contextmanager, suppress
from functools import partial
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, TypeVar
from zlib import crc32

import numba
from numba.core.caching import IndexDataCacheFile

from fpk.numeric.machine import pause_working_time

Function = TypeVar("Function", bound=Callable[..., Any])

ROOT = Path(__file__).parents[2]
FLAGS = {"contract", "nsz", "arcp", "afn"}
"""Liberties of arithmetic that are taken: none that assumes there is no NaN, and no reassociation,
which would undo exact differences."""

COMPILER = "fpk compiler"
"""Name of the threads that compile."""

_njit: Any = numba.njit
_awaited: set[Future[Any]] = set()
abandoned: set[Future[Any]] = set()
"""Results of compiling that goes on although the caller was interrupted."""


class CheckedFiles(IndexDataCacheFile):
    """Index and data files of one function's disk cache, each with a checksum at its end.

    numba unpickles and executes whatever they hold, but not where the SHA-256 at the end shows
    damage. Data are stored with their key: two processes may have given one name to two of them.
    """

    def load(self, key: Any) -> Any:
        """Return the data of ``key``; None where there are none or they are damaged."""
        stored_key, data = super().load(key) or (None, None)
        return data if stored_key == key else None

    def save(self, key: Any, data: Any) -> None:
        """Write the data of ``key``; where that fails the next process compiles anew."""
        try:
            super().save(key, (key, data))
        except OSError as error:
            warnings.warn(f"{self._index_path}: cannot be written: {error}", stacklevel=2)

    def _load_index(self) -> Any:
        if not _is_whole(Path(self._index_path)):
            return {}
        try:
            return super()._load_index()
        except (ImportError, AttributeError):  # it names a type that another version had elsewhere
            return {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if _is_whole(Path(self._data_path(name))) else None

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        content = BytesIO()
        with super()._open_for_write(filepath) as file:
            yield content
            file.write(content.getvalue() + sha256(content.getvalue()).digest())


def _is_whole(path: Path) -> bool:
    """Whether a cache file is as written or not there; a damaged one is removed, with a warning."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return True
    except OSError:
        content = b""
    size = sha256().digest_size
    whole = sha256(content[:-size]).digest() == content[-size:]
    if not whole:
        warnings.warn(f"{path}: is damaged; the code in it is compiled again", stacklevel=2)
        with suppress(OSError):
            path.unlink()
    return whole


def interruptible_compile(compile_for: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return ``compile_for``, a function of a signature, run in a thread named ``COMPILER``.

    LLVM ignores signals for many seconds; a thread that waits for another receives them. Raises
    ``KeyboardInterrupt`` where ``abandon`` is called meanwhile, and until the abandoned function is
    compiled: numba compiles one function at a time.
    """

    def compiled(signature: Any) -> Any:
        if threading.current_thread().name == COMPILER:  # for a function that calls this one
            return compile_for(signature)
        if abandoned:
            raise KeyboardInterrupt
        result = Future[Any]()

        def work() -> None:
            try:
                done = partial(result.set_result, compile_for(signature))
            except BaseException as error:
                done = partial(result.set_exception, error)
            with suppress(InvalidStateError):  # abandoned
                done()
            abandoned.discard(result)

        _awaited.add(result)
        try:
            with pause_working_time():
                threading.Thread(target=work, name=COMPILER).start()
                return result.result()
        finally:
            _awaited.discard(result)

    return compiled


def abandon() -> None:
    """Raise ``KeyboardInterrupt`` in all threads that wait for a function to be compiled.

    Compiling itself cannot be ended: a process ends after it, or by ``os._exit``.
    """
    for result in tuple(_awaited):
        abandoned.add(result)
        try:
            result.set_exception(KeyboardInterrupt())
        except InvalidStateError:  # it is there
            abandoned.discard(result)


def cached_njit() -> Callable[[Function], Function]:
    """Return the decorator of a compiled function with a disk cache.

    Where no folder can be written it is compiled again in every process. Ctrl-C does not wait.
    """

    def decorated(function: Function) -> Function:
        compiled = _njit(fastmath=FLAGS, error_model="numpy", nogil=True)(function)
        compiled.compile = interruptible_compile(compiled.compile)
        try:
            compiled.enable_caching()
        except RuntimeError as error:
            # numba's message where neither the source's cache folder nor the user's can be written
            if "no locator available" not in str(error):
                raise
        else:
            cache = compiled._cache
            files = cache._cache_file
            # A name of its own: files of numba's own format are not damaged, only of no use here.
            name = files._index_name.removesuffix(".nbi") + ".sha256"
            cache._cache_file = CheckedFiles(cache._cache_path, name, files._source_stamp)
        result: Function = compiled
        return result

    return decorated


def njit_inline(function: Function) -> Function:
    """Return the function compiled into each compiled function that calls it, not for Python."""
    options = {"fastmath": FLAGS, "error_model": "numpy", "forceinline": True}
    compiled: Function = _njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)
    return compiled


def checksum(files: Sequence[Path]) -> int:
    """Return a checksum of source files, for compiled functions to close over and return.

    They are compiled again when one is edited: numba watches the file of the function only.
    """
    return crc32(b"".join(file.read_bytes() for file in files))
