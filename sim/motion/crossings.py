"""Upcrossing rates of the full system (6) by simulation, counted between the steps too."""

from functools import partial
from math import ceil, inf, pi

import numpy as np

from fpk.arrays import Array
from fpk.dynamics import Curve, Question
from sim.arrays import LANES, in_rows
from sim.diagnostics import drift_limit, drifts
from sim.montecarlo import MonteCarlo
from sim.motion.passing import count_upcrossings
from sim.motion.rounds import both_steps, error_of, sampled_curve, working
from sim.motion.steps import motion_step
from sim.relaxation import relaxation_time

RELAXATIONS = 20.0
"""Relaxation times for which crossings are counted unless a time is given."""

CHUNKS, AT_ONCE = 20, 256
"""Parts of the time, compared to see a drift, and steps after which Ctrl-C is heard."""


def crossings(method: MonteCarlo, asked: Question) -> Curve:
    """Return the upcrossings per unit time of the levels ``at`` by q of mass ``row``, counted.

    Crossings that the noise makes within a step are not seen: a share of all that falls as the
    step. Returned is the rate extrapolated from dt and dt/2 by the same random numbers, twice that
    at dt/2 less that at dt; whole in its error, beside that of sampling by independent blocks of
    trajectories, is what the extrapolation changes. Where hardly anything crosses, a rate may be
    negative within its error. ``time`` of each trajectory (``RELAXATIONS`` relaxation times where
    none is given) is followed by more until ``tol`` is met or ``seconds`` have passed.
    """
    system, row, at, progress = asked.system, asked.row, asked.at, asked.progress
    wanted = method.tol if asked.tol is None else asked.tol
    dt, too_long = motion_step(method, system, error=wanted)
    paths = -(-method.paths // LANES) * LANES
    order = np.argsort(at, kind="stable")
    steps = ceil((method.time or RELAXATIONS * relaxation_time(system)) / dt)
    mass = float(system.mass[row])
    read = partial(
        count_upcrossings, row=row, momentum=system.n + row, inverse_mass=1.0 / mass,
        levels=at[order],
    )  # fmt: skip
    ends: list[Array] = []
    times: list[float] = []
    squares: list[Array] = []
    scale, rates, at_half = inf, np.zeros(0), np.zeros(0)

    def counted(number: int) -> float | None:
        nonlocal scale, rates, at_half
        chunk = max(1, steps * (number + 1) // CHUNKS - steps * number // CHUNKS)
        for begun in range(0, chunk, AT_ONCE):
            piece = min(AT_ONCE, chunk - begun)
            for ensemble, own, many in zip(pair, counts, (2 * piece, piece), strict=True):
                ensemble.advance(many, own, read=partial(read, dt=ensemble.dt))
            if watch.ends():
                break
        else:
            ends.append(np.cumsum(counts[0], axis=1)[:, :-1].astype(float))
            times.append(pair[0].time)
        states = in_rows(pair[0].last)
        squares.append(np.mean(states[:, [row, system.n + row]] ** 2, axis=0))
        size = np.sqrt(np.mean(squares, axis=0))
        scale = float(size[1] / mass / (2.0 * pi * size[0])) if size[0] > 0 else 1.0
        # Upcrossings per unit time of each block, (blocks, levels).
        time = LANES * pair[0].time
        at_half, at_whole = (np.cumsum(own, axis=1)[:, :-1] / time for own in counts)
        rates = 2.0 * at_half - at_whole
        progress(min(len(ends), CHUNKS), CHUNKS, "crossings")
        return float(np.max(error_of(rates))) / scale if len(ends) > number else None

    with working(method, system, wanted) as (workers, watch, origin):
        q, p = origin.drawn(paths, 0)
        pair = both_steps(system, q, p, dt, method.seed, workers=workers)
        counts = [np.zeros((paths // LANES, at.size + 1), dtype=np.int64) for _ in pair]
        done = watch.until(counted, least=CHUNKS)
        failures = [] if done or method.seconds else ["it was ended before all chunks were done"]
        failures += watch.interruption()
    failures += too_long + _drifting(ends, times)
    total = paths * pair[0].time
    bias = (rates - at_half).mean(axis=0)
    errors, values = np.zeros(at.size), np.zeros(at.size)
    values[order] = rates.mean(axis=0)
    errors[order] = np.sqrt(error_of(rates) ** 2 + bias**2 + total**-2.0)
    settings: dict[str, str | float | int] = {
        "dt": 0.5 * dt,
        "coarse dt": dt,
        "paths": paths,
        "time": pair[0].time,
        "seed": method.seed,
        "largest step bias": float(np.max(np.abs(bias))),
    }
    return sampled_curve(values, errors, scale, wanted, failures, settings)


def _drifting(ends: list[Array], times: list[float]) -> list[str]:
    """Words for crossings whose first part differs from the rest, none where chance explains it.

    ``ends`` are the counts (blocks, levels) until the ``times`` at which chunks end.
    """
    if len(ends) < 2:
        return ["it ended in its first chunk, where no drift shows; give it more time"]
    counts = np.diff(np.array(ends), axis=0, prepend=0.0).transpose(2, 1, 0)
    means = counts / np.diff(times, prepend=0.0)
    z, limit = np.abs(drifts(means)), drift_limit(means.shape[1], 2 * means.shape[0])
    if np.max(z) <= limit:
        return []
    words = f"by {np.max(z):.1f} standard errors (chance explains {limit:.1f})"
    return [f"the rates drift {words}; use a longer burn_in"]
