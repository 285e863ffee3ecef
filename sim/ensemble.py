"""An ensemble of trajectories that advances together and adds to histograms and moments."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.effects import effects_of
from fpk.system import System
from sim.arrays import LANES, StepArrays, WatchArrays
from sim.flow import factored
from sim.histogram import Histogram, modes_of, starts, watch_arrays
from sim.kernel import KernelKey, compiled_kernel
from sim.parts.linear import ONE_LOOP
from sim.parts.observed import FOLDED
from sim.plan import step_arrays
from sim.random import START, mixed_seed, normals
from sim.scheme import Scheme
from sim.step_size import temperature

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Product = tuple[str, int, str, int]
Saved = Mapping[str, NDArray[Any]]

ARRAYS = ("states", "sums", "folded", "counts")
"""Arrays of an ensemble that change."""

BATCHES = 64
"""Independent batches at most; a batch is made of whole blocks of lanes."""

APART = 512
"""Blocks at most whose trajectories have sums of their own, 65536 of them: enough for the variance
of path means to half a per cent. Of the others there are sums over each block."""

PIECE = 64
"""Blocks whose starts are drawn together, beginning at its multiples."""


def kernel_key(
    system: System,
    scheme: Scheme,
    step: StepArrays,
    histograms: Sequence[Histogram],
    products: Sequence[Product],
) -> KernelKey:
    """Return what the kernel must be compiled for: the effects and the observables asked for."""
    kinds, effects = {c.kind for h in histograms for c in h.observable}, effects_of(system)
    whole = any(c.kind == "H" and c.index is None for h in histograms for c in h.observable)
    one_loop = (system.n, step.pairs) in ONE_LOOP and not effects.state_damping
    alone = step.stop_slot.size == step.slot_mass.size and scheme.kick_first
    kicked = tuple(int(i) for i in step.slot_mass) if one_loop and alone else ()
    return KernelKey(
        laws=effects.laws,
        kick_first=scheme.kick_first or not (effects.contact or effects.state_damping),
        damping=effects.state_damping,
        energy_damping=effects.energy_damping,
        observed=bool(kinds or products),
        momenta=bool(kinds & {"p", "H"} or products or effects.state_damping),
        energy=whole or bool(products and effects.energy_damping),
        modes=bool(modes_of(histograms)),
        moments=bool(products),
        masses=system.n,
        pairs=step.pairs,
        kicked=kicked,
        substeps=step.substeps is not None,
    )


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


@dataclass(eq=False)
class Ensemble:
    """States of ``paths`` trajectories, in blocks of lanes; a block is never divided.

    A batch of blocks is one task of one thread, all counts are integers, and sums grow in the order
    of samples: the result is bitwise the same for any number of threads and any division of the
    steps into calls of ``advance``. Lanes beyond ``paths`` run but are not counted.
    The first ``APART`` blocks have ``sums`` for each trajectory; in the others, ``folded``, every
    ``FOLDED``-th trajectory of a block shares one.

    With ``part`` it is a share of the ensemble: the blocks from the first number to before the
    second, the same trajectories as in the whole. Counts of shares add up, rows of ``counts``
    being batches from ``batch`` on; states and sums are put side by side.
    """

    system: System
    scheme: Scheme
    dt: float
    paths: int
    seed: int
    threads: int
    part: tuple[int, int] | None = None
    step: StepArrays = field(init=False)
    states: Array = field(init=False)  # (blocks, 2n, LANES)
    live: Integers = field(init=False)
    edges: Integers = field(init=False)  # first block of each batch, and the last block's end
    batch: int = field(init=False)  # the first batch of these blocks
    done: int = 0

    def __post_init__(self) -> None:
        """Start from q = 0 and momenta of the temperature (covariance kT M).

        With damping terms the displacements are drawn, too: on a limit cycle the noise alone mixes
        phases, and slowly.
        """
        n, blocks = self.system.n, block_count(self.paths)
        first, end = self.part or (0, blocks)
        self.step = step_arrays(self.system, self.scheme, self.dt)
        self.states = np.zeros((end - first, 2 * n, LANES))
        for piece in range(first - first % PIECE, end, PIECE):
            low, high = max(first, piece), min(end, piece + PIECE)
            self.states[low - first : high - first] = self._drawn(piece)[low - piece : high - piece]
        self.live = np.minimum(LANES, self.paths - LANES * np.arange(first, end))
        edges = batch_edges(self.paths)
        self.batch, beyond = batch_range(edges, first, end)
        self.edges = np.clip(edges[self.batch : beyond + 1], first, end)
        self.watch()

    def _drawn(self, first: int) -> Array:
        """Return the states (PIECE, 2n, LANES) in which the blocks from ``first`` on start.

        Whole pieces: matrix products may round by the shape they come in.
        """
        n, kT = self.system.n, temperature(self.system)
        # A trajectory owns 2**40 words; so many lie before those of the piece's first one.
        words = START + ((first * LANES) << 40)
        states = np.zeros((PIECE, 2 * n, LANES))
        L = factored(np.diag((kT if np.isfinite(kT) else 0.0) * self.system.mass))
        p = L @ normals(self.seed, PIECE * LANES, words, n)[: L.shape[1]]
        states[:, n:] = p.reshape(n, -1, LANES).transpose(1, 0, 2)
        if self.system.damping_terms:
            z = normals(self.seed, PIECE * LANES, words + n, n)
            q = start_displacements(self.system, kT, z)
            states[:, :n] = q.reshape(n, -1, LANES).transpose(1, 0, 2)
        return states

    @property
    def _kernel(self) -> Any:
        return compiled_kernel(self._key)

    def watch(self, histograms: Sequence[Histogram] = (), products: Sequence[Product] = ()) -> None:
        """Observe these from now on, all counts and sums starting from zero."""
        self._watch: WatchArrays = watch_arrays(
            self.system, self.scheme, self.step, histograms, products
        )
        self._key = kernel_key(self.system, self.scheme, self.step, histograms, products)
        self.counts: Integers = np.zeros((self.edges.size - 1, starts(histograms)[-1]), np.int64)
        own = self.states.shape[0]
        apart = min(own, max(0, APART - (self.part or (0, 0))[0]))
        self.sums: Array = np.zeros((apart, len(products), LANES))
        self.folded: Array = np.zeros((own - apart, len(products), FOLDED))
        self.samples = 0
        self.phase = 0

    def advance(self, steps: int, *, stride: int = 1) -> None:
        """Advance all trajectories; every ``stride``-th step since ``watch`` is observed, or none.

        ``stride`` 0: nothing is observed, and ``watch`` may be called with ranges still unknown.
        """
        counter = np.uint64(self.done * self.step.words)
        offset = mixed_seed(self.seed)
        blocks, kernel = self.states.shape[0], self._kernel
        x = self.states.reshape(blocks, -1)
        apart, products = self.sums.shape[:2]
        sums = self.sums.reshape(apart, products * LANES)
        folded = self.folded.reshape(blocks - apart, products * FOLDED)
        own = self.edges - self.edges[0]

        def batch(b: int) -> None:
            part = slice(own[b], own[b + 1])
            beyond = slice(max(0, own[b] - apart), max(0, own[b + 1] - apart))
            kernel(
                x[part], sums[part], folded[beyond], self.live[part], int(self.edges[b]), counter,
                steps, self.phase, stride, offset, self.step, self._watch, self.counts[b],
            )  # fmt: skip

        batches = range(self.edges.size - 1)
        if self.threads == 1:
            for b in batches:
                batch(b)
        else:
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(batch, batches))
        if stride:
            self.samples += -(-(self.phase + steps) // stride) - -(-self.phase // stride)
            self.phase += steps
        self.done += steps

    def counted(self, first: int, end: int) -> Integers:
        """Return the counts of the bins from ``first`` to before ``end``, of each batch."""
        return self.counts[:, first:end]

    def copied(self) -> "Ensemble":
        """Return an ensemble that advances apart from this one."""
        other = copy(self)
        other.states, other.counts = self.states.copy(), self.counts.copy()
        other.sums, other.folded = self.sums.copy(), self.folded.copy()
        return other

    def saved(self) -> Saved:
        """Return all that changes: what ``restore`` needs to go on as if never stopped."""
        clock = np.array([self.done, self.samples, self.phase], dtype=np.int64)
        return {**{name: getattr(self, name) for name in ARRAYS}, "clock": clock}

    def restore(self, saved: Saved) -> None:
        """Go on from what ``saved`` returned, after the same calls of ``watch``."""
        for name in ARRAYS:
            getattr(self, name)[...] = saved[name]
        self.done, self.samples, self.phase = (int(number) for number in saved["clock"])

    def phase_points(self, most: int | None = None) -> tuple[Array, Array]:
        """Return the states (paths, n) of q and p just before the next kick, the first ``most``."""
        n, live = self.system.n, int(self.live.sum())
        paths = live if most is None else min(live, most)
        states = self.states[: block_count(paths)]
        lanes = states.transpose(1, 0, 2).reshape(2 * n, -1)[:, :paths].T
        return lanes[:, :n], lanes[:, n:]

    def lost(self) -> int:
        """Return how many trajectories have left the finite range."""
        finite = np.isfinite(self.states).all(axis=1)
        return int(np.sum(~finite & (np.arange(LANES) < self.live[:, None])))

    def block_sums(self) -> Array:
        """Return the sums (blocks, products) over the trajectories of each block."""
        alive = np.arange(LANES) < self.live[: self.sums.shape[0], None]
        apart = np.where(alive[:, None, :], self.sums, 0.0).sum(axis=2)
        return np.concatenate([apart, self.folded.sum(axis=2)])

    def batch_means(self) -> Array:
        """Return (batches, products) means over the samples of each batch, in fixed order."""
        return means_of_batches(self.block_sums(), self.edges, self.live, self.samples)


def block_count(paths: int) -> int:
    """Return the number of blocks that hold ``paths`` trajectories."""
    return -(-paths // LANES)


def batch_edges(paths: int) -> Integers:
    """Return the first block of each batch, and the number of blocks."""
    blocks = block_count(paths)
    batches = min(BATCHES, blocks)
    return np.arange(batches + 1, dtype=np.int64) * blocks // batches


def batch_sizes(edges: Integers, paths: int) -> Integers:
    """Return the trajectories of each batch, of ``paths`` in all."""
    return np.minimum(LANES * edges[1:], paths) - LANES * edges[:-1]


def batch_range(edges: Integers, first: int, end: int) -> tuple[int, int]:
    """Return the first batch that has some of the blocks ``first`` to before ``end``, and beyond.

    ``edges`` come from ``batch_edges``; the first and the last batch may reach farther.
    """
    low = int(np.searchsorted(edges, first, side="right")) - 1
    return low, int(np.searchsorted(edges, end, side="left"))


def means_of_batches(sums: Array, edges: Integers, live: Integers, samples: int) -> Array:
    """Return (batches, products) means from ``sums`` (blocks, products), added block by block."""
    first = edges[:-1] - edges[0]
    paths = np.add.reduceat(live, first)
    means: Array = np.add.reduceat(sums, first, axis=0) / (paths[:, None] * max(1, samples))
    return means
