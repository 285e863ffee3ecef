"""What the pages of measurements share: their command line, the machine, tables, timing."""

import argparse
import os
import platform
import statistics
from collections.abc import Callable, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

PACKAGES = ("numpy", "scipy", "scikit-fem", "numba")


def machine() -> str:
    """Return one line: processor, cores, Python, library versions and the date."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        processor = names[0].split(":", 1)[1].strip() if names else processor
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    cores = len(os.sched_getaffinity(0))
    python = platform.python_version()
    return f"{processor}, {cores} cores; Python {python}, {versions}; {date.today()}"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def write_page(title: str, script: str, words: str, body: Callable[[], str], out: str) -> None:
    """Write the page ``out``, or that of ``--out``: title, script and machine, words, body."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=Path(out))
    path = parser.parse_args().out
    written = f"Written by `benchmarks/{script}`. {machine()}."
    begin = f"{written} {words}".strip()
    path.write_text(f"# {title}\n\n{begin}\n\n{body()}", encoding="utf-8")


def medians(
    work: Callable[[], object],
    *,
    repeats: int,
    longest: float = float("inf"),
    clock: Callable[[], float] = perf_counter,
) -> float:
    """Return the median seconds of ``work`` after a warm-up, by ``clock``.

    Repeated at most ``repeats`` times, and no further once ``longest`` seconds have been spent.
    """
    work()
    times: list[float] = []
    while not times or (len(times) < repeats and sum(times) < longest):
        start = clock()
        work()
        times.append(clock() - start)
    return statistics.median(times)
