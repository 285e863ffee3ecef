"""Contact laws in compiled code."""

from collections.abc import Sequence
from dataclasses import dataclass
from inspect import getfile
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.extending import overload

from fpk.numeric.compiling import FLAGS, ROOT
from fpk.numeric.recognition import fingerprint
from fpk.system.contact_law import LAWS


@dataclass(eq=False, repr=False)
class CompiledLaws(types.Type):
    """One ``part`` of the laws ``names``, to be called by ``of_law`` in compiled code.

    The value is its own type and plain data, so that a kernel that closes over it is found again
    in the disk cache with its laws. ``stamps`` tell laws of one name apart.
    """

    names: tuple[str, ...]
    part: str
    stamps: tuple[str, ...]

    def __post_init__(self) -> None:
        """Take the name of the type from its parts."""
        super().__init__(name=f"CompiledLaws{self.names, self.part, self.stamps}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the same parts in every process: numba's own key is a number that it gave."""
        return CompiledLaws, (self.names, self.part, self.stamps)


def compile_laws(names: tuple[str, ...], part: str) -> CompiledLaws:
    """Return "force", "energy" or "slope" of the laws, to be called by ``of_law``."""
    stamps = (fingerprint(getattr(LAWS[name], part)) for name in names)
    return CompiledLaws(names, part, tuple(stamps))


def law_files(names: Sequence[str], root: Path = ROOT) -> tuple[Path, ...]:
    """Return the files that the compiled laws ``names`` are made of, below ``root``.

    A law that was typed into a session has no file, and nothing that it is compiled into a cache.
    """
    laws = (Path(getfile(LAWS[name].force)) for name in names)
    own = (root / f.relative_to(ROOT) if f.is_relative_to(ROOT) else f for f in laws)
    compiled = (root / "fpk/numeric/compiling.py", root / "fpk/system/compiled_laws.py")
    return *compiled, *(f for f in own if not f.name.startswith("<"))


def of_law(function: Any, law: int, overlap: float, exponent: float) -> float:
    """Stand for a call of ``compile_laws`` in compiled code; ``law`` picks one of several."""
    raise NotImplementedError


@overload(of_law, jit_options={"fastmath": FLAGS, "error_model": "numpy", "forceinline": True})
def _of_law(function, law, overlap, exponent):  # type: ignore[no-untyped-def]
    """Return the call that the type of ``function`` asks for; None, for no law, gives 0."""
    if isinstance(function, types.NoneType):
        return lambda function, law, overlap, exponent: 0.0
    compiled = numba.njit(error_model="numpy")  # no liberties: a law is what its file says
    laws = function.instance_type
    *others, last = (compiled(getattr(LAWS[name], laws.part)) for name in laws.names)
    if not others:
        return lambda function, law, overlap, exponent: last(overlap, exponent)

    def chosen(first: Any, after: Any) -> Any:
        """The law ``first`` where the number of the law is 0, one of those ``after`` it else."""
        return compiled(lambda law, x, e: first(x, e) if law == 0 else after(law - 1, x, e))

    choice = compiled(lambda law, x, e: last(x, e))
    for part in reversed(others):
        choice = chosen(part, choice)
    return lambda function, law, overlap, exponent: choice(law, overlap, exponent)
