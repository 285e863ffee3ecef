"""Options and disk cache of code compiled by numba; Ctrl-C interrupts the wait for the compiler.

The cache stores checksums of its files and of the sources from which they were compiled.
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
"""Fast-math flags of LLVM: none that assumes the absence of NaN, and no reassociation, which would
spoil differences of nearly equal numbers."""

COMPILER = "fpk compiler"
"""Name of the threads in which functions are compiled."""

_njit: Any = numba.njit
_awaited: set[Future[Any]] = set()
abandoned: set[Future[Any]] = set()
"""Futures of compilations that still run although their callers were interrupted."""


class CheckedFiles(IndexDataCacheFile):
    """Index and data files of one function's disk cache, each with its SHA-256 at the end.

    numba unpickles and executes the content of these files, so a file whose checksum does not match
    is not read. Data are stored with their key: two processes may use one file name for two keys.
    """

    def load(self, key: Any) -> Any:
        """Return the data stored under ``key``; None if there are none or they are damaged."""
        stored_key, data = super().load(key) or (None, None)
        return data if stored_key == key else None

    def save(self, key: Any, data: Any) -> None:
        """Store ``data`` under ``key``; if the disk refuses, warn: the next process recompiles."""
        try:
            super().save(key, (key, data))
        except OSError as error:
            warnings.warn(f"{self._index_path}: cannot be written: {error}", stacklevel=2)

    def _load_index(self) -> Any:
        if not _is_whole(Path(self._index_path)):
            return {}
        try:
            return super()._load_index()
        except (ImportError, AttributeError):  # written by a version with a type in another module
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
    """Return whether the file ``path`` ends with the SHA-256 of the content before, or is absent.
    Warn and try to remove the file if not, or if it cannot be read."""
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
    """Return ``compile_for``, a function of a signature, wrapped to run in a thread of its own.

    LLVM ignores signals for many seconds, while a thread that waits for another receives them. The
    wrapped function waits for the thread, with the clock ``working_time`` stopped, and returns or
    raises what ``compile_for`` does. It raises ``KeyboardInterrupt`` if ``abandon`` is called
    meanwhile, and as long as an abandoned function is still being compiled.
    """

    def compiled(signature: Any) -> Any:
        if threading.current_thread().name == COMPILER:  # compiling a function that calls this
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
    """Raise ``KeyboardInterrupt`` in all threads that wait for a function to be compiled. The
    compilation itself goes on: the process ends after it, or at once by ``os._exit``."""
    for result in tuple(_awaited):
        abandoned.add(result)
        try:
            result.set_exception(KeyboardInterrupt())
        except InvalidStateError:  # compiled in the meantime
            abandoned.discard(result)


def cached_njit(sources: int = 0) -> Callable[[Function], Function]:
    """Return a decorator by which numba compiles a function at its first call, with a disk cache.

    ``sources`` is the ``checksum`` of all files whose code is compiled with the function; 0 if that
    is its own file only, which numba watches. Another checksum has another cache file. Without a
    writable folder the function is compiled again in every process.
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
            # Not numba's file name: its files have no checksum and would count as damaged.
            name = f"{files._index_name.removesuffix('.nbi')}.{sources}.sha256"
            cache._cache_file = CheckedFiles(cache._cache_path, name, files._source_stamp)
        result: Function = compiled
        return result

    return decorated


def njit_inline(function: Function) -> Function:
    """Return ``function`` for use in compiled functions, inlined there; Python cannot call it."""
    options = {"fastmath": FLAGS, "error_model": "numpy", "forceinline": True}
    compiled: Function = _njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)
    return compiled


def checksum(files: Sequence[Path]) -> int:
    """Return the CRC-32 of the contents of ``files``, joined in the given order. A function that
    closes over it or is decorated by ``cached_njit`` with it is compiled again after an edit."""
    return crc32(b"".join(file.read_bytes() for file in files))
