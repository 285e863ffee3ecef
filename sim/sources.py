"""Checksums of sources: of what a kernel is compiled from, and of all that numbers depend on."""

from collections.abc import Sequence
from pathlib import Path

from fpk.compiled_laws import law_files
from fpk.compiling import ROOT, checksum

PARTS = ("contact", "damping", "linear", "observed", "substeps")
NAMES = ("arrays", "kernel", "lanes", "random", *(f"parts/{part}" for part in PARTS))
KERNEL = tuple(f"sim/{name}.py" for name in NAMES)
"""Files of this room that a kernel is compiled from."""


def kernel_checksum(laws: Sequence[str], root: Path = ROOT) -> int:
    """Return a checksum of the sources that a kernel with contact ``laws`` is compiled from."""
    return checksum([*(root / name for name in KERNEL), *law_files(laws, root)])


def program_checksum(root: Path = ROOT) -> int:
    """Return a checksum of all sources that the numbers of a simulation may depend on."""
    rooms = [root / "fpk", root / "sim"]
    # A room that is missing is an error, not empty.
    return checksum([f for r in rooms for f in (r / "__init__.py", *sorted(r.rglob("*.py")))])
