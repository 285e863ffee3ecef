"""Batches of trajectories, the tasks of an ensemble on them, and the threads that run these."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.arrays import LANES, StepArrays, WatchArrays
from sim.kernel import KernelKey, compiled_kernel
from sim.parts.observed import FOLDED
from sim.random import mixed_seed

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

APART = 512
"""Blocks at most whose trajectories have sums of their own, 65536 of them: enough for the variance
of path means to half a per cent. Of the others there are sums over each block."""


class Batch(NamedTuple):
    """The blocks of one batch, from number ``first`` on: all of them that changes."""

    first: int
    live: Integers  # (blocks,), lanes that are trajectories
    states: Array  # (blocks, 2n, LANES)
    sums: Array = np.zeros((0, 0, 0))  # (first blocks, products, LANES)
    folded: Array = np.zeros((0, 0, 0))  # (other blocks, products, FOLDED)
    counts: Integers = np.zeros(0, dtype=np.int64)  # (bins,)


def watching(batch: Batch, *, bins: int, products: int) -> Batch:
    """Return the batch with counts and sums of zero."""
    blocks = batch.live.size
    apart = min(blocks, max(0, APART - batch.first))
    return batch._replace(
        sums=np.zeros((apart, products, LANES)),
        folded=np.zeros((blocks - apart, products, FOLDED)),
        counts=np.zeros(bins, dtype=np.int64),
    )


def copied(first: int, *arrays: Any) -> Batch:
    """Return a batch of copies of arrays."""
    return Batch(first, *(np.array(array) for array in arrays))


@dataclass(frozen=True, eq=False)
class Advance:
    """A call of the kernel, the same for every batch; see ``Ensemble.advance``."""

    key: KernelKey
    step: StepArrays
    watch: WatchArrays
    seed: int
    done: int
    phase: int
    steps: int
    stride: int

    def __call__(self, batch: Batch) -> Batch:
        """Advance a batch in place and return it."""
        arrays = (batch.states, batch.sums, batch.folded)
        flat = (a.reshape(a.shape[0], a.shape[1] * a.shape[2]) for a in arrays)
        compiled_kernel(self.key)(
            *flat, batch.live, batch.first, np.uint64(self.done * self.step.words), self.steps,
            self.phase, self.stride, mixed_seed(self.seed), self.step, self.watch, batch.counts,
        )  # fmt: skip
        return batch


class Summary(NamedTuple):
    """Losses, sums and counts of a batch: small beside its trajectories."""

    lost: int  # trajectories that have left the finite range
    sums: Array  # (blocks, products)
    counts: Integers  # (bins,)


def summary(batch: Batch) -> Summary:
    """Return losses, sums and counts of a batch."""
    alive = np.arange(LANES) < batch.live[:, None]
    finite = np.isfinite(batch.states).all(axis=1)
    apart = np.where(alive[: batch.sums.shape[0], None, :], batch.sums, 0.0).sum(axis=2)
    sums = np.concatenate([apart, batch.folded.sum(axis=2)])
    return Summary(int(np.sum(~finite & alive)), sums, batch.counts)


@dataclass(frozen=True)
class Threads:
    """Workers of an ensemble: ``threads`` of this process, each at one of the batches."""

    threads: int = 1

    def map(self, task: Any, *columns: Any) -> list[Any]:
        """Return what ``task`` makes of every batch."""
        if self.threads == 1:
            return [task(*row) for row in zip(*columns, strict=True)]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(task, *columns))

    def values(self, answers: list[Any]) -> list[Any]:
        """Return the answers of ``map``: they are here."""
        return answers
