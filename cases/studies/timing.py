"""Processor time after a warm-up, repeated, with the first call and the memory apart.

On one thread it is the wall time of an idle machine, whatever else runs beside.
"""

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import nan
from statistics import median, quantiles
from time import process_time
from timeit import repeat
from typing import Any, TypeVar

from fpk.density import Array
from fpk.process import Coefficients, Process

T = TypeVar("T")

MIN_REPEATS, MAX_REPEATS = 3, 21
"""Least and largest number of timed runs."""
ENOUGH = 0.1
"""Seconds of repeats after which no more than ``MIN_REPEATS`` are made."""
LONG = 1.0
"""Seconds of a first run above which it is the only one: its spread and memory stay unknown."""


@dataclass
class Clock:
    """Seconds of processor time spent in the coefficients of the processes given to it."""

    seconds: float = 0.0

    def timed(self, process: Process) -> Process:
        """Return ``process``, the time of its coefficients added to the clock at each call."""

        def coefficients(energies: Array) -> Coefficients:
            values, seconds = timed_first(lambda: process.coefficients(energies))
            self.seconds += seconds
            return values

        return replace(process, coefficients=coefficients)


@dataclass(frozen=True)
class Timing:
    """Median and quartile spread in seconds; what the first call took beyond; peak memory in bytes.

    ``coefficients`` is the part spent in the process's coefficients; ``memory`` is allocated by
    Python and NumPy during one call. Not a number where it was not measured.
    """

    seconds: float
    spread: float = nan
    repeats: int = 1
    first: float = nan
    coefficients: float = nan
    memory: float = nan


def timed_first(work: Callable[[], T]) -> tuple[T, float]:
    """Return the value of one call and its seconds of processor time."""
    start = process_time()
    value = work()
    return value, process_time() - start


def timing(work: Callable[[], Any], first: float, clock: Clock | None = None) -> Timing:
    """Time ``work``, which was called once before and took ``first`` seconds then."""
    if first > LONG:
        return Timing(first)
    clock = clock or Clock()
    before = clock.seconds
    times = repeat(work, repeat=MIN_REPEATS, number=1, timer=process_time)
    more = min(int(ENOUGH / max(median(times), 1e-9)), MAX_REPEATS) - MIN_REPEATS
    times += repeat(work, repeat=max(more, 0), number=1, timer=process_time)
    inside = (clock.seconds - before) / len(times)
    middle, (lower, _, upper) = median(times), quantiles(times, n=4, method="inclusive")
    tracemalloc.start()
    try:
        work()
        memory = float(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    first = max(0.0, first - middle)
    return Timing(middle, 0.5 * (upper - lower), len(times), first, inside, memory)
