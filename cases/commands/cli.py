"""The entry of the command ``fpk``: Ctrl-C is answered from here on, while all else is imported."""

import os
import sys

LINEAR_ALGEBRA = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
"""Small matrices gain nothing from more threads, which wait for each other where another program
runs: a density of four contact masses took 10 minutes instead of half a minute. What the user's
environment says holds."""


def main() -> None:
    """Run the command line; Ctrl-C ends it in one line and status 130."""
    os.environ.update(LINEAR_ALGEBRA | os.environ)
    try:
        from cases.commands.app import run_app

        run_app()
    except KeyboardInterrupt:
        sys.stderr.write("fpk: stopped; nothing half-written was left\n")
        sys.exit(130)
