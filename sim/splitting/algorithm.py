"""Adaptive multilevel splitting of paths: levels, killed replicas and their weight.

Cerou and Guyader, Stoch. Anal. Appl. 25, 2007, 417, in the unbiased form of Brehier, Gazeau,
Goudenege, Lelievre and Rousset, Ann. Appl. Probab. 26, 2016, 3559: at each level Z all replicas
whose score has not exceeded Z are killed, ties included, and their share counts. Each is replaced
by a copy of a survivor up to the first time at which its score exceeds Z, and by new noise from
there. For a Markov chain in discrete time and any score the probability has the mean P exactly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, log, nan
from typing import Any, NamedTuple, Protocol

import numpy as np

from fpk.arrays import Integers
from sim.splitting.arrays import Paths


class Replicas(Protocol):
    """Paths that can be renewed, and the largest level that the score of each has reached."""

    @property
    def best(self) -> Integers:
        """Largest level (replicas,) of each path."""

    def renew(self, dead: Integers, parents: Integers, level: int) -> None:
        """Replace ``dead`` by ``parents`` up to where they exceed ``level``, then by new paths."""


@dataclass(eq=False)
class CompiledReplicas:
    """Paths of one repetition, which a compiled ``function`` renews by numbers, the ``model``.

    Every renewed path has a stream of its own, of those that ``offset``, a finalised seed, begins.
    """

    function: Callable[..., int]
    model: tuple[Any, ...]
    paths: Paths
    offset: np.uint64
    streams: int = 0

    def __post_init__(self) -> None:
        """Make the paths from their starts."""
        every = np.arange(self.paths.best.size)
        self.renew(every, every, -1)

    @property
    def best(self) -> Integers:
        """Largest level (replicas,) of each path."""
        return self.paths.best

    @property
    def moved(self) -> int:
        """Steps simulated so far."""
        return int(self.paths.moved.sum())

    def renew(self, dead: Integers, parents: Integers, level: int) -> None:
        """Replace ``dead`` by ``parents`` up to where they exceed ``level``, then by new paths."""
        self.function(dead, parents, level, self.streams, self.offset, *self.model, self.paths)
        self.streams += dead.size


class Problem(Protocol):
    """First passage before ``time`` in steps of about ``dt``: a dataclass that can be pickled."""

    @property
    def time(self) -> float:
        """Time before which failure is asked for."""

    @property
    def dt(self) -> float:
        """The longer one of the two steps."""

    def replicas(
        self, count: int, steps: int, seed: int, stream: np.random.Generator
    ) -> CompiledReplicas:
        """Return ``count`` paths of ``steps`` steps from their starts, drawn from ``stream``."""


class Repetition(NamedTuple):
    """One estimate: ln of the probability, −inf where no replica was left, levels, and steps.

    ``failed`` counts the replicas that failed before any was killed: plain sampling.
    """

    log_probability: float
    levels: int
    failed: int
    steps: int = 0


def split(
    replicas: Replicas, failure: int, killed: int, stream: np.random.Generator,
    over: Callable[[], bool] = lambda: False,
) -> Repetition:  # fmt: skip
    """Return the estimate of the probability that a path's score reaches ``failure``.

    ``killed`` is the least number of ``replicas`` that each level kills; ties may make it more.
    Where it is ``over()`` before the last level, the probability is not a number.
    """
    log_probability, levels = 0.0, 0
    failed = int(np.sum(replicas.best >= failure))
    while True:
        best = replicas.best
        if over():
            return Repetition(nan, levels, failed)
        level = int(np.partition(best, killed - 1)[killed - 1])
        if level >= failure:
            return Repetition(log_probability + log(np.mean(best >= failure)), levels, failed)
        dead, alive = np.flatnonzero(best <= level), np.flatnonzero(best > level)
        if alive.size == 0:
            return Repetition(-inf, levels, failed)
        log_probability += log(alive.size / best.size)
        replicas.renew(dead, alive[stream.integers(alive.size, size=dead.size)], level)
        levels += 1
