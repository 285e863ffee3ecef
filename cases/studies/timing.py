"""Processor time after a warm-up, repeated, with the first call and the memory apart.

On one thread it is the wall time of a machine that does nothing else; unlike wall time it can be
compared where other work runs beside.
"""

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from statistics import median, quantiles
from time import process_time
from typing import Any

MIN_REPEATS, MAX_REPEATS = 3, 21
ENOUGH = 0.1
"""Seconds of repeats that are enough, once there are ``MIN_REPEATS``."""
LONG = 1.0
"""Seconds of a first run above which it is the only one: compile time and spread stay unknown."""


class Clock:
    """Seconds of processor time spent in the functions given to it."""

    def __init__(self) -> None:
        """Start from zero."""
        self.seconds = 0.0

    def timed(self, function: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Return ``function``, its time added to the clock at each call."""

        def wrapped(argument: Any) -> Any:
            value, seconds = timed_first(lambda: function(argument))
            self.seconds += seconds
            return value

        return wrapped


@dataclass(frozen=True)
class Timing:
    """Median and quartile spread in seconds; what the first call took beyond; peak memory.

    ``coefficients`` is the part spent in the process's coefficients; ``memory`` in bytes as
    allocated by Python and NumPy during one call. Not a number where it was not measured.
    """

    seconds: float
    spread: float = nan
    repeats: int = 1
    first: float = nan
    coefficients: float = nan
    memory: float = nan


def timed_first(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the value of the first call and its seconds of processor time."""
    start = process_time()
    value = work()
    return value, process_time() - start


def timing(work: Callable[[], Any], first: float, clock: Clock | None = None) -> Timing:
    """Time ``work``, which was called once before and took ``first`` seconds then."""
    if first > LONG:
        return Timing(first)
    times: list[float] = []
    before = clock.seconds if clock else 0.0
    while len(times) < MAX_REPEATS and (len(times) < MIN_REPEATS or sum(times) <= ENOUGH):
        times.append(timed_first(work)[1])
    inside = (clock.seconds - before) / len(times) if clock else 0.0
    middle, quarter = median(times), quantiles(times, n=4, method="inclusive")
    return Timing(
        seconds=middle,
        spread=0.5 * (quarter[2] - quarter[0]),
        repeats=len(times),
        first=max(0.0, first - middle),
        coefficients=inside,
        memory=peak_memory(work),
    )


def peak_memory(work: Callable[[], Any]) -> float:
    """Return the largest memory that Python and NumPy hold at once during ``work``, in bytes."""
    gc.collect()
    tracemalloc.start()
    try:
        work()
        return float(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
