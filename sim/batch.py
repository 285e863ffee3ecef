"""Batches of trajectories, the tasks of an ensemble on them, and the threads that run these."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sim.arrays import LANES, Array, Integers, StepArrays, WatchArrays
from sim.kernel import KernelKey, compiled_kernel
from sim.parts.observed import FOLDED
from sim.random import mixed_seed

APART = 512
"""Blocks at most whose trajectories have sums of their own, 65536 of them: enough for the variance
of path means to half a per cent. Of the others there are sums over each block."""

TASKS_PER_THREAD = 8
"""Tasks into which the batches of a thread are divided: fewer cost less to hand out, more leave
less to wait for at the end, and after Ctrl-C."""


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


Clock = tuple[int, int, int, int]
"""Steps done and steps since ``watch`` before a call of the kernel, its steps and its stride."""


def advanced(
    batch: Batch, *, key: KernelKey, step: StepArrays, watch: WatchArrays, seed: int, clock: Clock
) -> Batch:
    """Advance a batch in place and return it; see ``Ensemble.advance``."""
    done, phase, steps, stride = clock
    arrays = (batch.states, batch.sums, batch.folded)
    flat = (a.reshape(a.shape[0], a.shape[1] * a.shape[2]) for a in arrays)
    compiled_kernel(key)(
        *flat, batch.live, batch.first, np.uint64(done * step.words), steps, phase, stride,
        mixed_seed(seed), step, watch, batch.counts,
    )  # fmt: skip
    return batch


def copied(first: int, *arrays: Any) -> Batch:
    """Return a batch of copies of arrays."""
    return Batch(first, *(np.array(array) for array in arrays))


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
    """Workers of an ensemble: ``threads`` of this process."""

    threads: int = 1

    def map(self, task: Any, *columns: Any) -> list[Any]:
        """Return what ``task`` makes of every batch, the rows of ``columns``."""
        rows = list(zip(*columns, strict=True))
        if self.threads == 1:
            return [task(*row) for row in rows]
        size = -(-len(rows) // (TASKS_PER_THREAD * self.threads))
        parts = [rows[k : k + size] for k in range(0, len(rows), size)]
        with ThreadPoolExecutor(self.threads) as pool:
            answers = pool.map(lambda part: [task(*row) for row in part], parts)
            return [answer for part in answers for answer in part]

    def values(self, answers: list[Any]) -> list[Any]:
        """Return the answers of ``map``: they are here."""
        return answers
