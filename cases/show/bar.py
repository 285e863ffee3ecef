"""A bar of progress on a terminal, and a word where something is being compiled."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import click
from numba.core import event

from fpk.answer.method import Progress, silent

BAR_AFTER = 1.0
"""Seconds after the start of ``progress_bar`` from which bars are drawn."""

CLEAR = "\r\x1b[K\x1b[?25h"
"""Control characters that empty the current line of a terminal and show the cursor again, which a
bar hides."""


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Return a context with a callback ``(done, total, what)`` that draws a bar for each ``what``.

    ``done`` is all work so far. The bars, and words while numba compiles, are on standard error;
    if that is no terminal, the callback does nothing.
    """
    if not sys.stderr.isatty():
        yield silent
        return
    start, bars = perf_counter(), dict[str, Any]()

    def report(done: int, total: int, what: str) -> None:
        if perf_counter() - start < BAR_AFTER:
            return
        if what not in bars:
            bars[what] = click.progressbar(length=total, label=what, file=sys.stderr)
        bars[what].length = total
        bars[what].update(done - bars[what].pos)

    try:
        with event.install_listener("numba:compile", _Compiling()):
            yield report
    finally:
        sys.stderr.write(CLEAR)


class _Compiling(event.Listener):
    """Listener to numba that says on standard error when a function is being compiled."""

    def on_start(self, event: Any) -> None:
        """Replace the line of the bar by words; ``event`` is not used."""
        sys.stderr.write(f"{CLEAR}compiling, this once")
        sys.stderr.flush()

    def on_end(self, event: Any) -> None:
        """Do nothing: the next bar is drawn over the words."""
