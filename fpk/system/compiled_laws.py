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
    """Numba type for one ``part`` ("force", "energy" or "slope") of the contact laws ``names``.

    Compiled code evaluates it by ``of_law``. The value is its own type and plain data, so that a
    kernel that closes over it is reused from the disk cache. ``stamps``, fingerprints of the
    laws, distinguish different laws of one name.
    """

    names: tuple[str, ...]
    part: str
    stamps: tuple[str, ...]

    def __post_init__(self) -> None:
        """Give the numba type a name made of all fields."""
        super().__init__(name=f"CompiledLaws{self.names, self.part, self.stamps}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the fields: numba's own pickle has a number that differs between processes."""
        return CompiledLaws, (self.names, self.part, self.stamps)


def compile_laws(names: tuple[str, ...], part: str) -> CompiledLaws:
    """Return the ``part`` "force", "energy" or "slope" of the laws ``names``, for ``of_law``."""
    stamps = (fingerprint(getattr(LAWS[name], part)) for name in names)
    return CompiledLaws(names, part, tuple(stamps))


def law_files(names: Sequence[str], root: Path = ROOT) -> tuple[Path, ...]:
    """Return the source files on which code compiled with the laws ``names`` depends.

    The first two belong to this program; then comes the file of the force of each law. Files of
    this program are taken below ``root``, files of users from where they are. A law typed into an
    interactive session has no file and is left out.
    """
    laws = (Path(getfile(LAWS[name].force)) for name in names)
    own = (root / f.relative_to(ROOT) if f.is_relative_to(ROOT) else f for f in laws)
    compiled = (root / "fpk/numeric/compiling.py", root / "fpk/system/compiled_laws.py")
    return *compiled, *(f for f in own if not f.name.startswith("<"))


def of_law(function: Any, law: int, overlap: float, exponent: float) -> float:
    """Return force, energy or slope of a law at unit stiffness, at ``overlap`` and ``exponent``.

    ``function`` is from ``compile_laws``, ``law`` is the number of the law, from 0, in its names;
    ``function`` None gives 0. Raises ``NotImplementedError`` in Python: for compiled code only.
    """
    raise NotImplementedError


@overload(of_law, jit_options={"fastmath": FLAGS, "error_model": "numpy", "forceinline": True})
def _of_law(function, law, overlap, exponent):  # type: ignore[no-untyped-def]
    """Return ``of_law`` as a function to compile for the numba type ``function``."""
    if isinstance(function, types.NoneType):
        return lambda function, law, overlap, exponent: 0.0
    compiled = numba.njit(error_model="numpy")  # no liberties: a law is what its file says
    laws = function.instance_type
    *others, last = (compiled(getattr(LAWS[name], laws.part)) for name in laws.names)
    if not others:
        return lambda function, law, overlap, exponent: last(overlap, exponent)

    def chosen(first: Any, after: Any) -> Any:
        """Return f(law, x, e): ``first(x, e)`` if law is 0, else ``after(law − 1, x, e)``."""
        return compiled(lambda law, x, e: first(x, e) if law == 0 else after(law - 1, x, e))

    choice = compiled(lambda law, x, e: last(x, e))
    for part in reversed(others):
        choice = chosen(part, choice)
    return lambda function, law, overlap, exponent: choice(law, overlap, exponent)
