"""Processor time after a warm-up, repeated, with the first call and the memory apart.

On one thread it is the wall time of a machine that does nothing else; unlike wall time it can be
compared where other work runs beside.
"""

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median, quantiles
from time import process_time
from typing import Any

from cases.studies.equations import Clock

LEAST_REPEATS, MOST_REPEATS = 3, 21
ENOUGH = 0.1
"""Seconds of repeats that are enough, once ``LEAST_REPEATS`` are there."""
LONG = 1.0
"""Seconds above which the first run is the only one: compile time and spread are not known then."""


@dataclass(frozen=True)
class Timing:
    """Median and quartile spread in seconds; what the first call took beyond; peak memory.

    ``coefficients`` is the part spent in the process's coefficients; ``memory`` in bytes as
    allocated by Python and NumPy during one call, not a number where it was not measured.
    """

    seconds: float
    spread: float
    repeats: int
    first: float
    coefficients: float
    memory: float


def timed_first(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return what the first call gives, and its seconds."""
    start = process_time()
    found = work()
    return found, process_time() - start


def timing(work: Callable[[], Any], first: float, clock: Clock | None = None) -> Timing:
    """Time ``work``, which was called once before and took ``first`` seconds then."""
    if first > LONG:
        nan = float("nan")
        return Timing(first, nan, 1, nan, nan, nan)
    times: list[float] = []
    before = clock.seconds if clock else 0.0
    while len(times) < MOST_REPEATS:
        start = process_time()
        work()
        times.append(process_time() - start)
        if len(times) >= LEAST_REPEATS and sum(times) > ENOUGH:
            break
    inside = (clock.seconds - before) / len(times) if clock else 0.0
    middle = median(times)
    quarter = quantiles(times, n=4, method="inclusive")
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
