"""Progress on standard error: shown on a terminal, after a second, silent elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from fpk.method import Progress, silent

PATIENCE = 1.0
"""Seconds before a bar appears."""


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Yield a progress callback that draws one bar a task on standard error."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield silent
        return
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
        yield report
    finally:
        bar.stop()
