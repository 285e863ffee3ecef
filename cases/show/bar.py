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
"""Seconds before a bar appears."""

CLEAR = "\r\x1b[K\x1b[?25h"
"""Empties the line of a terminal, and shows the cursor, which a bar hides."""


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Yield a progress callback: on a terminal it draws the bar of the present task."""
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
    """Says that something is being compiled, which takes a while and happens once."""

    def on_start(self, event: Any) -> None:
        """Say so in the line of the bar."""
        sys.stderr.write(f"{CLEAR}compiling, this once")
        sys.stderr.flush()

    def on_end(self, event: Any) -> None:
        """Leave the words to the next bar, which is drawn over them."""
