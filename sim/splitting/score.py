"""Scores: how near to failure a path is, at an energy with some time left."""

from collections.abc import Callable, Sequence

import numpy as np

from fpk.arrays import Array
from sim.splitting.arrays import LEVELS, Score

ScoreFunction = Callable[[Array, Array], Array]
"""ln P(failure within a time | energy), or any approximation of it: a function of energies (m,)
below the limit, ascending, and times (k,) > 0, ascending, to (k, m)."""

ROWS, COLUMNS = 128, 256
"""Cells of the table over the root of the remaining time and over the share of the limit."""


SHARES = np.maximum(np.arange(COLUMNS), 0.5) / COLUMNS
"""Shares x of the limit at which scores are asked; the first stands for 0."""


def cost_score(limit: float, *, noise: float, decay: float) -> ScoreFunction:
    """Return minus the least action by which ``dH = (D' − γ H) dt + √(2 D' H) dB`` fails in time.

    ``(√H_f − √H e^{−γτ/2})² γ/(D' (1 − e^{−γτ}))`` with ``noise`` D' and ``decay`` γ, which may be
    0 or negative: the exponent of the Gaussian transition of an oscillator's amplitude.
    """

    def score(energies: Array, times: Array) -> Array:
        tau = times[:, None]
        grown = tau if decay == 0.0 else -np.expm1(-decay * tau) / decay
        short = np.sqrt(limit) - np.sqrt(energies) * np.exp(-0.5 * decay * tau)
        return np.asarray(-np.square(np.maximum(short, 0.0)) / (noise * grown))

    return score


def score_table(
    scores: Sequence[ScoreFunction],
    energies: Sequence[Array],
    *,
    time: float,
    steps: int,
) -> Score:
    """Return the levels of one score a coordinate, where x is the share of its limit.

    ``energies`` are what the score takes at ``SHARES``. A score counts from its value at
    energy 0 with all of ``time`` left; no failure has a larger one than energies just below it.
    """
    left, tables = time * (np.arange(1, ROWS + 1) / ROWS) ** 2, []
    for score, energy in zip(scores, energies, strict=True):
        table = np.zeros((ROWS + 1, COLUMNS + 1))
        table[:, -1] = LEVELS
        values = score(energy, left)
        lowest = values[-1, 0]
        if np.isfinite(lowest) and lowest < 0.0:
            share = np.where(np.isnan(values), 0.0, 1.0 - values / lowest)
            ascending = np.maximum.accumulate(np.clip(share, 0.0, 1.0), axis=1)
            table[1:, :-1] = LEVELS * np.maximum.accumulate(ascending, axis=0)
        else:  # the score cannot tell: x alone does
            table[:, :-1] = LEVELS * np.arange(COLUMNS) / COLUMNS
        tables.append(table)
    return Score(np.array(tables), steps)
