"""A bar of progress on a terminal, and a word where something is being compiled."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

from numba.core import event
from rich.console import Console
from rich.progress import BarColumn, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from fpk.method import Progress

PATIENCE = 1.0
"""Seconds before a bar appears."""


@contextmanager
def drawn_progress() -> Iterator[Progress]:
    """Yield a progress callback that draws one bar a task on standard error."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    bar = RichProgress(*columns, TimeRemainingColumn(), console=console, transient=True)
    start, tasks = perf_counter(), {}

    def report(done: int, total: int, what: str) -> None:
        if perf_counter() - start < PATIENCE:
            return
        if not bar.live.is_started:
            bar.start()
        if what not in tasks:
            tasks[what] = bar.add_task(what, total=total)
        bar.update(tasks[what], completed=done, total=total)

    try:
        with event.install_listener("numba:compile", _Compiling(bar)):
            yield report
    finally:
        bar.stop()


class _Compiling(event.Listener):
    """Says on the bar that something is being compiled, which takes a while and happens once."""

    def __init__(self, bar: RichProgress) -> None:
        """Nothing is compiled yet; functions may be compiled within each other."""
        self.bar, self.tasks = bar, list[TaskID]()

    def on_start(self, event: Any) -> None:
        """Show a task, as long as the outermost function takes."""
        self.bar.start()
        first = not self.tasks
        self.tasks.append(self.bar.add_task("compiling, this once", total=None, visible=first))

    def on_end(self, event: Any) -> None:
        """Take it away when it is done."""
        self.bar.remove_task(self.tasks.pop())
