"""An ensemble of trajectories that advances together and adds to histograms and moments."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

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


class Share(NamedTuple):
    """The blocks from number ``first`` on of an ensemble: all of them that changes."""

    first: int
    states: Array  # (blocks, 2n, LANES)
    sums: Array = np.zeros((0, 0, 0))  # (first blocks, products, LANES)
    folded: Array = np.zeros((0, 0, 0))  # (other blocks, products, FOLDED)
    counts: Integers = np.zeros((0, 0), dtype=np.int64)  # (batches that it has blocks of, bins)

    @property
    def end(self) -> int:
        """The number behind that of the last block."""
        return self.first + self.states.shape[0]

    def batches(self, edges: Integers) -> tuple[int, int]:
        """Return the first batch of which it has some blocks, and that behind the last."""
        first = int(np.searchsorted(edges, self.first, side="right")) - 1
        return first, int(np.searchsorted(edges, self.end, side="left"))


def watching(share: Share, *, edges: Integers, bins: int, products: int) -> Share:
    """Return the share with counts and sums of zero; ``edges`` are those of the batches."""
    blocks = share.states.shape[0]
    apart = min(blocks, max(0, APART - share.first))
    first, beyond = share.batches(edges)
    return share._replace(
        sums=np.zeros((apart, products, LANES)),
        folded=np.zeros((blocks - apart, products, FOLDED)),
        counts=np.zeros((beyond - first, bins), dtype=np.int64),
    )


def emptied(share: Share, states: Array, sums: Array, folded: Array) -> Share:
    """Return the share with other states and sums, and counts of zero."""
    return Share(share.first, states, sums, folded, np.zeros_like(share.counts))


@dataclass(frozen=True, eq=False)
class Advance:
    """A call of the kernel: ``steps`` steps of a share, the same for all; see ``Ensemble``."""

    key: KernelKey
    step: StepArrays
    watch: WatchArrays
    edges: Integers
    paths: int
    seed: int
    done: int
    phase: int
    steps: int
    stride: int

    def __call__(self, share: Share) -> Share:
        """Advance a share in place and return it."""
        kernel, first = compiled_kernel(self.key), share.first
        blocks, (apart, products) = share.states.shape[0], share.sums.shape[:2]
        x = share.states.reshape(blocks, -1)
        sums = share.sums.reshape(apart, products * LANES)
        folded = share.folded.reshape(blocks - apart, products * FOLDED)
        live = lanes_alive(self.paths, first, share.end)
        low, beyond = share.batches(self.edges)
        own = np.clip(self.edges[low : beyond + 1], first, share.end) - first
        for b, counts in enumerate(share.counts):
            part = slice(own[b], own[b + 1])
            others = slice(max(0, own[b] - apart), max(0, own[b + 1] - apart))
            kernel(
                x[part], sums[part], folded[others], live[part], int(first + own[b]),
                np.uint64(self.done * self.step.words), self.steps, self.phase, self.stride,
                mixed_seed(self.seed), self.step, self.watch, counts,
            )  # fmt: skip
        return share


class Summary(NamedTuple):
    """What is asked of a share, or of all, between two chunks: small beside its trajectories."""

    lost: int
    sums: Array  # (blocks, products)
    counts: Integers


def summary(share: Share, *, paths: int) -> Summary:
    """Return how many trajectories have left the finite range, and the sums over each block."""
    alive = np.arange(LANES) < lanes_alive(paths, share.first, share.end)[:, None]
    finite = np.isfinite(share.states).all(axis=1)
    apart = np.where(alive[: share.sums.shape[0], None, :], share.sums, 0.0).sum(axis=2)
    sums = np.concatenate([apart, share.folded.sum(axis=2)])
    return Summary(int(np.sum(~finite & alive)), sums, share.counts)


@dataclass(frozen=True)
class Threads:
    """Workers of an ensemble: ``threads`` of this process, each at one of the ``shares``."""

    threads: int = 1
    shares: int = BATCHES

    def map(self, task: Any, *columns: Any) -> list[Any]:
        """Return what ``task`` makes of every share."""
        if self.threads == 1:
            return [task(*row) for row in zip(*columns, strict=True)]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(task, *columns))

    def values(self, answers: list[Any]) -> list[Any]:
        """Return the answers of ``map``: they are here."""
        return answers


@dataclass(eq=False)
class Ensemble:
    """States of ``paths`` trajectories, in blocks of lanes; a block is never divided.

    Blocks are worked on share by share, by ``workers``: threads of this process, or of a cluster
    (``sim.cluster``). Streams are keyed by trajectory, all counts are integers, and sums grow in
    the order of samples and are added in that of blocks: the result is bitwise the same for any
    workers and any division of the steps into calls of ``advance``. Lanes beyond ``paths`` run but
    are not counted. The first ``APART`` blocks have ``sums`` for each trajectory; in the others,
    ``folded``, every ``FOLDED``-th trajectory of a block shares one.
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
    bounds: Integers = field(init=False)  # first block of each share, and the number of blocks
    live: Integers = field(init=False)  # lanes of each block that are trajectories
    done: int = 0
    samples: int = 0
    phase: int = 0  # steps since ``watch`` that might have been observed

    def __post_init__(self) -> None:
        """Draw the states in which the trajectories start."""
        self.workers = self.workers or Threads(self.threads)
        self.threads = self.workers.threads
        self.step = step_arrays(self.system, self.scheme, self.dt)
        blocks = -(-self.paths // LANES)
        self.edges = divided(blocks, BATCHES)
        self.bounds = divided(blocks, self.workers.shares)
        self.live = lanes_alive(self.paths, 0, blocks)
        states = np.empty((blocks, 2 * self.system.n, LANES))
        for piece in range(0, blocks, PIECE):
            drawn = start_states(self.system, self.seed, piece)
            states[piece : piece + PIECE] = drawn[: blocks - piece]
        parts = np.split(states, self.bounds[1:-1])
        self._shares = self.workers.map(Share, self.bounds[:-1].tolist(), parts)
        self.watch()

    def watch(self, histograms: Sequence[Histogram] = (), products: Sequence[Product] = ()) -> None:
        """Observe these from now on, all counts and sums starting from zero."""
        asked = (self.system, self.scheme, self.step, histograms, products)
        self._watch, self._key = watch_arrays(*asked), kernel_key(*asked)
        bins = int(starts(histograms)[-1])
        self._restored = np.zeros((self.edges.size - 1, bins), dtype=np.int64)
        self._now(
            self.workers.map(
                partial(watching, edges=self.edges, bins=bins, products=len(products)),
                self._shares,
            )
        )
        self.samples = self.phase = 0

    def advance(self, steps: int, *, stride: int = 1) -> None:
        """Advance all trajectories; every ``stride``-th step since ``watch`` is observed, or none.

        ``stride`` 0: nothing is observed, and ``watch`` may be called with ranges still unknown.
        """
        task = Advance(
            self._key, self.step, self._watch, self.edges, self.paths, self.seed,
            self.done, self.phase, steps, stride,
        )  # fmt: skip
        self._now(self.workers.map(task, self._shares))
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
    def folded(self) -> Array:
        """Sums (other blocks, products, FOLDED)."""
        return self._joined("folded")

    @property
    def counts(self) -> Integers:
        """Counts (batches, bins) of all histograms, one more bin each for outside."""
        return self._summed().counts

    def lost(self) -> int:
        """Return how many trajectories have left the finite range."""
        return self._summed().lost

    def batch_paths(self) -> Integers:
        """Return the number of trajectories of each batch."""
        return np.add.reduceat(self.live, self.edges[:-1])

    def batch_means(self) -> Array:
        """Return (batches, products) means over the samples of each batch, in fixed order."""
        sums = np.add.reduceat(self._summed().sums, self.edges[:-1], axis=0)
        return np.asarray(sums / (self.batch_paths()[:, None] * max(1, self.samples)))

    def phase_points(self, most: int | None = None) -> tuple[Array, Array]:
        """Return the states (paths, n) of q and p just before the next kick, the first ``most``.

        Only shares that have some of them are asked.
        """
        n, paths = self.system.n, self.paths if most is None else min(self.paths, most)
        shares = int(np.searchsorted(LANES * self.bounds, paths))
        states = self._joined("states", shares)
        lanes = states.transpose(1, 0, 2).reshape(2 * n, -1)[:, :paths].T
        return lanes[:, :n], lanes[:, n:]

    def saved(self) -> Saved:
        """Return all that changes: what ``restore`` needs to go on as if never stopped."""
        arrays = {name: getattr(self, name) for name in ("states", "sums", "folded", "counts")}
        return {**arrays, "clock": np.array([self.done, self.samples, self.phase], dtype=np.int64)}

    def restore(self, saved: Saved) -> None:
        """Go on from what ``saved`` returned, by any workers, after the same calls of ``watch``."""
        self.done, self.samples, self.phase = (int(number) for number in saved["clock"])
        self._restored = np.array(saved["counts"])
        bounds, apart = self.bounds[1:-1], saved["sums"].shape[0]
        arrays = [np.split(saved[name], bounds) for name in ("states", "sums")]
        arrays.append(np.split(saved["folded"], np.maximum(0, bounds - apart)))
        self._now(self.workers.map(emptied, self._shares, *arrays))

    def _now(self, shares: list[Any]) -> None:
        self._shares, self._known = shares, None

    def _summed(self) -> Summary:
        """Losses, sums and counts of all shares, asked for once a step: of a cluster it is slow."""
        if self._known is None:
            ask = partial(summary, paths=self.paths)
            parts = self.workers.values(self.workers.map(ask, self._shares))
            counts = self._restored.copy()
            for first, part in zip(self.bounds.tolist(), parts, strict=False):
                row = int(np.searchsorted(self.edges, first, side="right")) - 1
                counts[row : row + part.counts.shape[0]] += part.counts
            sums = np.concatenate([part.sums for part in parts])
            self._known = Summary(sum(part.lost for part in parts), sums, counts)
        return self._known

    def _joined(self, name: str, shares: int | None = None) -> Array:
        answers = self.workers.map(attrgetter(name), self._shares[:shares])
        return np.concatenate(self.workers.values(answers))


def divided(blocks: int, parts: int) -> Integers:
    """Return the first block of each of so many parts, or fewer, and the number of blocks."""
    parts = min(parts, blocks)
    return np.arange(parts + 1, dtype=np.int64) * blocks // parts


def lanes_alive(paths: int, first: int, end: int) -> Integers:
    """Return the lanes of the blocks ``first`` to before ``end`` that are trajectories."""
    return np.minimum(LANES, paths - LANES * np.arange(first, end))
