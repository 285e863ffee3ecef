"""Trajectories of Eq. (6) from given states, whose observed states are read at every sample."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from fpk.arrays import Array, Integers
from fpk.effects import effects_of
from fpk.errors import NotApplicable
from fpk.modulation import Modulation
from fpk.observable import Coordinate
from fpk.system import System
from sim.arrays import LANES, StepArrays, WatchArrays
from sim.ensemble import LEAST_WORK
from sim.kernel import KernelKey, compiled_kernel
from sim.motion.steps import loudest
from sim.plan import step_arrays, watched
from sim.random import Singles, mixed_seed
from sim.reachable import Reachable
from sim.schemes import SCHEMES, Scheme
from sim.workers import Workers

Reader = Callable[..., None]
"""Called as ``read(trace, samples, done, *arrays)`` for some blocks: ``trace`` (blocks, many, rows,
LANES) holds the observed states number ``done`` to ``done + samples``; ``arrays`` are those of
these blocks, changed in place. A function of a module, or a ``partial`` of one."""

GROUP, PIECE = 4, 32
"""Blocks and samples of a trace that is read at once: they fit into the cache of a core."""

INVERSIONS, INVERTED = 100, 1e-13
"""Iterations in which the observed state becomes the start, and what may be left of its size."""


def nothing(trace: Array, samples: int, done: int) -> None:
    """Read nothing."""


@dataclass(eq=False)
class Motion:
    """Trajectories that begin in the observed states ``q``, ``p`` (paths, n) at number 0.

    ``paths`` is a multiple of ``LANES``. A sample is taken every ``stride`` steps ``dt``; its rows
    are q (n), p (n) and the ``energies``; ``last`` (blocks, rows, LANES) is the one of number
    ``samples``. ``modulation`` e is of the noise, number 0 at its time ``begin``: a step has the
    root of the mean square. ``halved``: a step has the random numbers of two steps dt/2, so that it
    is the same motion but for the error of the step. Trajectories own the words of the block
    ``first`` on, from ``word`` on. The answer does not depend on the number of ``workers`` (None:
    one thread).
    """

    system: System
    q: Array
    p: Array
    dt: float
    seed: int
    energies: tuple[Coordinate, ...] = ()
    scheme: Scheme = SCHEMES["exact_flow"]
    halved: bool = False
    stride: int = 1
    first: int = 0
    word: int = 0
    workers: Any = None
    modulation: Modulation | None = None
    begin: float = 0.0
    last: Array = field(init=False)
    samples: int = 0
    _states: Array = field(init=False)  # (blocks, 2n, LANES), one step further, before its kick
    _reachable: Reachable = field(init=False)

    def __post_init__(self) -> None:
        """Find the states whose observation is (q, p); that is the sample number 0."""
        self.workers = self.workers or Workers(ThreadPoolExecutor(1), 1)
        n = self.system.n
        coordinates = [Coordinate(kind, i) for kind in ("q", "p") for i in range(n)]
        self._step = step_arrays(self.system, self.scheme, self.dt, halved=self.halved)
        self._key, self._watch = watched(
            self.system, self.scheme, self._step, (), (), [*coordinates, *self.energies],
            halved=self.halved,
        )  # fmt: skip
        self._key = replace(self._key, modulated=self.modulation is not None)
        energy = float(np.max(self.system.hamiltonian(self.q, self.p)))
        self._reachable = Reachable(loudest(self.system), self.scheme, self.dt, energy)
        wanted = in_blocks(np.hstack([self.q, self.p]))
        self._states = wanted.copy()
        # Displacements in units of momenta.
        impedance = np.sqrt(self.system.mass * np.diag(self.system.stiffness_matrix))
        scale = np.concatenate([impedance, np.ones(n)])[:, None]
        enough = INVERTED * np.max(np.abs(wanted * scale))
        for _ in range(INVERSIONS):
            states = self._states.copy()
            trace = self._first_step(states)
            with np.errstate(over="ignore", invalid="ignore"):  # not a number is not enough
                missing = wanted - trace[:, : 2 * n]
                if np.all(np.abs(missing * scale) <= enough):
                    self.last, self._states = trace, states
                    return
                self._states += missing
        raise NotApplicable(f"no step of {self.dt:g} begins in the start; use a smaller dt")

    @property
    def time(self) -> float:
        """Time of the last sample, ``begin`` at the start."""
        return self.begin + self.samples * self.stride * self.dt

    def onward(self, dt: float, stride: int = 1) -> "Motion":
        """Return the motion from the last sample on, in steps of another ``dt``."""
        q, p = np.split(in_rows(self.last)[:, : 2 * self.system.n], 2, axis=1)
        return replace(
            self, q=q, p=p, dt=dt, stride=stride, word=self.next_word, begin=self.time, samples=0
        )

    @property
    def next_word(self) -> int:
        """The first word that no sample has depended on."""
        return self.word + self.samples * self.stride * self._step.words

    def advance(
        self, samples: int, read: Reader = nothing, *arrays: Any, passed: Array | None = None
    ) -> None:
        """Advance by so many samples; ``read`` sees each, with the one before the first of them.

        ``arrays`` are split by blocks, their first axis. Raises ``NotCertified`` where the step is
        seen to be unstable, by trajectories of which ``passed`` (blocks, 1, LANES) is then inf.
        """
        task = partial(
            followed, key=self._key, step=self._step, watch=self._watch,
            offset=mixed_seed(self.seed), word=self.next_word + self._step.words,
            done=self.samples, samples=samples, stride=self.stride, read=read,
            strength=self._strength,
        )  # fmt: skip
        blocks = len(self.last)
        worth = samples * self.stride * blocks * LANES // LEAST_WORK
        tasks = max(1, min(worth, 4 * self.workers.threads, blocks))
        cuts = [blocks * k // tasks for k in range(1, tasks)]
        columns = [np.split(a, cuts) for a in (self._states, self.last, *arrays)]
        firsts = [self.first + cut for cut in (0, *cuts)]
        answers = self.workers.map(task, firsts, *columns)
        for views, changed in zip(zip(*columns, strict=True), answers, strict=True):
            for view, array in zip(views, changed, strict=True):
                if view is not array:  # it comes from another process
                    view[...] = array
        self.samples += samples
        running = None if passed is None else np.isinf(passed[:, 0])
        self._reachable.require(self.last, self.time - self.begin, running)

    def keep(self, lanes: Integers) -> None:
        """Go on with the trajectories ``lanes``, counted along the blocks; one may come twice.

        Copies go apart after one step: random numbers belong to the place. The last block is
        filled up with the first of them.
        """
        self._states, self.last = gathered(self._states, lanes), gathered(self.last, lanes)

    def _strength(self, first: int, steps: int) -> Singles | None:
        """The factors on the noise of so many steps from number ``first`` on."""
        if self.modulation is None:
            return None
        begins = self.begin + self.dt * np.arange(first, first + steps, dtype=float)
        return np.sqrt(self.modulation.mean_square(begins, self.dt)).astype(np.float32)

    def _first_step(self, states: Array) -> Array:
        """Advance ``states`` by the first step; return the observed states at its start."""
        blocks, rows = len(states), self._watch.traced.size
        trace = np.empty((blocks, 2, rows, LANES))
        _run(
            self._key, states, trace, first=self.first, word=self.word, steps=1, phase=0,
            stride=self.stride, offset=mixed_seed(self.seed), watch=self._watch,
            step=self._step._replace(strength=self._strength(0, 1)),
        )  # fmt: skip
        return np.ascontiguousarray(trace[:, 1])


def in_blocks(rows: Array) -> Array:
    """Return a copy of ``rows`` (paths, k) as blocks (blocks, k, LANES)."""
    return np.array(rows.T.reshape(rows.shape[1], -1, LANES).transpose(1, 0, 2), order="C")


def in_rows(blocks: Array) -> Array:
    """Return a copy of ``blocks`` (blocks, k, LANES) as rows (paths, k)."""
    return np.array(blocks.transpose(0, 2, 1).reshape(-1, blocks.shape[1]), order="C")


def gathered(blocks: Array, lanes: Integers) -> Array:
    """Return the ``lanes`` of ``blocks`` (blocks, k, LANES), filled up to whole blocks."""
    padded = np.concatenate([lanes, np.repeat(lanes[:1], -lanes.size % LANES)])
    return in_blocks(in_rows(blocks)[padded])


def followed(
    first: int, states: Array, last: Array, *arrays: Any, key: KernelKey, step: StepArrays,
    watch: WatchArrays, offset: np.uint64, word: int, done: int, samples: int, stride: int,
    read: Reader, strength: Callable[[int, int], Singles | None],
) -> tuple[Any, ...]:  # fmt: skip
    """Advance blocks that begin with ``first`` and read their samples; all change in place."""
    blocks, rows, _ = last.shape
    for b in range(0, blocks, GROUP):
        own = slice(b, min(b + GROUP, blocks))
        trace = np.empty((own.stop - b, min(PIECE, samples) + 1, rows, LANES))
        for k in range(0, samples, PIECE):
            many = min(PIECE, samples - k)
            trace[:, 0] = last[own]
            _run(
                key, states[own], trace, first=first + b, word=word + k * stride * step.words,
                steps=many * stride, phase=1, stride=stride, offset=offset, watch=watch,
                step=step._replace(strength=strength((done + k) * stride + 1, many * stride)),
            )  # fmt: skip
            last[own] = trace[:, many]
            read(trace, many, done + k, *(a[own] for a in arrays))
    return (states, last, *arrays)


def _run(
    key: KernelKey, states: Array, trace: Array, *, first: int, word: int, steps: int, phase: int,
    stride: int, offset: np.uint64, step: StepArrays, watch: WatchArrays,
) -> None:  # fmt: skip
    blocks, none = len(states), np.zeros((0, 0))
    live, batch = np.full(blocks, LANES), np.zeros(blocks, dtype=np.int64)
    compiled_kernel(key)(
        states.reshape(blocks, -1), none, none, np.zeros((1, 0), dtype=np.int64), live, batch,
        first, np.uint64(word), steps, phase, stride, offset, step, watch,
        trace.reshape(blocks, -1),
    )  # fmt: skip


def needs_steps(system: System) -> bool:
    """Return whether the step has an error at all: without contact and terms it is exact."""
    effects = effects_of(system)
    return effects.contact or effects.state_damping
