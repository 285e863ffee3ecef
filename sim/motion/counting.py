"""Reader of a trace that counts the upcrossings of levels, between the steps too."""

from typing import Any

import numpy as np

from fpk.arrays import Array, Integers
from fpk.compiling import cached_njit, inlined
from sim.arrays import LANES as W
from sim.motion.between import cubic_of, turning_points, value_of
from sim.motion.reading import reader


@inlined
def count_rise(counts: Integers, levels: Array, low: float, high: float) -> None:
    """Count the levels in (low, high]: +1 at the first of them, −1 behind the last."""
    if high <= levels[0] or low >= levels[-1] or not low < high:
        return
    begin, end = np.searchsorted(levels, low, "right"), np.searchsorted(levels, high, "right")
    if end > begin:
        counts[begin] += 1
        counts[end] -= 1


@reader
def count_upcrossings(sources: int) -> Any:
    """Add to ``counts`` (blocks, levels + 1), whose running sums are upcrossings of the ``levels``.

    Levels ascend. Between samples q is the cubic through q and v at both ends: each of its rising
    parts is counted, so that a level passed up and down within a step is not lost.
    """

    @cached_njit()
    def read(
        trace: Array, samples: int, done: int, counts: Integers, dt: float, row: int, momentum: int,
        inverse_mass: float, levels: Array,
    ) -> int:  # fmt: skip
        for b in range(trace.shape[0]):
            own = counts[b]
            for k in range(samples):
                q0, q1 = trace[b, k, row], trace[b, k + 1, row]
                p0, p1 = trace[b, k, momentum], trace[b, k + 1, momentum]
                for w in range(W):
                    v0, v1 = inverse_mass * p0[w], inverse_mass * p1[w]
                    change = q1[w] - q0[w]
                    # De Boor and Swartz: a cubic with these slopes is monotone.
                    if min(v0, v1) >= 0.0 and dt * max(v0, v1) <= 3.0 * change:
                        count_rise(own, levels, q0[w], q1[w])
                    elif max(v0, v1) > 0.0 or dt * min(v0, v1) < 3.0 * change:
                        cubic = cubic_of(q0[w], v0, q1[w], v1, dt)
                        turning, before = turning_points(cubic), q0[w]
                        for s in (turning[0], turning[1]):
                            value = value_of(cubic, s)
                            count_rise(own, levels, before, value)
                            before = value
                        count_rise(own, levels, before, q1[w])
        return sources

    return read
