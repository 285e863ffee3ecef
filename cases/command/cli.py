"""The entry of the command ``fpk``: Ctrl-C is answered from here on, while all else is imported."""

import os
import signal
import sys
from types import FrameType
from typing import Any

LINEAR_ALGEBRA = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
"""Environment variables set unless the user has: one thread for linear algebra. Small matrices gain
nothing from more, and if another program runs, these wait for each other."""
leave = os._exit
"""Ends the process with a status, whatever its threads do; a test in the process replaces it."""


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
        end(130, at_once=True)
    except SystemExit as status:
        end(status.code)


def answer_interrupt(number: int, frame: FrameType | None) -> None:
    """Handle SIGINT: raise ``KeyboardInterrupt`` here and in threads that wait for compilations."""
    getattr(sys.modules.get("fpk.numeric.compiling"), "abandon", bool)()
    signal.default_int_handler(number, frame)


def end(status: Any, *, at_once: bool = False) -> None:
    """Exit with ``status``; ``at_once`` or beside an abandoned compilation without its threads.

    Python would wait for every thread that is at work, such as a long solution of a sweep.
    """
    abandoned = getattr(sys.modules.get("fpk.numeric.compiling"), "abandoned", ())
    if at_once or abandoned:
        sys.stdout.flush()
        sys.stderr.flush()
        leave(status or 0)
    sys.exit(status)
