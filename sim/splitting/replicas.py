"""Replicas whose paths a compiled function makes, for one repetition."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fpk.arrays import Integers
from sim.splitting.arrays import Paths


@dataclass(eq=False)
class CompiledReplicas:
    """Replicas of ``algorithm.Replicas``: ``function`` renews ``paths`` by numbers, the ``model``.

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
        first = self.streams
        self.function(dead, parents, level, first, self.offset, *self.model, self.paths)
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
