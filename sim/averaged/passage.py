"""First passage of averaged energies by simulation: bridges between steps, at dt and dt/2."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.evolution import Passage
from fpk.method import Progress, silent
from fpk.modulation import Modulation
from sim.arrays import in_blocks, in_rows
from sim.averaged.paths import BATCHES, Shares
from sim.averaged.square_root import SquareRootForm, never, square_root_step
from sim.motion.failure_times import Times
from sim.motion.limits import AT_LIMIT
from sim.motion.passing import Diffusion, pass_under
from sim.motion.steps import STEP_TO_LIMIT, first_step, stages
from sim.motion.survival import followed_for, passage_of, settled_at
from sim.random import stream_of

EMPTY = 0.75
"""Share of a batch still running at which those that have failed make room."""

MOST_DRAWS = 3e7
"""Random numbers at most where no wall time is given, some 20 s of one core: paths are followed for
no longer than that allows."""

MOST_STEPS = 1 << 40
"""Steps at most where the wall time ends them before."""

BISECTIONS = 60
"""Halvings in which X of an energy is found: to the last digit."""

Starts = Callable[[int, np.random.Generator], Array]
"""Energies (paths, d) at time 0, drawn from a stream."""


@dataclass(frozen=True, eq=False)
class EnergyLimits:
    """Limits of sums of X: ``weights`` (limits, d) · X reaches ``values`` (limits,).

    A sum S of square-root processes has dS = … + σ dB, σ² = Σ w² β X; as the noise moves S by 1 it
    moves σ² by Σ w³ β² X/σ². Both are forms of the momenta √X, as ``pass_energies`` has them.
    """

    weights: Array
    values: Array
    name: str

    def diffusion(self, form: SquareRootForm) -> Diffusion:
        """Return the forms of σ², and of its growth; at rest one energy alone begins to move."""
        w, one = self.weights[:, :, None], np.eye(form.slope.size)
        slope = form.slope[:, None]
        return Diffusion(w**2 * slope * one, w**3 * slope**2 * one, np.max(w * slope, axis=(1, 2)))

    def rows(self, X: Array) -> Array:
        """Return √X and the sums, (paths, d + limits)."""
        return np.hstack([np.sqrt(X), X @ self.weights.T])


def from_energies(form: SquareRootForm, energies: Array) -> Array:
    """Return X (paths, d) of ``energies``: by bisection, ``form.energies`` being monotone."""
    low, high = np.zeros_like(energies), np.broadcast_to(form.scales, energies.shape).copy()
    while np.any(below := form.energies(high) < energies):
        high[below] *= 2.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = form.energies(middle) < energies
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(high)


def energy_passage(
    form: SquareRootForm,
    limits: EnergyLimits,
    starts: Starts,
    times: Array,
    *,
    dt: float,
    memory: float,
    paths: int,
    seed: int,
    modulation: Modulation | None = None,
    threads: int = 1,
    seconds: float | None = None,
    tol: float = inf,
    progress: Progress = silent,
) -> Passage:
    """Return the first passage of any of ``limits`` in steps of dt/2, beside steps of ``dt``.

    Where steps are exact (``form.damping`` None) both see the same paths, else paths of their own.
    Between steps each distance to a limit is a Brownian bridge. Streams belong to batches: the
    answer does not depend on ``threads``. Paths are followed until they fail, for the cost of
    ``MOST_DRAWS``, or for ``seconds`` of wall time; as ``followed_for`` says where the noise ends.
    ``memory`` as of ``passage_of``.

    Raises ``InvalidInput`` for starts that all lie beyond a limit.
    """
    own, exact = -(-paths // BATCHES), form.damping is None
    # From rest the mean of Σ w X under the largest noise is the limit L at the time L/(w · d).
    loudest = 1.0 if modulation is None else modulation.largest
    filling = loudest * float(np.max(limits.weights @ form.noise / limits.values))
    dt = min(dt, STEP_TO_LIMIT / filling)
    first = first_step(dt, times)
    most = MOST_DRAWS / ((2 if exact else 3) * BATCHES * own * form.noise.size)
    most = (most if seconds is None else MOST_STEPS) * dt
    horizon = followed_for(most, float(np.max(times, initial=0.0)), modulation)
    steps = list(stages(first, dt, horizon, most=MOST_STEPS))
    halved = [(0.5 * h, 2 * many) for h, many in steps]
    failed = partial(_failed, form, limits, modulation=modulation)
    shares = Shares(seconds, threads)

    def followed(batch: int) -> tuple[Array, Array, Array]:
        stream = stream_of(seed, batch)
        X = from_energies(form, starts(own, stream))
        if exact:
            ends = shares.ends(batch)
            until, fine, coarse = failed(X, halved, stream, ends, strides=(1, 2))
        else:
            ends = shares.ends(batch, 2.0 / 3.0)
            until, fine = failed(X, halved, stream, ends)
            _, coarse = failed(X, steps, stream, end=until)
        return fine, coarse, np.full(own, until)

    rows = []
    with ThreadPoolExecutor(threads) as pool:
        for done, row in enumerate(pool.map(followed, range(BATCHES)), start=1):
            rows.append(row)
            progress(done, BATCHES, "first passage, averaged")
    return passage_of(
        Times(*(np.concatenate(times) for times in zip(*rows, strict=True))),
        times,
        limit=limits.name,
        step=first,
        memory=memory,
        tol=tol,
        settled=settled_at(modulation),
        failures=(),
        settings={
            "dt": 0.5 * dt,
            "coarse dt": dt,
            "steps": "exact" if exact else "Strang splitting",
            "seed": seed,
        },
    )


def _failed(
    form: SquareRootForm,
    limits: EnergyLimits,
    X: Array,
    steps: Sequence[tuple[float, int]],
    stream: np.random.Generator,
    ends: Callable[[], bool] = never,
    *,
    strides: tuple[int, ...] = (1,),
    end: float = inf,
    modulation: Modulation | None = None,
) -> tuple[Any, ...]:
    """Until when paths were followed, for all ``steps`` unless ``ends()``, and first passages.

    ``steps`` are (step, how many). Passages are seen every 1st, 2nd, … of them on the same paths,
    until ``end`` at the least; inf where none.
    """
    paths, until, time = len(X), sum(h * many for h, many in steps), 0.0
    lanes, rows = np.arange(paths), limits.rows(X)
    # One exponential number for each limit, of all strides: see ``pass_energies``.
    chance = stream.exponential(size=(paths, len(limits.values)))
    past = np.any(rows[:, X.shape[1] :] >= AT_LIMIT * limits.values, axis=1)
    first = np.where(past, 0.0, inf)[:, None]
    seen = [[in_blocks(a) for a in (rows, first, chance)] for _ in strides]
    found = np.repeat(first.T, len(strides), axis=0)
    see = partial(
        pass_under, modulation=modulation, first=0, rows=X.shape[1] + np.arange(chance.shape[1]),
        limits=limits.values, diffusion=limits.diffusion(form),
    )  # fmt: skip
    for step, h in enumerate((h for h, many in steps for _ in range(many)), start=1):
        X = square_root_step(form, X, h, stream, modulation, time)
        time += h
        after = in_blocks(limits.rows(X))
        for arrays, stride in zip(seen, strides, strict=True):
            if step % stride == 0:
                trace = np.stack([arrays[0], after], axis=1)
                see(trace, 1, 0, *arrays[1:], dt=stride * h, begin=time - stride * h)
                arrays[0] = after
        found[:, lanes] = [in_rows(now)[: lanes.size, 0] for _, now, _ in seen]
        running = np.flatnonzero(np.isinf(found[:, lanes]).any(axis=0))
        if not running.size or time >= end:
            break
        if step % strides[-1] == 0 and ends():
            until = time
            break
        if running.size <= EMPTY * lanes.size:
            X, lanes = X[running], lanes[running]
            seen = [[in_blocks(in_rows(a)[running]) for a in arrays] for arrays in seen]
    return until, *found
