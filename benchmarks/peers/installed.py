"""Whether a peer is installed, and in which version."""

import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType

MISSING = 3
"""Exit status of a script whose peer is not installed."""


def need(module: str) -> ModuleType:
    """Return the module, or exit with the status ``MISSING``, naming it."""
    try:
        return import_module(module)
    except ImportError as error:
        print(f"missing: {module} ({error})", file=sys.stderr)
        sys.exit(MISSING)


def version_of(package: str) -> str:
    """Return the installed version of a distribution."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "–"
