"""Checksums of sources: of what a kernel is compiled from, and of all that numbers depend on."""

from collections.abc import Sequence
from pathlib import Path
from pkgutil import iter_modules

from fpk.compiled_laws import law_files
from fpk.compiling import ROOT, checksum

COMPILED = ("arrays", "kernel", "lanes", "random")
PARTS = ("contact", "damping", "linear", "observed", "substeps")
KERNEL = tuple(f"sim/{name}.py" for name in (*COMPILED, *(f"parts/{part}" for part in PARTS)))
"""Files of this room that a kernel is compiled from."""


def kernel_checksum(laws: Sequence[str], root: Path = ROOT) -> int:
    """Return a checksum of the sources that a kernel with contact ``laws`` is compiled from."""
    return checksum([*(root / name for name in KERNEL), *law_files(laws, root)])


def program_checksum(root: Path = ROOT) -> int:
    """Return a checksum of all sources that the numbers of a simulation may depend on."""
    return checksum([*module_files(root / "fpk"), *module_files(root / "sim")])


def module_files(package: Path) -> list[Path]:
    """Return the files of all modules of a package, its own first."""
    files = [package / "__init__.py"]
    for module in iter_modules([str(package)]):
        inside = package / module.name
        files += module_files(inside) if module.ispkg else [inside.with_suffix(".py")]
    return files
