"""A reader of a trace that adds to windowed Fourier sums of its samples."""

from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.compiling import cached_njit
from sim.arrays import LANES as W
from sim.motion.reading import reader


@reader
def add_fourier(sources: int) -> Any:
    """Add w q cos and w q sin to ``sums`` (blocks, 6 · frequencies, LANES).

    ``omega`` (frequencies,) is in radians per sample. Of each frequency the rows are those of a
    Hann window over ``length`` samples, of one over its first half, and of one over its second.
    """

    @cached_njit()
    def read(
        trace: Array, samples: int, done: int, sums: Array, row: int, omega: Array, length: int,
    ) -> int:  # fmt: skip
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

    return read
