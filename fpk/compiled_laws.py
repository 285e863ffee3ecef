"""Contact laws of the registry as compiled scalar functions that a kernel can close over."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from inspect import getfile
from pathlib import Path
from typing import Any

import numba
from numba.extending import overload

from fpk.compiling import FLAGS, ROOT, cached_where_possible
from fpk.contact_law import LAWS

Compiled = Any
"""A ``numba.vectorize`` object of signature (law, overlap, exponent), of a single law (overlap,
exponent): kernels that close over one are found again in the disk cache, those that close over an
``njit`` function never are. Each takes 50 ms to load."""

_numba_vectorize: Any = numba.vectorize


def _vectorize(signatures: list[str]) -> Callable[[Any], Compiled]:
    """Return ``numba.vectorize`` with the disk cache, without it where a law has no file."""

    def compiled(function: Any) -> Compiled:
        return cached_where_possible(
            lambda **cache: _numba_vectorize(signatures, **cache)(function)
        )

    return compiled


@lru_cache
def compiled_laws(names: tuple[str, ...], part: str) -> Compiled:
    """Return "force", "energy" or "slope" of the laws, to be called by ``of_law``."""
    functions = [_vectorize(["f8(f8,f8)"])(getattr(LAWS[name], part)) for name in names]
    if len(functions) == 1:
        return functions[0]
    choice = _vectorize(["f8(i8,f8,f8)"])(_only(functions[-1]))
    for function in reversed(functions[:-1]):
        choice = _vectorize(["f8(i8,f8,f8)"])(_first_or(function, choice))
    return choice


def law_files(names: Sequence[str], root: Path = ROOT) -> tuple[Path, ...]:
    """Return the files that the compiled laws ``names`` are made of, below ``root``.

    A law that was typed into a session has no file, and nothing that it is compiled into a cache.
    """
    laws = (Path(getfile(LAWS[name].force)) for name in names)
    own = (root / f.relative_to(ROOT) if f.is_relative_to(ROOT) else f for f in laws)
    compiled = ("fpk/compiling.py", "fpk/compiled_laws.py")
    return (*(root / name for name in compiled), *(f for f in own if not f.name.startswith("<")))


def of_law(function: Compiled, law: int, overlap: float, exponent: float) -> float:
    """Stand for a call of ``compiled_laws`` in compiled code; ``law`` picks one of several."""
    raise NotImplementedError


@overload(of_law, jit_options={"fastmath": FLAGS, "error_model": "numpy", "forceinline": True})
def _of_law(function, law, overlap, exponent):  # type: ignore[no-untyped-def]
    """Return the call that the type of ``function`` asks for; None, for no law, gives 0."""
    if isinstance(function, numba.types.NoneType):
        return lambda function, law, overlap, exponent: 0.0
    if getattr(getattr(function, "typing_key", None), "nin", 3) == 2:
        return lambda function, law, overlap, exponent: function(overlap, exponent)
    return lambda function, law, overlap, exponent: function(law, overlap, exponent)


def _only(function: Compiled) -> Callable[[Any, Any, Any], Any]:
    def only(law: Any, x: Any, e: Any) -> Any:
        return function(x, e)

    return only


def _first_or(first: Compiled, others: Compiled) -> Callable[[Any, Any, Any], Any]:
    def first_or(law: Any, x: Any, e: Any) -> Any:
        return first(x, e) if law == 0 else others(law - 1, x, e)

    return first_or
