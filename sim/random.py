"""Counter-based normal numbers: one stream keyed by (seed, trajectory, step).

The word of counter ``t`` is the SplitMix64 finaliser (Stafford's mix 13; Steele, Lea, Flood,
OOPSLA 2014) of ``t · GOLDEN + mix(seed)`` with ``t = (trajectory << 40) + step · pairs + pair``: a
trajectory owns 2**40 consecutive words of one sequence of period 2**64, two trajectories never
share a word, and any number is had without those before it. SplitMix64 passes TestU01 BigCrush;
two seeds are two places of the same sequence, 2**64 words long.

One word gives one Box-Muller pair ``√(−2 log u) (cos θ, sin θ)``: the upper 40 bits the radius
``u = (k + ½) / 2**40``, the lower 24 the angle. That is enough: the tail is cut at
``√(−2 log 2**-41)`` = 7.54, beyond which lie 5e-14 of the normal law (one draw in 2e13), and 2**24
equidistant angles are a trapezoid rule, exact for every moment of order below 2**24.

log, sin and cos are polynomials inside the lane loop, so that it is compiled to vector
instructions: relative error of −2 log u below 1e-8, absolute error of sin and cos below 3e-9,
hence of a normal below 4e-8, a thousand times finer than 1e10 samples resolve.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

LANES = 128
"""Trajectories that run side by side in one block; a constant of compilation."""

FLAGS = {"contract", "nsz", "arcp", "afn"}
"""Liberties of arithmetic that are taken: none that assumes there is no NaN, and no reassociation,
which would undo the additions of 2**52 below."""

START = 1 << 39
"""First counter, within a trajectory's words, of those that draw its initial state."""

MAX_TRAJECTORIES = 1 << 24
"""Trajectories that a seed has words for."""

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31 = np.uint64(30), np.uint64(27), np.uint64(31)
_S40, _S24, _S52 = np.uint64(40), np.uint64(24), np.uint64(52)
_INTEGER = np.uint64(0x4330000000000000)  # bits of 2**52: or'ed with k < 2**52 they are 2**52 + k
_TWO52 = 4503599627370496.0
_ROOT_HALF = np.uint64(0x3FE6A09E667F3BCD)  # bits of √½
_TO_EXPONENT = np.uint64(0x3FF0000000000000 - 0x3FE6A09E667F3BCD)
_MANTISSA = np.uint64(0x000FFFFFFFFFFFFF)
_ANGLE = np.uint64(0x3FFFFF)
_SWAP = np.uint64(1 << 22)
_SIGN_BIT = np.uint64(1 << 23)
_LN2 = 0.6931471805599453

# Chebyshev interpolants: −2 log(1+f)/f on [√½ − 1, √2 − 1]; sin(π/2 x)/x and cos(π/2 x) in x² on
# |x| <= ½.
_L0, _L1, _L2, _L3, _L4 = (
    -2.0,
    0.9999997658828385,
    -0.6666664804728056,
    0.50003170246095,
    -0.4000414334947199,
)
_L5, _L6, _L7, _L8, _L9 = (
    0.3321825300958903,
    -0.28360157439284756,
    0.2648168539206597,
    -0.2582834063711923,
    0.1527718487405013,
)
_A0, _A1, _A2, _A3 = (
    1.5707963219600276,
    -0.6459634781534174,
    0.07968022285810664,
    -0.004602163104763622,
)
_B0, _B1, _B2, _B3, _B4 = (
    0.9999999999525453,
    -1.233700540640271,
    0.2536692037973008,
    -0.020860070410270565,
    0.0009036298864368199,
)


def mixed_seed(seed: int) -> np.uint64:
    """Return the finalised seed, the offset of its stream in the sequence; 0 <= seed < 2**64."""
    mask = (1 << 64) - 1
    z = seed & mask
    z = ((z ^ (z >> 30)) * int(_MIX1)) & mask
    z = ((z ^ (z >> 27)) * int(_MIX2)) & mask
    return np.uint64(z ^ (z >> 31))


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def fill_normals(rows: Array, trajectory: np.uint64, counter: np.uint64, offset: np.uint64) -> None:
    """Write one Box-Muller pair a lane: a row of cosines, then a row of sines.

    ``trajectory`` is that of the first lane, ``counter`` the word within it, ``offset`` the
    finalised seed; all three uint64.
    """
    first = ((trajectory << _S40) + counter) * GOLDEN + offset
    for lane in range(LANES):
        z = first + np.uint64(lane) * (GOLDEN << _S40)
        z = (z ^ (z >> _S30)) * _MIX1
        z = (z ^ (z >> _S27)) * _MIX2
        z = z ^ (z >> _S31)
        k = np.uint64((z >> _S24) | _INTEGER).view(np.float64) - (_TWO52 - 0.5)
        bits = np.float64(k).view(np.uint64) + _TO_EXPONENT
        e = np.uint64((bits >> _S52) | _INTEGER).view(np.float64) - (_TWO52 + 1063.0)
        f = np.uint64((bits & _MANTISSA) + _ROOT_HALF).view(np.float64) - 1.0
        log = _L5 + f * (_L6 + f * (_L7 + f * (_L8 + f * _L9)))
        log = f * (_L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * (_L4 + f * log)))))
        r = np.sqrt(log - (2.0 * _LN2) * e)
        r = np.uint64(np.float64(r).view(np.uint64) | ((z & _SIGN_BIT) << _S40)).view(np.float64)
        x = np.uint64((z & _ANGLE) | _INTEGER).view(np.float64) - _TWO52
        x = x * 2.0**-22 + (2.0**-23 - 0.5)
        y = x * x
        sin = r * (x * (_A0 + y * (_A1 + y * (_A2 + y * _A3))))
        cos = r * (_B0 + y * (_B1 + y * (_B2 + y * (_B3 + y * _B4))))
        swap = (z & _SWAP) != np.uint64(0)
        rows[lane] = sin if swap else cos
        rows[LANES + lane] = cos if swap else sin


@njit(fastmath=FLAGS, error_model="numpy", cache=True, nogil=True)
def _fill_blocks(out: Array, counter: np.uint64, offset: np.uint64) -> None:
    for block in range(out.shape[0]):
        for pair in range(out.shape[1] // (2 * LANES)):
            fill_normals(
                out[block, 2 * LANES * pair : 2 * LANES * (pair + 1)],
                np.uint64(block * LANES),
                counter + np.uint64(pair),
                offset,
            )


def normals(seed: int, paths: int, counter: int, count: int) -> Array:
    """Return (count, paths) standard normals: of every path those from word ``counter`` on.

    The step number ``step`` of a scheme with ``pairs`` pairs reads from ``step · pairs``.
    """
    pairs = (count + 1) // 2
    blocks = -(-paths // LANES)
    out = np.empty((blocks, 2 * pairs * LANES))
    _fill_blocks(out, np.uint64(counter), mixed_seed(seed))
    lanes = out.reshape(blocks, 2 * pairs, LANES).transpose(1, 0, 2)
    return np.ascontiguousarray(lanes.reshape(2 * pairs, -1)[:count, :paths])
