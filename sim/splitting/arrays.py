"""Plain arrays of splitting: records of paths, the score as a table, and what the limit is on."""

from typing import Any, NamedTuple

import numpy as np

from fpk.arrays import Array, Integers

LEVELS = 2048
"""Levels of the score from 0 to failure: few enough that the records of a path stay short, each a
factor of 1.01 to 1.05 of the probabilities from 1e-10 to 1e-40."""

MOST_REPLICAS = 8190
"""Replicas at most: each level renews fewer, and a seed has words for 2**24 pieces of paths."""


class Paths(NamedTuple):
    """The states at which the score of each replica rose to a new level, the last its largest."""

    state: Array  # (replicas, records, coordinates)
    level: Integers  # (replicas, records), ascending
    step: Integers  # (replicas, records), number of steps made by then
    best: Integers  # (replicas,), largest level; LEVELS is failure
    moved: Integers  # (replicas,), steps simulated so far


class Score(NamedTuple):
    """Levels over x, the share of the limit, and over the remaining time, both on square grids.

    ``table`` (coordinates, rows + 1, columns + 1): x = column/columns, of remaining time the share
    (row/rows)². Failure is x >= 1 of any coordinate, whatever the table says.
    """

    table: Array
    steps: int


class LimitArrays(NamedTuple):
    """The limit of a first passage: of c modal energies or, with c = 1, of one displacement q_i.

    E_f is the energy of failure. The score of a displacement depends on E_i/E_f, E_i the energy
    that its motion has; ``reach`` gives it from the modal energies H_m (``full.limit_arrays``).
    """

    values: Array  # (c,)
    diffusion: Any  # passing.Diffusion of the energies; None for a displacement
    reach: Array  # (n,), √(H_m/E_f) times these add up to √(E_i/E_f) without contact
    energy: float  # E_f
    mass: int  # of the displacement, from 0


def new_paths(states: Array, steps: int) -> Paths:
    """Return paths that have not begun, with room for ``steps`` steps, in ``states`` (N, d)."""
    replicas, coordinates = states.shape
    records = min(steps, LEVELS) + 1
    # Only what is written takes memory.
    state = np.empty((replicas, records, coordinates))
    state[:, 0] = states
    level, step = (np.empty((replicas, records), dtype=np.int64) for _ in range(2))
    level[:, 0] = step[:, 0] = 0
    return Paths(state, level, step, *(np.zeros(replicas, dtype=np.int64) for _ in range(2)))
