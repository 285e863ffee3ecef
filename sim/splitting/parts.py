"""Parts of the compiled paths: records, random numbers, the distance to a limit, and the score.

The score is a share of the limit by which splitting ranks paths. All functions are compiled.
"""

from math import exp, sqrt
from typing import Any

import numpy as np
from numba import njit

from fpk.arrays import Array
from fpk.compiling import inlined, of_law
from sim.arrays import StepArrays, WatchArrays
from sim.motion.between import cubic_of, distance_to, form_of, largest_of
from sim.parts.contact import numbers_of, overlap_of
from sim.random import GOLDEN, Halves, Singles, box_muller, mixed_word
from sim.splitting.arrays import LEVELS, LimitArrays, Paths, Score

RAREST = 38.0
"""−ln of less than the least uniform number, 2^−54."""
BELOW = 1.0 - 2.0**-53
"""Share of the limit at most of what has not passed it."""

_S11, _S40 = np.uint64(11), np.uint64(40)


@inlined
def begin(paths: Paths, i: int, parent: int, level: int, x: Array) -> int:
    """Make the first record of ``parent`` above ``level`` the only one of ``i``, and its state x.

    Returns the number of steps made by then.
    """
    m = 0
    while paths.level[parent, m] <= level:
        m += 1
    for r in range(paths.state.shape[2]):
        x[r] = paths.state[parent, m, r]
        paths.state[i, 0, r] = x[r]
    paths.level[i, 0] = paths.level[parent, m]
    paths.step[i, 0] = paths.step[parent, m]
    return int(paths.step[i, 0])


@inlined
def record(paths: Paths, i: int, records: int, x: Array, level: int, step: int) -> None:
    """Write a state as the record number ``records`` of replica i."""
    for r in range(paths.state.shape[2]):
        paths.state[i, records, r] = x[r]
    paths.level[i, records] = level
    paths.step[i, records] = step


@inlined
def level_of(score: Score, coordinate: int, x: float, step: int) -> int:
    """Return the level of the share x of the limit after ``step`` steps, by bilinear tables."""
    if not x < 1.0:
        return LEVELS if x >= 1.0 else 0
    rows, columns = score.table.shape[1] - 1, score.table.shape[2] - 1
    u, v = x * columns, np.sqrt(1.0 - step / score.steps) * rows
    j, k = min(int(u), columns - 1), min(int(v), rows - 1)
    a, b = u - j, v - k
    t = score.table[coordinate]
    low = t[k, j] + a * (t[k, j + 1] - t[k, j])
    high = t[k + 1, j] + a * (t[k + 1, j + 1] - t[k + 1, j])
    return min(int(low + b * (high - low)), LEVELS - 1)


@inlined
def place(trajectory: int, counter: int, offset: np.uint64) -> np.uint64:
    """Return the place of a word in the sequence of ``sim.random``."""
    return ((np.uint64(trajectory) << _S40) + np.uint64(counter)) * GOLDEN + offset


@inlined
def draw_normals(z: Singles, word: Halves, at: np.uint64, pairs: int) -> None:
    """Write ``pairs`` pairs of normals from the words that begin at the place ``at``."""
    words = word.view(np.uint64)
    for pair in range(pairs):
        words[0] = mixed_word(at + np.uint64(pair) * GOLDEN)
        box_muller(z[2 * pair :], word, 1)


@inlined
def uniform(at: np.uint64) -> float:
    """Return the uniform number in (0, 1) at a place."""
    return (np.float64(mixed_word(at) >> _S11) + 0.5) * 2.0**-53


@njit(inline="always")
def see(
    kind: str, s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, seen: Array
) -> None:
    """Write what is ``seen`` (c, 3) at the observed state: the distance to the limit first.

    Of an energy it is that of ``distance_to``, and its numbers come after it; of a displacement q
    and v.
    """
    at = watch.at
    if kind == "q":
        i = limit.mass
        q, v = s[at.q + i], 2.0 * step.half_inverse_mass[i] * s[at.p + i]
        seen[0, 0], seen[0, 1], seen[0, 2] = limit.values[0] - abs(q), q, v
    else:
        diffusion = limit.diffusion
        for m in range(limit.values.size):
            variance, growth = seen[m, 1:2], seen[m, 2:3]
            form_of(variance, s, at.p, diffusion.variance[m], 1)
            form_of(growth, s, at.p, diffusion.growth[m], 1)
            H, at_rest = s[watch.traced[m]], diffusion.at_rest[m]
            seen[m, 0] = distance_to(limit.values[m], H, variance[0], growth[0], at_rest)


@inlined
def reached_share(
    s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, law: Any
) -> float:
    """Return √(E_i/E_f) of the displacement of one mass at the observed state, below 1."""
    root, contact = 0.0, 0.0
    for m in range(limit.reach.size):
        root += limit.reach[m] * sqrt(s[watch.traced[m]])
    for stop in range(step.stop_slot.size):
        if step.slot_mass[step.stop_slot[stop]] == limit.mass:
            sign, clearance, B, e, kind = numbers_of(step, stop)
            _, o = overlap_of(s[watch.at.q + limit.mass], sign, clearance)
            contact += B * of_law(law, kind, o, e)
    return min(sqrt(root * root + contact / limit.energy), BELOW)


@njit(inline="always")
def share_of(
    kind: str, s: Array, left: float, step: StepArrays, watch: WatchArrays, limit: LimitArrays,
    law: Any, m: int,
) -> float:  # fmt: skip
    """Return x of the score at the observed state, 1 where no distance to the limit is ``left``."""
    if left <= 0.0:
        return 1.0
    if kind == "q":
        return reached_share(s, step, watch, limit, law)
    return min(sqrt(max(s[watch.traced[m]], 0.0) / limit.values[m]), BELOW)


@njit(inline="always")
def left_after(
    kind: str, before: Array, seen: Array, limit: LimitArrays, m: int, h: float, at: np.uint64
) -> float:
    """Return the distance to limit m after the step h, not positive if it was passed within.

    A displacement is a cubic; an energy at the distances a and b passes with the probability
    e^(−2 a b/h), as a Brownian bridge, by the uniform number that is drawn ``at`` a place.
    """
    if kind == "q":
        cubic = cubic_of(before[0, 1], before[0, 2], seen[0, 1], seen[0, 2], h)
        return float(limit.values[0] - largest_of(cubic))
    a, b = before[m, 0], seen[m, 0]
    if a <= 0.0 or b <= 0.0:
        return 0.0
    exponent = 2.0 * a * b / h
    return 0.0 if exponent < RAREST and uniform(at) < exp(-exponent) else float(b)
