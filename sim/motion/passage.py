"""First passage in the full system (6): trajectories are followed until they pass the limit."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from fpk.arrays import Array
from fpk.certificate import tolerance
from fpk.clock import left_out
from fpk.errors import InvalidInput
from fpk.evolution import Passage
from fpk.limit import Limit
from fpk.method import Progress
from fpk.modulation import Modulation
from fpk.start import Start
from fpk.system import System
from sim.arrays import LANES
from sim.montecarlo import MonteCarlo
from sim.motion.failure_times import Times
from sim.motion.limits import beyond, energies_of, reach_of
from sim.motion.motion import Motion, gathered, in_blocks
from sim.motion.passing import reader_of
from sim.motion.starts import Origin
from sim.motion.stationary import interruption, not_met, working
from sim.motion.steps import first_step, loudest, motion_step, require_times, stages
from sim.motion.survival import followed_for, passage_of, settled_at
from sim.random import OTHER_SEED
from sim.relaxation import relaxation_time
from sim.workers import Workers

AT_ONCE = 32768
"""Trajectories that run together: a chunk of them takes less than a second."""

CHUNK = 256
"""Steps, of the coarser simulation, after which trajectories that have failed make room."""

HOPELESS = 8.0
"""A simulation ends in which nothing has failed in one over this of its time, where no time was
asked for: in the rest some 8 · 3 failures at most (95 %) are to be expected, too few to go on from.
"""

PROGRESS = 1000
"""Steps of the bar of progress."""


def passage(
    method: MonteCarlo,
    system: System,
    limit: Limit,
    start: Start,
    times: Array,
    *,
    tol: float | None,
    progress: Progress,
) -> Passage:
    """Return the first passage of ``limit`` from ``start`` by simulation at dt/2 and at dt.

    ``paths`` trajectories are followed until all have failed, or for ``time``, or the cost of
    ``most_steps`` steps each. ``tol``, the relative error wanted of the mean, or ``seconds``: as
    many more as they take. ``longest`` bounds the first.
    """
    require_times(times)
    wanted = tolerance(tol, method.tol)
    modulation, loud = system.modulation, loudest(system)
    reach = reach_of(loud, limit, start, method.time or inf)
    dt, failures = motion_step(method, loud, reach, error=wanted)
    first = first_step(dt, times, reach.start, method.step_factor)
    last = float(np.max(times, initial=0.0))
    longest = horizon(method, dt, last, modulation)
    settled = settled_at(modulation)
    # Under noise that varies none may fail for long, and many later.
    hopeless = method.time or max(longest / HOPELESS, last, min(settled, longest))
    sampled, number, done = Times(*np.zeros((3, 0))), 0, False
    with working(method, system, wanted, start) as (workers, watch, origin):
        rounds = Rounds(method, system, limit, origin, dt, first, longest, hopeless, workers)
        while not done:
            sampled = sampled.joined(rounds.run(number, watch.ends, progress))
            number += 1
            enough = sampled.fine.size >= method.paths
            enough = enough and not not_met(method, wanted, _relative_error(sampled))
            done = enough or watch.ends() or (number + 1) * AT_ONCE > 1 << 24
    failures += interruption(watch)
    return passage_of(
        sampled,
        times,
        limit=str(limit),
        step=first,
        memory=relaxation_time(system),
        tol=inf if wanted is None else wanted,
        settled=settled,
        failures=failures,
        settings={"dt": 0.5 * dt, "coarse dt": dt, "scheme": method.scheme, "seed": method.seed},
    )


def horizon(
    method: MonteCarlo, dt: float, last: float, modulation: Modulation | None = None
) -> float:
    """Return how long a trajectory is followed at most: ``time``, or as ``followed_for`` says."""
    # Two steps of the finer simulation to one, dt, of the coarser.
    return method.time or followed_for(method.most_steps / 3.0 * dt, last, modulation)


@dataclass(frozen=True, eq=False)
class Rounds:
    """Trajectories that are followed together, a round with random numbers of its own.

    Steps grow from ``first`` to ``dt`` as of ``stages``.
    """

    method: MonteCarlo
    system: System
    limit: Limit
    origin: Origin
    dt: float
    first: float
    horizon: float
    hopeless: float
    workers: Workers

    def run(self, number: int, ends: Callable[[], bool], progress: Progress) -> Times:
        """Return the times of up to ``AT_ONCE`` trajectories.

        They are followed until both simulations of each have failed, and end at the ``horizon``,
        at ``hopeless`` if none has failed by then, and after a chunk when ``ends()``; times so cut
        short are marked by ``until``.
        """
        paths = -(-min(self.method.paths, AT_ONCE) // LANES) * LANES
        q, p = self.origin.drawn(paths, number)
        past = beyond(self.system, self.limit, q, p)
        if np.all(past):
            raise InvalidInput("start", str(self.origin.start), f"is beyond the limit {self.limit}")
        energies = energies_of(self.limit, self.system.n)
        seed = (self.method.seed + number * OTHER_SEED) % 2**64
        with left_out():
            pair = [
                Motion(
                    self.system, q, p, dt, seed, energies=energies, halved=halved,
                    workers=self.workers, modulation=self.system.modulation,
                )
                for dt, halved in ((0.5 * self.first, False), (self.first, True))
            ]  # fmt: skip
        stream = np.random.Generator(
            np.random.Philox(key=np.array([seed, number + 2**63], dtype=np.uint64))
        )
        exponential = stream.exponential(size=(paths, max(1, len(energies))))
        chances = [in_blocks(exponential), in_blocks(exponential)]
        found = [in_blocks(np.where(past, 0.0, inf)[:, None]) for _ in pair]
        failed = np.full((2, paths), inf)
        lanes = np.arange(paths)
        until = np.full(paths, self.horizon)
        readers = [reader_of(self.system, self.limit, motion.dt) for motion in pair]
        for dt, chunk in stages(self.first, self.dt, self.horizon, most=CHUNK):
            if dt != pair[1].dt:
                pair = [motion.onward(dt if motion.halved else 0.5 * dt) for motion in pair]
                readers = [reader_of(self.system, self.limit, m.dt, m.begin) for m in pair]
            for motion, read, *arrays in zip(pair, readers, found, chances, strict=True):
                many = chunk if motion.halved else 2 * chunk
                motion.advance(many, read, *arrays, passed=arrays[0])
            now = np.array([times.transpose(0, 2, 1).ravel()[: lanes.size] for times in found])
            failed[:, lanes] = now
            running = np.isinf(now).any(axis=0)
            alive = int(np.count_nonzero(running))
            done = max(1.0 - alive / paths, min(1.0, pair[1].time / self.horizon))
            progress(int(PROGRESS * done), PROGRESS, "first passage")
            hopeless = not np.isfinite(failed).any() and pair[1].time >= self.hopeless
            if not alive or hopeless or ends():
                break
            if 2 * alive <= pair[1].last.shape[0] * LANES and pair[1].last.shape[0] > 1:
                kept = np.flatnonzero(running)
                lanes = lanes[kept]
                for k, motion in enumerate(pair):
                    motion.keep(kept)
                    found[k], chances[k] = gathered(found[k], kept), gathered(chances[k], kept)
        until = np.full(paths, min(self.horizon, pair[1].time))
        # What passes in the part of the last step beyond the horizon counts as not failed.
        failed[failed > until] = inf
        return Times(failed[0], failed[1], until)


def _relative_error(sampled: Times) -> float:
    """About the relative standard error of the mean: times are nearly exponential."""
    return 1.1 / sqrt(max(1, sampled.failed))
