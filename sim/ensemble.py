"""An ensemble of trajectories that advances together and adds to histograms and moments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.system import System
from sim.arrays import LANES, Array, Integers, StepArrays
from sim.batch import Batch, Summary, Threads, advanced, copied, summary, watching
from sim.flow import factored
from sim.histogram import Histogram, starts
from sim.plan import kernel_key, step_arrays, watch_arrays
from sim.random import START, normals
from sim.scheme import Scheme
from sim.statistics import Product
from sim.step_size import temperature

Saved = Mapping[str, NDArray[Any]]

BATCHES = 64
"""Independent batches at most; a batch is made of whole blocks of lanes."""

PIECE = 64
"""Blocks whose starts are drawn together, beginning at its multiples."""


def start_states(system: System, seed: int, piece: int) -> Array:
    """Return the states (PIECE, 2n, LANES) in which the blocks from ``piece`` on start.

    They are q = 0 and momenta of the temperature (covariance kT M). With damping terms the
    displacements are drawn, too: on a limit cycle the noise alone mixes phases, and slowly.
    Whole pieces: matrix products may round by the shape they come in.
    """
    n, kT = system.n, temperature(system)
    # A trajectory owns 2**40 words; so many lie before those of the piece's first one.
    words = START + ((piece * LANES) << 40)
    L = factored(np.diag((kT if np.isfinite(kT) else 0.0) * system.mass))
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


@dataclass(eq=False)
class Ensemble:
    """States of ``paths`` trajectories, in blocks of lanes, and batches of blocks.

    ``workers`` are threads of this process, or those of a cluster (``sim.cluster``). Streams are
    keyed by trajectory, all counts are integers, and sums grow in the order of samples: the result
    is bitwise the same for any workers and any division of the steps into calls of ``advance``.
    Lanes beyond ``paths`` run but are not counted. The first ``APART`` blocks have ``sums`` for
    each trajectory; in the others, ``folded``, every ``FOLDED``-th lane of a block shares one.
    """

    system: System
    scheme: Scheme
    dt: float
    paths: int
    seed: int
    threads: int = 1
    workers: Any = None  # None: so many threads of this process
    step: StepArrays = field(init=False)
    edges: Integers = field(init=False)  # first block of each batch, and the number of blocks
    live: Integers = field(init=False)  # (blocks,), lanes that are trajectories
    done: int = 0
    samples: int = 0
    phase: int = 0  # steps since ``watch`` that might have been observed

    def __post_init__(self) -> None:
        """Draw the states in which the trajectories start."""
        self.workers = self.workers or Threads(self.threads)
        self.threads = self.workers.threads
        self.step = step_arrays(self.system, self.scheme, self.dt)
        blocks = -(-self.paths // LANES)
        batches = min(BATCHES, blocks)
        self.edges = np.arange(batches + 1, dtype=np.int64) * blocks // batches
        self.live = np.minimum(LANES, self.paths - LANES * np.arange(blocks))
        states = np.empty((blocks, 2 * self.system.n, LANES))
        for piece in range(0, blocks, PIECE):
            drawn = start_states(self.system, self.seed, piece)
            states[piece : piece + PIECE] = drawn[: blocks - piece]
        parts = (np.split(array, self.edges[1:-1]) for array in (self.live, states))
        self._batches = self.workers.map(Batch, self.edges[:-1].tolist(), *parts)
        self.watch()

    def watch(self, histograms: Sequence[Histogram] = (), products: Sequence[Product] = ()) -> None:
        """Observe these from now on, all counts and sums starting from zero."""
        asked = (self.system, self.scheme, self.step, histograms, products)
        self._watch, self._key = watch_arrays(*asked), kernel_key(*asked)
        task = partial(watching, bins=int(starts(histograms)[-1]), products=len(products))
        self._replace(task, self._batches)
        self.samples = self.phase = 0

    def advance(self, steps: int, *, stride: int = 1) -> None:
        """Advance all trajectories; every ``stride``-th step since ``watch`` is observed, or none.

        ``stride`` 0: nothing is observed, and ``watch`` may be called with ranges still unknown.
        """
        task = partial(
            advanced, key=self._key, step=self.step, watch=self._watch, seed=self.seed,
            clock=(self.done, self.phase, steps, stride),
        )  # fmt: skip
        self._replace(task, self._batches)
        if stride:
            self.samples += -(-(self.phase + steps) // stride) - -(-self.phase // stride)
            self.phase += steps
        self.done += steps

    @property
    def states(self) -> Array:
        """States (blocks, 2n, LANES) just before the next kick."""
        return self._joined("states")

    @property
    def sums(self) -> Array:
        """Sums (first blocks, products, LANES) of each trajectory."""
        return self._joined("sums")

    @property
    def counts(self) -> Integers:
        """Counts (batches, bins) of all histograms, one more bin each for outside."""
        return np.stack([part.counts for part in self._summaries()])

    def lost(self) -> int:
        """Return how many trajectories have left the finite range."""
        return sum(part.lost for part in self._summaries())

    def batch_paths(self) -> Integers:
        """Return the number of trajectories of each batch."""
        return np.add.reduceat(self.live, self.edges[:-1])

    def batch_means(self) -> Array:
        """Return (batches, products) means over the samples of each batch, in fixed order."""
        blocks = np.concatenate([part.sums for part in self._summaries()])
        sums = np.add.reduceat(blocks, self.edges[:-1], axis=0)
        return np.asarray(sums / (self.batch_paths()[:, None] * max(1, self.samples)))

    def phase_points(self, most: int | None = None) -> tuple[Array, Array]:
        """Return q and p (paths, n) just before the next kick, of the first ``most`` paths."""
        n, paths = self.system.n, self.paths if most is None else min(self.paths, most)
        states = self._joined("states", int(np.searchsorted(LANES * self.edges, paths)))
        lanes = states.transpose(1, 0, 2).reshape(2 * n, -1)[:, :paths].T
        return lanes[:, :n], lanes[:, n:]

    def saved(self) -> Saved:
        """Return all that changes: what ``restore`` needs to go on as if never stopped."""
        return {
            **{name: self._joined(name) for name in ("states", "sums", "folded")},
            "counts": self.counts,
            "clock": np.array([self.done, self.samples, self.phase], dtype=np.int64),
        }

    def restore(self, saved: Saved) -> None:
        """Go on from what ``saved`` returned, by any workers, after the same calls of ``watch``."""
        self.done, self.samples, self.phase = (int(number) for number in saved["clock"])
        first, cuts = self.edges[:-1].tolist(), self.edges[1:-1]
        others = np.maximum(0, cuts - saved["sums"].shape[0])
        parts = [np.split(array, cuts) for array in (self.live, saved["states"], saved["sums"])]
        parts.append(np.split(saved["folded"], others))
        self._replace(copied, first, *parts, list(saved["counts"]))

    def _replace(self, task: Any, *columns: Any) -> None:
        """Let the batches be what ``task`` makes of ``columns``."""
        self._batches = self.workers.map(task, *columns)
        self._summary: list[Summary] = []

    def _summaries(self) -> list[Summary]:
        """Return losses, sums and counts, computed once a step: a cluster answers slowly."""
        if not self._summary:
            self._summary = self.workers.values(self.workers.map(summary, self._batches))
        return self._summary

    def _joined(self, name: str, batches: int | None = None) -> Array:
        """Return one array of the first ``batches`` (None: of all), joined along the blocks."""
        answers = self.workers.map(attrgetter(name), self._batches[:batches])
        joined = np.concatenate(self.workers.values(answers))
        joined.flags.writeable = False  # a copy: what is written to it would be lost
        return joined
