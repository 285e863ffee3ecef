"""An ensemble of trajectories that advances together and adds to histograms and moments."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.arrays import Array, Integers
from fpk.system import System
from sim.arrays import LANES, StepArrays, WatchArrays
from sim.flow import factored
from sim.histogram import Histogram, starts
from sim.kernel import KernelKey, compiled_kernel
from sim.parts.observed import FOLDED
from sim.plan import step_arrays, watched
from sim.random import START, mixed_seed, normals
from sim.reachable import Reachable
from sim.schemes import Scheme
from sim.statistics import Product
from sim.step_size import temperature
from sim.workers import TASKS_PER_THREAD, Workers

CHANGING = ("states", "sums", "folded", "counts")
"""Arrays of an ensemble that a step changes."""

BATCHES = 64
"""Independent batches at most; a batch is made of whole blocks of lanes."""

PIECE = 64
"""Blocks whose starts are drawn together, beginning at its multiples."""

LEAST_WORK = 100_000
"""Steps of single trajectories, a millisecond, below which a task costs more than it saves."""

APART = 512
"""Blocks at most whose trajectories have sums of their own, 65536 of them: enough for the variance
of path means to half a per cent. Of the others there are sums over each block."""


def start_states(system: System, seed: int, piece: int) -> Array:
    """Return the states (PIECE, 2n, LANES) in which the blocks from ``piece`` on start.

    They are q = 0 and momenta of the temperature (covariance kT M). With damping terms the
    displacements are drawn, too: on a limit cycle the noise alone mixes phases slowly.
    """
    n, kT = system.n, temperature(system)
    # A trajectory owns 2**40 words; so many lie before those of the piece's first one.
    words = START + ((piece * LANES) << 40)
    L = factored(np.diag((kT if np.isfinite(kT) else 0.0) * system.mass))
    # Of whole pieces: matrix products may round by the shape they come in.
    p = L @ normals(seed, PIECE * LANES, words, n)[: L.shape[1]]
    q = np.zeros_like(p)
    if system.damping_terms:
        q = start_displacements(system, kT, normals(seed, PIECE * LANES, words + n, n))
    return np.vstack([q, p]).reshape(2 * n, -1, LANES).transpose(1, 0, 2)


def start_displacements(system: System, kT: float, z: Array) -> Array:
    """Return displacements (n, paths) from standard normals ``z``: Gaussian by the springs at kT.

    Where a contact is reached they are shortened, by bisection, to the potential energy of the
    springs alone: no start is deeper in a stop than its energy allows.
    """
    # An inverse, not ``system.compliance``: its rounding is part of what a seed stands for.
    q = np.linalg.cholesky(kT * np.linalg.inv(system.stiffness_matrix)) @ z
    level = 0.5 * np.sum(q * (system.stiffness_matrix @ q), axis=0)
    low, high = np.zeros(q.shape[1]), np.ones(q.shape[1])
    for _ in range(40):
        middle = 0.5 * (low + high)
        above = system.potential((middle * q).T) > level
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(low * q)


def advanced(
    first: int, live: Integers, batch: Integers, *arrays: Any, key: KernelKey, step: StepArrays,
    watch: WatchArrays, offset: np.uint64, done: int, phase: int, steps: int, stride: int,
) -> tuple[Any, ...]:  # fmt: skip
    """Advance batches that begin with block ``first``; ``CHANGING`` arrays change in place."""
    *blocks, counts = arrays
    flat = (a.reshape(a.shape[0], a.shape[1] * a.shape[2]) for a in blocks)
    compiled_kernel(key)(
        *flat, counts, live, batch, first, np.uint64(done * step.words), steps, phase, stride,
        offset, step, watch, np.zeros((0, 0)),
    )  # fmt: skip
    return arrays


@dataclass(eq=False)
class Ensemble:
    """States of ``paths`` trajectories, in blocks of lanes, and batches of blocks.

    ``workers`` (None: ``threads`` of this process) may be those of a cluster. The result is bitwise
    the same for any workers and any division of the steps into calls of ``advance``: streams are
    keyed by trajectory, counts are integers, and sums grow in the order of samples.
    """

    system: System
    scheme: Scheme
    dt: float
    paths: int
    seed: int
    threads: int = 1
    workers: Any = None
    reachable: Reachable = field(init=False)
    step: StepArrays = field(init=False)
    edges: Integers = field(init=False)  # first block of each batch, and the number of blocks
    live: Integers = field(init=False)  # (blocks,), lanes that are trajectories; all lanes run
    states: Array = field(init=False)  # (blocks, 2n, LANES), just before the next kick
    sums: Array = field(init=False)  # (first blocks, products, LANES)
    folded: Array = field(init=False)  # (other blocks, products, FOLDED)
    counts: Integers = field(init=False)  # (batches, bins), one more bin a histogram for outside
    done: int = 0
    samples: int = 0
    phase: int = 0  # steps since ``watch`` that might have been observed

    def __post_init__(self) -> None:
        """Draw the states in which the trajectories start."""
        self.workers = self.workers or Workers(ThreadPoolExecutor(self.threads), self.threads)
        self.threads = self.workers.threads
        self.step = step_arrays(self.system, self.scheme, self.dt)
        blocks = -(-self.paths // LANES)
        batches = min(BATCHES, blocks)
        self.edges = np.arange(batches + 1, dtype=np.int64) * blocks // batches
        self.live = np.minimum(LANES, self.paths - LANES * np.arange(blocks))
        self.states = np.empty((blocks, 2 * self.system.n, LANES))
        for piece in range(0, blocks, PIECE):
            drawn = start_states(self.system, self.seed, piece)
            self.states[piece : piece + PIECE] = drawn[: blocks - piece]
        energy = float(np.max(self.system.hamiltonian(*self.phase_points())))
        self.reachable = Reachable(self.system, self.scheme, self.dt, energy)
        self.watch()

    def watch(self, histograms: Sequence[Histogram] = (), products: Sequence[Product] = ()) -> None:
        """Observe these from now on, all counts and sums starting from zero."""
        self.histograms, self.products = tuple(histograms), tuple(products)
        asked = (self.histograms, self.products)
        self._key, self._watch = watched(self.system, self.scheme, self.step, *asked)
        apart = min(self.live.size, APART)
        self.sums = np.zeros((apart, len(products), LANES))
        self.folded = np.zeros((self.live.size - apart, len(products), FOLDED))
        self.counts = np.zeros((self.edges.size - 1, starts(histograms)[-1]), dtype=np.int64)
        self.samples = self.phase = 0

    def advance(self, steps: int, *, stride: int = 1) -> None:
        """Advance all trajectories; every ``stride``-th step since ``watch`` is observed, or none.

        ``stride`` 0: nothing is observed, and ``watch`` may be called with ranges still unknown.
        Raises ``NotCertified`` where the step is seen to be unstable.
        """
        task = partial(
            advanced, key=self._key, step=self.step, watch=self._watch,
            offset=mixed_seed(self.seed), done=self.done, phase=self.phase, steps=steps,
            stride=stride,
        )  # fmt: skip
        # Whole batches to a task, as each has counts of its own.
        worth = steps * self.paths // LEAST_WORK
        tasks = min(max(worth, self.threads), TASKS_PER_THREAD * self.threads, len(self.counts))
        batches = np.diff(self.edges)
        begins = np.arange(1, tasks) * batches.size // tasks
        cuts, apart = self.edges[begins], len(self.sums)
        columns = [
            np.split(self.states, cuts),
            np.split(self.sums, np.minimum(cuts, apart)),
            np.split(self.folded, np.maximum(cuts - apart, 0)),
            np.split(self.counts, begins),
        ]
        batch = np.split(np.repeat(np.arange(batches.size), batches), cuts)
        first, live = [0, *cuts.tolist()], np.split(self.live, cuts)
        answers = self.workers.map(task, first, live, batch, *columns)
        for views, arrays in zip(zip(*columns, strict=True), answers, strict=True):
            for view, array in zip(views, arrays, strict=True):
                if view is not array:  # it comes from another process
                    view[...] = array
        if stride:
            self.samples += -(-(self.phase + steps) // stride) - -(-self.phase // stride)
            self.phase += steps
        self.done += steps
        self.reachable.require(self.states, self.done * self.dt)

    def batch_paths(self) -> Integers:
        """Return the number of trajectories of each batch."""
        return np.add.reduceat(self.live, self.edges[:-1])

    def batch_means(self) -> Array:
        """Return (batches, products) means over the samples of each batch, in fixed order."""
        alive = np.arange(LANES) < self.live[: len(self.sums), None]
        apart = np.where(alive[:, None, :], self.sums, 0.0).sum(axis=2)
        blocks = np.concatenate([apart, self.folded.sum(axis=2)])
        sums = np.add.reduceat(blocks, self.edges[:-1], axis=0)
        return np.asarray(sums / (self.batch_paths()[:, None] * max(1, self.samples)))

    def counted(self) -> Iterator[tuple[Histogram, Integers]]:
        """Return each histogram with its counts (batches, bins + 1), the last of them outside."""
        counts = np.split(self.counts, starts(self.histograms)[1:], axis=1)
        return zip(self.histograms, counts, strict=False)  # nothing lies behind the last one

    def phase_points(self, most: int | None = None) -> tuple[Array, Array]:
        """Return q and p (paths, n) just before the next kick, of the first ``most`` paths."""
        n, paths = self.system.n, self.paths if most is None else min(self.paths, most)
        lanes = self.states[: -(-paths // LANES)].transpose(1, 0, 2).reshape(2 * n, -1)
        return lanes[:n, :paths].T, lanes[n:, :paths].T

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return all that changes: what ``restore`` needs to go on as if never stopped."""
        arrays = {name: getattr(self, name) for name in CHANGING}
        return {**arrays, "clock": np.array([self.done, self.samples, self.phase], dtype=np.int64)}

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what ``saved`` returned, by any workers, after the same calls of ``watch``."""
        self.done, self.samples, self.phase = (int(number) for number in saved["clock"])
        for name in CHANGING:
            getattr(self, name)[...] = saved[name]
