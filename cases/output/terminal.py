"""Progress on standard error: shown on a terminal, silent elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from fpk.method import Progress, silent


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Yield a progress callback; it draws where standard error is a terminal."""
    if not sys.stderr.isatty():
        yield silent
        return
    from cases.output.bar import drawn_progress  # takes longer to import than many an answer

    with drawn_progress() as progress:
        yield progress
