"""First passage by simulation: trajectories of any model are followed until they pass the limit."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from math import ceil, inf, sqrt
from typing import Any

import numpy as np

from fpk.answer.certificate import tolerance
from fpk.answer.evolution import Passage
from fpk.answer.question import Asked, Progress
from fpk.numeric.arrays import Array, Flags
from fpk.numeric.errors import InvalidInput
from fpk.numeric.machine import left_out
from fpk.system.modulation import Modulation
from sim.questions import limits
from sim.questions.failure_times import passage_of, settled_at
from sim.questions.passing import reader_of
from sim.questions.rounds import Watch, seed_of, working
from sim.sample.ensemble import Reader, ensemble_from
from sim.sample.settings import Settings
from sim.step.arrays import LANES, MAX_TRAJECTORIES, in_blocks, in_rows
from sim.step.random import stream_of
from sim.step.step_size import loudest, relaxation_time

AT_ONCE = 32768
"""Trajectories that run together: a chunk of them takes less than a second."""

HOPELESS = 8.0
"""A simulation ends in which nothing has failed in one over this of its time, where no time was
asked for: in the rest some 8 · 3 failures at most (95 %) are to be expected, too few to go on from.
"""

Run = tuple[Any, int, Callable[[float, float], Reader], tuple[int, ...]]
"""An ensemble, its steps in one of the coarser simulation, its reader by the step and the time at
which that begins, and which failure times it writes: 0 of the finer simulation, 1 of the coarser.
"""


def passage(method: Settings, asked: Asked) -> Passage:
    """Return the first passage that is asked for by simulation at dt/2 and at dt.

    ``paths`` trajectories are followed until all have failed, or for ``time``, or the cost of
    ``most_steps`` steps each. ``asked.tol``, the relative error wanted of the mean, or ``seconds``:
    as many more as they take. ``longest`` bounds the first.
    """
    system, limit, start, times = asked.system, asked.limit, asked.start, asked.times
    limits.require_times(times)
    wanted = tolerance(asked.tol, method.tol)
    modulation, loud = system.modulation, loudest(system)
    reach = limits.reach_of(loud, limit, start, method.time or inf)
    dt, failures = limits.motion_step(method, loud, reach, error=wanted)
    first = limits.first_step(dt, times, reach.start, method.step_factor)
    last = float(np.max(times, initial=0.0))
    longest = horizon(method, dt, last, modulation)
    # Under noise that varies none may fail for long, and many later.
    hopeless = method.time or max(longest / HOPELESS, last, min(settled_at(modulation), longest))
    paths = -(-min(method.paths, AT_ONCE) // LANES) * LANES
    energies = limits.energies_of(limit, system.n)

    def begun(number: int) -> tuple[list[Run], Flags, Array]:
        q, p = origin(paths, number)
        past = limits.beyond(system, limit, q, p)
        if np.all(past):
            raise InvalidInput("start", str(start), f"is beyond the limit {limit}")
        seed, read = seed_of(method.seed, number), partial(reader_of, system, limit)
        known: Any = {"energies": energies, "workers": workers, "modulation": modulation}
        with left_out():  # by the same random numbers
            both = (0.5 * first, False), (first, True)
            pair = [ensemble_from(system, q, p, h, seed, halved=x, **known) for h, x in both]
        chance = stream_of(seed, number + 2**63).exponential(size=(paths, max(1, len(energies))))
        return [(e, 2 - k, read, (k,)) for k, e in enumerate(pair)], past, chance

    with working(method, system, wanted, start) as (workers, watch, origin):
        rounds = ceil(method.paths / paths), MAX_TRAJECTORIES // AT_ONCE
        steps = first, dt, limits.CHUNK, longest, hopeless
        settings = {"scheme": method.scheme, "seed": method.seed}
        memory = relaxation_time(system)
        return passage_in_rounds(asked, watch, rounds, begun, steps, memory, settings, failures)


def horizon(
    method: Settings, dt: float, last: float, modulation: Modulation | None = None
) -> float:
    """Return how long a trajectory is followed at most: ``time``, or as ``followed_for`` says."""
    # Two steps of the finer simulation to one, dt, of the coarser.
    return method.time or followed_for(method.most_steps / 3.0 * dt, last, modulation)


def followed_for(most: float, last: float, modulation: Modulation | None) -> float:
    """Return how long paths are followed: ``most``, but to the ``last`` time asked for at least.

    No longer than that after the end of a noise that ends with 0: motion then only decays.
    """
    if modulation is not None and not modulation.last:
        most = min(most, float(modulation.times[-1]))
    return max(most, last)


def passage_in_rounds(
    asked: Asked,
    watch: Watch,
    rounds: tuple[int, float],
    begun: Callable[[int], tuple[list[Run], Flags, Array]],
    steps: tuple[float, float, int, float, float],
    memory: float,
    settings: Mapping[str, Any],
    failures: Sequence[str] = (),
) -> Passage:
    """Return the first passage of trajectories in ``rounds``, so many at least and at most.

    ``begun(number)`` returns the runs of a round, which of its trajectories are past the limit at
    time 0, and exponential numbers for ``followed``. ``steps`` are the first and the longest of the
    coarser simulation, how many are made at once, the horizon, and ``hopeless`` of ``followed``;
    the rest as of ``passage_of``.
    """
    (first, dt, chunk, longest, hopeless), rows = steps, list[Array]()

    def failed(number: int) -> float:
        (runs, past, chance), ends = begun(number), (longest, hopeless)
        stages = limits.stages(first, dt, longest, most=chunk)
        rows.append(followed(runs, past, chance, stages, ends, watch.ends, asked.progress))
        # About the relative standard error of the mean: times are nearly exponential.
        return 1.1 / sqrt(max(1, sum(np.count_nonzero(fine < inf) for fine, _, _ in rows)))

    watch.until(failed, least=rounds[0], most=rounds[1])
    settings = {"dt": 0.5 * dt, "coarse dt": dt, **settings}
    failures = [*failures, *watch.interruption()]
    return passage_of(np.hstack(rows), asked, watch.tol, first, memory, settings, failures)


def followed(
    runs: list[Run],
    past: Flags,
    chance: Array,
    steps: Iterable[tuple[float, int]],
    last: tuple[float, float],
    ends: Callable[[], bool],
    progress: Progress,
) -> Array:
    """Return when trajectories failed, and until when each was followed, (3, paths).

    They are simulated by ``runs``, some ``past`` (paths,) the limit from time 0, with exponential
    numbers for the readers, ``chance`` (paths, limits), in ``steps`` (dt, how many) until they have
    failed at half the step and at the step, the first two rows; inf where a trajectory lived until
    the time in the last row. That is the first ``last`` one, the second if none has failed by then,
    or after some steps when it ``ends()``.
    """
    paths, lanes, (longest, hopeless) = past.size, np.arange(past.size), last
    chances = [in_blocks(chance) for _ in range(2)]
    found = [in_blocks(np.where(past, 0.0, inf)[:, None]) for _ in range(2)]
    failed, readers = np.full((2, paths), inf), list[Reader]()
    for dt, chunk in steps:
        if not readers or dt / runs[-1][1] != runs[-1][0].dt:
            if readers:
                runs = [(e.onward(dt / many), many, make, k) for e, many, make, k in runs]
            readers = [make(ensemble.dt, ensemble.begin) for ensemble, _, make, _ in runs]
        for (ensemble, many, _, which), read in zip(runs, readers, strict=True):
            arrays = [a[k] for k in which for a in (found, chances)]
            ensemble.advance(many * chunk, *arrays, read=read, passed=arrays[0])
        now = np.array([in_rows(times)[: lanes.size, 0] for times in found])
        failed[:, lanes] = now
        running = np.isinf(now).any(axis=0)
        alive, time = int(np.count_nonzero(running)), runs[-1][0].time
        progress(
            int(1000 * max(1.0 - alive / paths, min(1.0, time / longest))), 1000, "first passage"
        )
        nothing = not np.isfinite(failed).any() and time >= hopeless
        if not alive or nothing or ends():
            break
        if 2 * alive <= len(found[0]) * LANES and len(found[0]) > 1:
            kept = np.flatnonzero(running)
            lanes = lanes[kept]
            for ensemble, *_ in runs:
                ensemble.keep(kept)
            found, chances = ([in_blocks(in_rows(a)[kept]) for a in x] for x in (found, chances))
    until = np.full(paths, min(longest, time))
    # What passes in the part of the last step beyond the horizon counts as not failed.
    failed[failed > until] = inf
    return np.vstack([failed, until])
