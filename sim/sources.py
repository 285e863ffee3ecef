"""Checksums of sources: of what a kernel is compiled from, and of all that numbers depend on."""

from pathlib import Path

from fpk.compiling import LAWS, ROOT, checksum

KERNEL = ("arrays.py", "kernel.py", "lanes.py", "random.py", "parts/**/*.py")
"""Files of this room that a kernel is compiled from."""


def kernel_stamp(root: Path = ROOT) -> int:
    """Return a checksum of the sources that a kernel is compiled from."""
    return checksum([*(f"sim/{name}" for name in KERNEL), *LAWS], root)


def program_stamp(root: Path = ROOT) -> int:
    """Return a checksum of all sources that the numbers of a simulation may depend on."""
    return checksum(["sim/**/*.py", "fpk/**/*.py"], root)
