"""Checksums of sources: of what a kernel is compiled from, and of all that numbers depend on."""

from pathlib import Path
from zlib import crc32

ROOT = Path(__file__).parents[1]

KERNEL = ("arrays.py", "compiled_laws.py", "kernel.py", "lanes.py", "random.py", "parts/**/*.py")
"""Files of this room that a kernel is compiled from; the contact laws are in ``fpk/laws``."""


def kernel_stamp(root: Path = ROOT) -> int:
    """Return a checksum of the sources that a kernel is compiled from."""
    patterns = [f"sim/{name}" for name in KERNEL] + ["fpk/laws/**/*.py"]
    return _checksum(root, patterns)


def program_stamp(root: Path = ROOT) -> int:
    """Return a checksum of all sources that the numbers of a simulation may depend on."""
    return _checksum(root, ["sim/**/*.py", "fpk/**/*.py"])


def _checksum(root: Path, patterns: list[str]) -> int:
    files = sorted(file for pattern in patterns for file in root.glob(pattern))
    return crc32(b"".join(file.read_bytes() for file in files))
