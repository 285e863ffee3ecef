"""Counter-based normal numbers: a function of the seed, the trajectory and the step.

The word number ``t = (trajectory << 40) + step · pairs + pair`` is the SplitMix64 finaliser
(Steele, Lea, Flood, OOPSLA 2014) of ``t · GOLDEN + finaliser(seed)``: no two trajectories share a
word, and any word is computed without the words before it.

The 64 bits of a word make one Box-Muller pair ``√(−2 log u) (cos θ, sin θ)``. The words of a block
of lanes are read as 32-bit halves, in the order of memory: half ``k`` is the radius of lane k
(``u = (2j + 1) / 2**32``), half ``LANES + k`` its angle (24 bits). Tests of their distribution are
in docs/theory.md, "The step of the simulation".
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.numeric.arrays import Array
from fpk.numeric.compiling import cached_njit, njit_inline
from fpk.system.system import System
from sim.step.arrays import LANES, MAX_TRAJECTORIES, in_blocks
from sim.step.step_size import temperature

Singles = NDArray[np.float32]
Words = NDArray[np.uint64]
Halves = NDArray[np.uint32]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""2**64 over the golden ratio: distance of neighbouring words in the sequence, of derived seeds."""

u32, f32 = np.uint32, np.float32

# Chebyshev interpolants: −2 log(1+f)/f on [√½ − 1, √2 − 1] to 4e-7 (_L); sin(π/2 x)/x to 1.2e-6
# (_A) and cos(π/2 x) to 5e-8 (_B), in x² on |x| <= 1. _LN4: 2 ln 2 for each unit of the exponent.
_L0, _L1, _L2, _L3 = map(f32, [-1.999999885, 1.000007262, -0.6667022828, 0.4994014337])
_L4, _L5, _L6, _L7 = map(f32, [-0.397971301, 0.3449402661, -0.324683796, 0.202681135])
_A0, _A1, _A2, _A3 = map(f32, [1.570795135, -0.6459258417, 0.0795003287, -0.004370800433])
_B0, _B1, _B2 = map(f32, [0.9999999532, -1.233698208, 0.2536507096])
_B3, _B4 = map(f32, [-0.02081057138, 0.0008581625433])
_LN4 = f32(2.0 * 0.6931471805599453 / 2**23)


def stream_of(seed: int, number: int, *, of_starts: bool = False) -> np.random.Generator:
    """Return the NumPy stream ``number`` (below 2**63) of a ``seed``, for one round or repetition.

    ``of_starts``: a second set of streams, for initial states, which no step draws from.
    """
    number += of_starts << 63
    return np.random.Generator(np.random.Philox(key=np.array([seed, number], dtype=np.uint64)))


@njit_inline
def splitmix64(z: np.uint64) -> np.uint64:
    """Return the SplitMix64 finaliser of ``z``, a place in the sequence or a seed."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.uint64(z ^ (z >> np.uint64(31)))


def stream_offset(seed: int) -> np.uint64:
    """Return the offset in the sequence of the stream of a ``seed``, 0 <= seed < 2**64."""
    finaliser: Any = splitmix64
    return np.uint64(finaliser.py_func(np.array([seed], dtype=np.uint64))[0])


@njit_inline
def box_muller(rows: Singles, halves: Halves, width: int = LANES) -> None:
    """Write one normal pair for each of ``width`` lanes to ``rows``: r cos θ, then r sin θ.

    ``halves`` (2 · width,) are the 32-bit halves of the words, as in the text of the module.
    """
    root_half, mantissa = u32(0x3F3504F3), u32(0x007FFFFF)  # bits of √½; u is scaled by 2**32
    for k in range(width):
        a = halves[width + k]
        u = f32(u32(halves[k] | u32(1)))
        bits = u32(f32(u).view(u32) - u32(root_half + u32(32 << 23)))
        e = f32(u32(bits & u32(0xFF800000)).view(np.int32))
        f = u32(u32(bits & mantissa) + root_half).view(f32) - f32(1.0)
        log = _L4 + f * (_L5 + f * (_L6 + f * _L7))
        log = f * (_L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * log))))
        r = np.sqrt(log - _LN4 * e)
        r = u32(f32(r).view(u32) | u32(a & u32(0x80000000))).view(f32)
        # With the bits of 2 these 23 are a number in [2, 4).
        x = u32(u32(a & mantissa) | u32(0x40000000)).view(f32) - f32(3.0)
        y = x * x
        rows[width + k] = r * (x * (_A0 + y * (_A1 + y * (_A2 + y * _A3))))
        rows[k] = r * (_B0 + y * (_B1 + y * (_B2 + y * (_B3 + y * _B4))))


@njit_inline
def word_place(trajectory: int, counter: Any, offset: np.uint64) -> np.uint64:
    """Return the place of word ``counter`` of a ``trajectory``; ``offset``: ``stream_offset``."""
    return ((np.uint64(trajectory) << np.uint64(40)) + np.uint64(counter)) * GOLDEN + offset


@njit_inline
def fill_normals(
    z: Singles, words: Words, place: np.uint64, pairs: int, width: int = LANES
) -> None:
    """Write standard normals to ``z``: for each of ``pairs`` words two rows of ``width`` lanes.

    ``place``: ``word_place`` of the first word of lane 0; ``words`` (``width``,) is scratch.
    """
    for pair in range(pairs):
        for lane in range(width):
            word = (np.uint64(lane) << np.uint64(40)) + np.uint64(pair)
            words[lane] = splitmix64(place + word * GOLDEN)
        box_muller(z[2 * pair * width : 2 * (pair + 1) * width], words.view(np.uint32), width)


@cached_njit()
def _fill_blocks(out: Array, words: Words, counter: np.uint64, offset: np.uint64) -> None:
    rows = np.empty(out.shape[0] * LANES, np.float32)
    for first in range(0, out.shape[1], LANES):
        fill_normals(rows, words, word_place(first, counter, offset), out.shape[0] // 2)
        out[:, first : first + LANES] = rows.reshape(out.shape[0], LANES)


def normals(seed: int, paths: int, counter: int, count: int) -> Array:
    """Return normals (``count``, ``paths``) of a ``seed``; word ``counter`` gives the first two."""
    out = np.empty((count + count % 2, -(-paths // LANES) * LANES))
    _fill_blocks(out, np.empty(LANES, np.uint64), np.uint64(counter), stream_offset(seed))
    return out[:count, :paths]


def start_states(system: System, seed: int, blocks: int) -> Array:
    """Return the states (``blocks``, 2n, LANES) before the burn-in, by the words of a ``seed``.

    They are q = 0 and momenta of covariance kT M, 0 if kT is inf. With damping terms displacements
    are drawn, too: on a limit cycle the noise alone mixes phases slowly.
    """
    n, kT, first = system.n, temperature(system), 2**63 // MAX_TRAJECTORIES  # no step comes so far
    deviation = np.sqrt((kT if np.isfinite(kT) else 0.0) * system.mass)
    p = deviation[:, None] * normals(seed, blocks * LANES, first, n)
    q = np.zeros_like(p)
    if system.damping_terms:
        q = start_displacements(system, kT, normals(seed, blocks * LANES, first + n, n))
    return in_blocks(np.vstack([q, p]).T)


def start_displacements(system: System, kT: float, z: Array) -> Array:
    """Return displacements (n, paths) from standard normals ``z`` (n, paths): covariance kT K⁻¹.

    Displacements in contact are shortened, by bisection, until their potential energy is the energy
    that the springs alone had before.
    """
    # An inverse, not ``system.compliance``, whose rounding differs: a seed has the same states.
    q = np.linalg.cholesky(kT * np.linalg.inv(system.stiffness_matrix)) @ z
    level = 0.5 * np.sum(q * (system.stiffness_matrix @ q), axis=0)
    low, high = np.zeros(q.shape[1]), np.ones(q.shape[1])
    for _ in range(40):
        middle = 0.5 * (low + high)
        above = system.potential((middle * q).T) > level
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(low * q)
