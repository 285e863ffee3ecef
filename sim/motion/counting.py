"""Readers of a trace in the stationary state: upcrossings of levels, windowed Fourier sums."""

from functools import cache
from typing import Any

import numpy as np

from fpk.arrays import Array, Integers
from fpk.compiling import cached_njit, inlined
from sim.arrays import LANES as W
from sim.motion.between import cubic_of, readers_checksum, turning_points, value_of


@inlined
def count_rise(counts: Integers, levels: Array, low: float, high: float) -> None:
    """Count the levels in (low, high]: +1 at the first of them, −1 behind the last."""
    if high <= levels[0] or low >= levels[-1] or not low < high:
        return
    first, last = 0, levels.size
    while first < last:
        middle = (first + last) // 2
        if levels[middle] > low:
            last = middle
        else:
            first = middle + 1
    begin, last = first, levels.size
    while first < last:
        middle = (first + last) // 2
        if levels[middle] > high:
            last = middle
        else:
            first = middle + 1
    if first > begin:
        counts[begin] += 1
        counts[first] -= 1


@cache
def compiled_counting() -> tuple[Any, Any]:
    """Return the readers of upcrossings and of Fourier sums."""
    sources = readers_checksum()

    @cached_njit()
    def count_upcrossings(
        trace: Array, samples: int, done: int, counts: Integers, dt: float, row: int, momentum: int,
        inverse_mass: float, levels: Array,
    ) -> int:  # fmt: skip
        """See the function of this name outside."""
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

    @cached_njit()
    def add_fourier(
        trace: Array, samples: int, done: int, sums: Array, row: int, omega: Array, length: int,
    ) -> int:  # fmt: skip
        """See the function of this name outside."""
        turn = 2.0 * np.pi / length
        for k in range(1, samples + 1):
            t = done + k - 1
            if t >= length:
                break
            whole, part = 0.5 - 0.5 * np.cos(turn * t), 0.5 - 0.5 * np.cos(2.0 * turn * t)
            half = 2 if 2 * t < length else 4
            for f in range(omega.size):
                c, s = np.cos(omega[f] * t), np.sin(omega[f] * t)
                wc, ws, pc, ps = whole * c, whole * s, part * c, part * s
                for b in range(trace.shape[0]):
                    q = trace[b, k, row]
                    re, im = sums[b, 6 * f], sums[b, 6 * f + 1]
                    half_re, half_im = sums[b, 6 * f + half], sums[b, 6 * f + half + 1]
                    for w in range(W):
                        re[w] += wc * q[w]
                        im[w] += ws * q[w]
                        half_re[w] += pc * q[w]
                        half_im[w] += ps * q[w]
        return sources

    return count_upcrossings, add_fourier


def count_upcrossings(*arrays: Any, **numbers: Any) -> None:
    """Add to ``counts`` (blocks, levels + 1), whose running sums are upcrossings of the ``levels``.

    Levels ascend. Between samples q is the cubic through q and v at both ends: each of its rising
    parts is counted, so that a level passed up and down within a step is not lost.
    """
    compiled_counting()[0](*arrays, **numbers)


def add_fourier(*arrays: Any, **numbers: Any) -> None:
    """Add w q cos and w q sin to ``sums`` (blocks, 6 · frequencies, LANES).

    ``omega`` (frequencies,) is in radians per sample. Of each frequency the rows are those of a
    Hann window over ``length`` samples, of one over its first half, and of one over its second.
    """
    compiled_counting()[1](*arrays, **numbers)
