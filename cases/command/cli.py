"""The entry of the command ``fpk``: Ctrl-C is answered from here on, while all else is imported."""

import os
import signal
import sys
from types import FrameType
from typing import Any

LINEAR_ALGEBRA = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
"""Small matrices gain nothing from more threads, which wait for each other where another program
runs: a density of four contact masses took 10 minutes instead of half a minute. What the user's
environment says holds."""


def main() -> None:
    """Run the command line; Ctrl-C ends it in one line and status 130."""
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
    """Answer Ctrl-C: nobody waits for what is being compiled, the main thread is interrupted."""
    getattr(sys.modules.get("fpk.numeric.compiling"), "abandon", bool)()
    signal.default_int_handler(number, frame)


def end(status: Any) -> None:
    """Exit with ``status``, at once where a function is still being compiled for nobody."""
    if getattr(sys.modules.get("fpk.numeric.compiling"), "abandoned", ()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status or 0)
    sys.exit(status)
