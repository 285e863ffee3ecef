"""First passage in the full system (6): trajectories are followed until they pass the limit."""

from collections.abc import Iterable
from math import ceil, inf, sqrt

import numpy as np

from fpk.arrays import Array
from fpk.certificate import tolerance
from fpk.errors import InvalidInput
from fpk.evolution import Passage, PassageAsked
from fpk.limit import Limit
from fpk.machine import left_out
from fpk.method import Progress
from fpk.modulation import Modulation
from sim.arrays import LANES, MAX_TRAJECTORIES, in_blocks, in_rows
from sim.montecarlo import MonteCarlo
from sim.motion.failure_times import Times
from sim.motion.limits import beyond, energies_of, reach_of
from sim.motion.passing import reader_of
from sim.motion.rounds import both_steps, working
from sim.motion.starts import Origin
from sim.motion.steps import first_step, motion_step, require_times, stages
from sim.motion.survival import followed_for, passage_of, settled_at
from sim.random import OTHER_SEED, stream_of
from sim.reachable import loudest
from sim.relaxation import relaxation_time

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


def passage(method: MonteCarlo, asked: PassageAsked) -> Passage:
    """Return the first passage that is asked for by simulation at dt/2 and at dt.

    ``paths`` trajectories are followed until all have failed, or for ``time``, or the cost of
    ``most_steps`` steps each. ``asked.tol``, the relative error wanted of the mean, or ``seconds``:
    as many more as they take. ``longest`` bounds the first.
    """
    system, limit, start, times = asked.system, asked.limit, asked.start, asked.times
    require_times(times)
    wanted = tolerance(asked.tol, method.tol)
    modulation, loud = system.modulation, loudest(system)
    reach = reach_of(loud, limit, start, method.time or inf)
    dt, failures = motion_step(method, loud, reach, error=wanted)
    first = first_step(dt, times, reach.start, method.step_factor)
    last = float(np.max(times, initial=0.0))
    longest = horizon(method, dt, last, modulation)
    settled = settled_at(modulation)
    # Under noise that varies none may fail for long, and many later.
    hopeless = method.time or max(longest / HOPELESS, last, min(settled, longest))
    rows: list[Array] = []

    def failed(number: int) -> float:
        steps = stages(first, dt, longest, most=CHUNK)
        rows.append(
            followed(origin, limit, paths, number, first, steps, longest, hopeless, asked.progress)
        )
        # About the relative standard error of the mean: times are nearly exponential.
        return 1.1 / sqrt(max(1, Times(*np.hstack(rows)).failed))

    paths = -(-min(method.paths, AT_ONCE) // LANES) * LANES
    with working(method, system, wanted, start) as (_, watch, origin):
        watch.until(failed, least=ceil(method.paths / paths), most=MAX_TRAJECTORIES // AT_ONCE)
        failures += watch.interruption()
    return passage_of(
        Times(*np.hstack(rows)),
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


def followed(
    origin: Origin, limit: Limit, paths: int, number: int, first: float,
    steps: Iterable[tuple[float, int]], horizon: float, hopeless: float, progress: Progress,
) -> Array:  # fmt: skip
    """Return the fields of ``Times`` of ``paths`` trajectories, round ``number`` of random numbers.

    They are followed in ``steps`` (dt, how many), of which the ``first`` is so long, until both
    simulations of each have failed, and end at the ``horizon``, at ``hopeless`` if none has failed
    by then, and after some steps when the watch of the ``origin`` ends it; times so cut short are
    marked by ``until``.
    """
    system = origin.system
    q, p = origin.drawn(paths, number)
    past = beyond(system, limit, q, p)
    if np.all(past):
        raise InvalidInput("start", str(origin.start), f"is beyond the limit {limit}")
    energies = energies_of(limit, system.n)
    seed = (origin.seed + number * OTHER_SEED) % 2**64
    with left_out():
        pair = both_steps(
            system, q, p, first, seed, energies=energies, workers=origin.workers,
            modulation=system.modulation,
        )  # fmt: skip
    exponential = stream_of(seed, number + 2**63).exponential(size=(paths, max(1, len(energies))))
    chances = [in_blocks(exponential), in_blocks(exponential)]
    found = [in_blocks(np.where(past, 0.0, inf)[:, None]) for _ in pair]
    failed = np.full((2, paths), inf)
    lanes = np.arange(paths)
    readers = [reader_of(system, limit, ensemble.dt) for ensemble in pair]
    for dt, chunk in steps:
        if dt != pair[1].dt:
            pair = [ensemble.onward(h) for ensemble, h in zip(pair, (0.5 * dt, dt), strict=True)]
            readers = [reader_of(system, limit, e.dt, e.begin) for e in pair]
        for ensemble, read, many, *arrays in zip(
            pair, readers, (2 * chunk, chunk), found, chances, strict=True
        ):
            ensemble.advance(many, *arrays, read=read, passed=arrays[0])
        now = np.array([in_rows(times)[: lanes.size, 0] for times in found])
        failed[:, lanes] = now
        running = np.isinf(now).any(axis=0)
        alive = int(np.count_nonzero(running))
        done = max(1.0 - alive / paths, min(1.0, pair[1].time / horizon))
        progress(int(PROGRESS * done), PROGRESS, "first passage")
        nothing = not np.isfinite(failed).any() and pair[1].time >= hopeless
        if not alive or nothing or (origin.watch and origin.watch.ends()):
            break
        if 2 * alive <= pair[1].last.shape[0] * LANES and pair[1].last.shape[0] > 1:
            kept = np.flatnonzero(running)
            lanes = lanes[kept]
            for k, ensemble in enumerate(pair):
                ensemble.keep(kept)
                found[k], chances[k] = (in_blocks(in_rows(a)[kept]) for a in (found[k], chances[k]))
    until = np.full(paths, min(horizon, pair[1].time))
    # What passes in the part of the last step beyond the horizon counts as not failed.
    failed[failed > until] = inf
    return np.vstack([failed, until])
