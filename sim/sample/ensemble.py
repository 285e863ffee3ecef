"""Trajectories of Eq. (6) that advance together, and the counting of their observed states."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.answer.names import Coordinate
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.system.escape import escape
from fpk.system.modulation import Modulation
from fpk.system.system import System
from sim.sample.diagnostics import Product
from sim.sample.histogram import Histogram, starts
from sim.sample.plan import observation_arrays, step_arrays
from sim.sample.workers import Workers
from sim.step.arrays import LANES, MAX_BATCHES, StepArrays, WatchArrays, in_blocks, in_rows
from sim.step.kernel import KernelKey, kernel_for
from sim.step.random import start_states, stream_offset
from sim.step.schemes import SCHEMES, Scheme
from sim.step.step_size import largest_reached, loudest, stability_limit

Reader = Callable[..., None]
"""Called as ``read(trace, samples, done, *arrays)`` for some blocks: ``trace`` (blocks, samples + 1
or more, rows, LANES) holds the observed states number ``done`` to ``done + samples``; ``arrays``
have these blocks as first axis and are changed in place. A module's function or its ``partial``."""

TASKS_PER_THREAD = 8
"""Tasks of a thread in one call of ``advance``: so few cost little to distribute, and so many leave
other threads idle only for a short time at the end."""
TRACED = 1024
"""Largest number of observed samples times blocks of a task in one trace: some MB."""


def advance_batches(
    first: int, live: Integers, batch: Integers, *arrays: Any, key: KernelKey, step: StepArrays,
    watch: WatchArrays, offset: np.uint64, word: int, samples: int, phase: int, steps: int,
    stride: int, read: Reader | None,
) -> tuple[Any, ...]:  # fmt: skip
    """Advance the batches from block ``first`` on, and return the ``arrays``, changed in place.

    ``arrays``: states, sums, counts and last sample of these blocks, then the arrays of ``read``.
    ``live`` (blocks,): trajectories of a block; ``batch`` (blocks,): number of its batch. ``key``,
    ``step``, ``watch``: for the kernel; ``offset``: of the seed; ``word``: first random word of a
    trajectory. ``samples``, ``phase``: samples and steps since ``Ensemble.watch``, before these
    ``steps``, of which every ``stride``-th is observed, none if 0.
    """
    states, sums, counts, last, *own = arrays
    blocks, rows, strength = len(states), watch.traced.size, step.strength
    piece = max(1, TRACED // blocks) * stride if rows else steps
    trace = np.empty((blocks, min(piece, steps) // max(1, stride) + 1, rows, LANES))
    flat = (a.reshape(blocks, a.shape[1] * a.shape[2]) for a in (states, sums))
    fixed = *flat, counts, live, batch, first
    for k in range(0, max(1, steps), max(1, piece)):
        many = min(piece, steps - k)
        trace[:, 0] = last
        step = step._replace(strength=strength[k : k + many])
        kernel_for(key)(
            *fixed, np.uint64(word + k * step.words), many, phase + k, stride, offset, step,
            watch, trace.reshape(blocks, trace.shape[1] * rows * LANES),
        )  # fmt: skip
        if rows:
            last[:] = trace[:, many // stride]
            if read:
                read(trace, many // stride, samples + k // stride, *own)
    return arrays


@dataclass(eq=False)
class Ensemble:
    """``paths`` trajectories in blocks of lanes, and batches of blocks.

    Without a ``start`` they begin in ``random.start_states``. A ``start``, observed states q and p
    (paths, n) of whole blocks, is the sample number 0, and each sample can be read: q (n), p (n)
    and the ``energies``. ``halved``: a step uses the random numbers of two steps dt/2 and gives the
    same motion except for the error of the step. ``modulation`` e multiplies the noise, from the
    time ``begin`` on: a step has the root mean square of e. ``word``: number of the first random
    word of each trajectory.

    The result is bitwise the same for any ``workers`` (None: ``threads`` of this process) and any
    division of time into calls of ``advance``: streams belong to trajectories, counts are integers,
    and sums grow in the order of samples. Raises ``NotApplicable`` if no state before the kick has
    the ``start`` as its observed state.
    """

    system: System
    scheme: Scheme
    dt: float
    paths: int
    seed: int
    threads: int = 1
    workers: Any = None
    start: tuple[Array, Array] | None = None
    energies: tuple[Coordinate, ...] = ()
    halved: bool = False
    word: int = 0
    modulation: Modulation | None = None
    begin: float = 0.0
    done: int = field(init=False, default=0)  # steps made; with a start one more than its time has
    samples: int = field(init=False, default=0)  # since ``watch``
    phase: int = field(init=False, default=0)  # steps since ``watch`` with a stride

    def __post_init__(self) -> None:
        """Draw ``states`` (blocks, 2n, LANES) before the first kick, or find them from a start."""
        self.workers = self.workers or Workers(ThreadPoolExecutor(self.threads), self.threads)
        self.threads = self.workers.threads
        self.step = step_arrays(self.system, self.scheme, self.dt, halved=self.halved)
        if self.start is None:
            self.states = start_states(self.system, self.seed, -(-self.paths // LANES))
        else:
            self.states = in_blocks(np.hstack(self.start))
        self.energy = float(np.max(self.system.hamiltonian(*self.phase_points())))  # the largest
        self._loudest = loudest(self.system)
        self.watch()
        if self.start is None:
            return
        # Find the states before the kick whose observed states are the start, by iteration; each
        # iteration makes a step. ``scale`` converts displacements to momenta.
        n, wanted, before = self.system.n, self.states, self.states.copy()
        impedance = np.sqrt(self.system.mass * np.diag(self.system.stiffness_matrix))
        scale = np.concatenate([impedance, np.ones(n)])[:, None]
        enough = 1e-13 * np.max(np.abs(wanted * scale))
        for _ in range(100):
            self.states = before.copy()
            self._advance(1, 1, None, ())
            with np.errstate(over="ignore", invalid="ignore"):  # NaN does not pass the test
                missing = wanted - self.last[:, : 2 * n]
                if np.all(np.abs(missing * scale) <= enough):
                    self.done = self.phase = 1
                    return
                before += missing
        raise NotApplicable(f"no step of {self.dt:g} begins in the start; use a smaller dt")

    @property
    def edges(self) -> Integers:
        """First block of each batch, and last the number of blocks."""
        batches = min(MAX_BATCHES, len(self.states))
        return np.arange(batches + 1, dtype=np.int64) * len(self.states) // batches

    @property
    def live(self) -> Integers:
        """Number of lanes of each block that count as trajectories; all lanes are computed."""
        return np.minimum(LANES, self.paths - LANES * np.arange(len(self.states)))

    @property
    def time(self) -> float:
        """Time of the last sample of a motion from a ``start``, whose sample 0 is at ``begin``."""
        return self.begin + (self.done - 1) * self.dt

    @property
    def next_word(self) -> int:
        """Number of the first random word that no sample of a motion from a ``start`` used."""
        return self.word + (self.done - 1) * self.step.words

    def watch(self, histograms: Sequence[Histogram] = (), products: Sequence[Product] = ()) -> None:
        """Observe ``histograms`` and ``products`` from now on; counts and sums begin at zero."""
        self.histograms, self.products = tuple(histograms), tuple(products)
        traced = [Coordinate(kind, i) for kind in ("q", "p") for i in range(self.system.n)]
        self._key, self._watch = observation_arrays(
            self.system, self.scheme, self.step, self.histograms, self.products,
            () if self.start is None else (*traced, *self.energies),
        )  # fmt: skip
        blocks, bins = len(self.states), starts(self.histograms)[-1]
        self.last = np.zeros((blocks, self._watch.traced.size, LANES))
        self.sums = np.zeros((blocks, len(self.products), LANES))
        self.counts = np.zeros((self.edges.size - 1, bins), dtype=np.int64)
        self.samples = self.phase = 0

    def advance(
        self, steps: int, *arrays: NDArray[Any], stride: int = 1, read: Reader | None = None,
        passed: Array | None = None,
    ) -> None:  # fmt: skip
        """Advance by ``steps``; every ``stride``-th step since ``watch`` is observed, none if 0.

        With a start ``steps`` is a multiple of ``stride``, and ``read`` is called with the samples,
        the sample before them, and its ``arrays``, divided by blocks. Raises ``NotCertified`` if a
        trajectory leaves the range that the energy allows: the step is unstable. With ``passed``
        (blocks, 1, LANES) only trajectories count for which it is inf.
        """
        self._advance(steps, stride, read, arrays)
        if stride:
            self.samples += -(-(self.phase + steps) // stride) - -(-self.phase // stride)
            self.phase += steps
        self.done += steps
        largest = largest_reached(self._loudest, self.energy, self.done * self.dt)[:, None]
        beyond = ~(np.abs(self.states) <= largest).all(axis=1)  # True for NaN, too
        if passed is not None:
            beyond &= np.isinf(passed[:, 0])
        if lost := int(np.count_nonzero(beyond)):
            small = self.dt / self.scheme.small
            stable = stability_limit(self._loudest, self.scheme, energy=self.energy)
            reason = self._loudest.fact(escape) or (
                f"steps of {small:g} by {self.scheme.name} are unstable;"
                f" use a dt below {min(stable, 0.5 * small):.2g}"
            )
            words = f"{lost} trajectories left the range that the energy allows"
            raise NotCertified(f"{words}: {reason}")

    def _advance(
        self, steps: int, stride: int, read: Reader | None, arrays: Sequence[NDArray[Any]]
    ) -> None:
        """Advance states, sums, counts and last sample in place, but not the numbers of steps.

        Every ``stride``-th step is observed; ``read`` is called with the samples and ``arrays``.
        """
        step, dt = self.step, self.step.dt
        if self.modulation is not None:
            times = self.begin + dt * np.arange(self.done, self.done + steps, dtype=float)
            strength = np.sqrt(self.modulation.mean_square(times, dt)).astype(np.float32)
            step = step._replace(strength=strength)
        task = partial(
            advance_batches, key=self._key, step=step, watch=self._watch,
            offset=stream_offset(self.seed), word=self.word + self.done * step.words,
            samples=self.samples, phase=self.phase, steps=steps, stride=stride, read=read,
        )  # fmt: skip
        # A task has whole batches, each with its row of counts. A single thread has one task.
        tasks = min(TASKS_PER_THREAD * (self.threads - 1) + 1, len(self.counts))
        begins = np.arange(1, tasks) * len(self.counts) // tasks
        cuts = self.edges[begins]
        batch = np.repeat(np.arange(len(self.counts)), np.diff(self.edges))
        by_block = (self.states, self.sums, self.last, *arrays, self.live, batch)
        *columns, live, batches = (np.split(array, cuts) for array in by_block)
        columns.insert(2, np.split(self.counts, begins))
        answers = self.workers.map(task, [0, *cuts.tolist()], live, batches, *columns)
        for views, changed in zip(zip(*columns, strict=True), answers, strict=True):
            for view, array in zip(views, changed, strict=True):
                if view is not array:  # a copy, from another process
                    view[...] = array

    def onward(self, dt: float) -> "Ensemble":
        """Return a new ensemble that continues from the last sample in steps of ``dt``."""
        q, p = np.split(in_rows(self.last)[:, : 2 * self.system.n], 2, axis=1)
        return replace(self, start=(q, p), dt=dt, word=self.next_word, begin=self.time)

    def keep(self, lanes: Integers) -> None:
        """Continue with the trajectories ``lanes`` alone, numbered along the blocks.

        Sums and counts begin at 0, ``samples`` goes on: call ``watch`` before ``batch_means``. A
        number may occur twice: random numbers belong to the place, so that copies separate from
        their second step on. Copies of the first trajectory fill up the last block, and count.
        Raises ``ValueError`` if the ensemble has no ``start``.
        """
        self.states, self.last = (in_blocks(in_rows(a)[lanes]) for a in (self.states, self.last))
        self.paths = len(self.states) * LANES
        self.sums = np.zeros((len(self.states), *self.sums.shape[1:]))
        self.counts = np.zeros((self.edges.size - 1, self.counts.shape[1]), dtype=np.int64)

    def batch_paths(self) -> Integers:
        """Return the number (batches,) of trajectories of each batch."""
        return np.add.reduceat(self.live, self.edges[:-1])

    def batch_means(self) -> Array:
        """Return means of products over a batch's samples and trajectories, (batches, products)."""
        alive = np.arange(LANES) < self.live[:, None, None]
        blocks = np.where(alive, self.sums, 0.0).sum(axis=2)
        sums = np.add.reduceat(blocks, self.edges[:-1], axis=0)
        return np.asarray(sums / (self.batch_paths()[:, None] * max(1, self.samples)))

    def counted(self) -> Iterator[tuple[Histogram, Integers]]:
        """Return each histogram with its counts (batches, bins + 1); outside is the last bin."""
        counts = np.split(self.counts, starts(self.histograms)[1:-1], axis=1)
        return zip(self.histograms, counts, strict=False)  # no histograms: one empty part

    def phase_points(self, most: int | None = None) -> tuple[Array, Array]:
        """Return q and p (paths, n) just before the next kick, of the first ``most`` paths."""
        n, paths = self.system.n, self.paths if most is None else min(self.paths, most)
        lanes = self.states[: -(-paths // LANES)].transpose(1, 0, 2).reshape(2 * n, -1)
        return lanes[:n, :paths].T, lanes[n:, :paths].T

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return the arrays "states", "sums", "counts" and "clock" for ``restore``, not copied."""
        clock = np.array([self.done, self.samples, self.phase], dtype=np.int64)
        return {"states": self.states, "sums": self.sums, "counts": self.counts, "clock": clock}

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Continue from the arrays ``saved``, after the same calls of ``watch``."""
        self.done, self.samples, self.phase = saved["clock"].tolist()
        self.states[...], self.sums[...] = saved["states"], saved["sums"]
        self.counts[...] = saved["counts"]


def ensemble_from(
    system: System, q: Array, p: Array, dt: float, seed: int, **settings: Any
) -> Ensemble:
    """Return an ensemble with the start ``q``, ``p`` (paths, n), the step ``dt`` and a ``seed``.

    The scheme is exact_flow; ``settings`` are further fields of ``Ensemble``.
    """
    return Ensemble(system, SCHEMES["exact_flow"], dt, len(q), seed, start=(q, p), **settings)
