"""The entry of the command ``fpk``: Ctrl-C is answered from here on, while all else is imported."""

import os
import signal
import sys
from types import FrameType
from typing import Any

LINEAR_ALGEBRA = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
"""Environment variables set unless the user has: one thread for linear algebra. Small matrices gain
nothing from more, and if another program runs, these wait for each other."""


def main() -> None:
    """Run the command line and exit with its status; Ctrl-C ends it in one line and status 130."""
    os.environ.update(LINEAR_ALGEBRA | os.environ)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, answer_interrupt)
    try:
        from cases.command.app import run_app

        run_app()
    except KeyboardInterrupt:
        sys.stderr.write("fpk: stopped; nothing half-written was left\n")
        end(130)
    except SystemExit as status:
        end(status.code)


def answer_interrupt(number: int, frame: FrameType | None) -> None:
    """Handle SIGINT: raise ``KeyboardInterrupt`` here and in threads that wait for compilations."""
    getattr(sys.modules.get("fpk.numeric.compiling"), "abandon", bool)()
    signal.default_int_handler(number, frame)


def end(status: Any) -> None:
    """Exit with ``status``, at once if a compilation that Ctrl-C has abandoned still runs."""
    if getattr(sys.modules.get("fpk.numeric.compiling"), "abandoned", ()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status or 0)
    sys.exit(status)
