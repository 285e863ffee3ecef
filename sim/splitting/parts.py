"""Parts of the compiled paths: records, levels of the score, random numbers."""

import numpy as np

from fpk.arrays import Array
from fpk.compiling import inlined
from sim.random import GOLDEN, Halves, Singles, box_muller, mixed_word
from sim.splitting.arrays import LEVELS, Paths, Score

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
