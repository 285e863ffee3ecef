"""Transient densities of the full system (6): an ensemble from the start, at given times."""

from collections.abc import Iterator
from functools import partial
from math import ceil, inf

import numpy as np

from fpk.arrays import Array
from fpk.certificate import tolerance
from fpk.clock import left_out
from fpk.effects import effects_of
from fpk.evolution import Transient
from fpk.method import Progress
from fpk.observable import Observable
from fpk.start import Start
from fpk.system import System
from sim.arrays import LANES, MAX_TRAJECTORIES, in_rows
from sim.ensemble import ensemble_from
from sim.histogram import axis_of, values_of
from sim.montecarlo import MonteCarlo
from sim.motion.densities import Counted, answer_of
from sim.motion.limits import Reach, largest_energy, temperature_reached
from sim.motion.rounds import working
from sim.motion.starts import Origin
from sim.motion.steps import motion_step, needs_steps, require_times
from sim.random import OTHER_SEED
from sim.reachable import loudest
from sim.step_size import REACHED

ROUNDS = 8
"""Rounds of ``paths`` trajectories where neither an error nor a time is wanted."""

CHUNK = 512
"""Steps at most from one sample to the next, so that Ctrl-C comes through."""


def transient(
    method: MonteCarlo,
    system: System,
    observable: Observable,
    start: Start,
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float | None,
    progress: Progress,
) -> Transient:
    """Return the densities of ``observable`` at ``times`` with one standard error.

    In the error is, in quadrature, what changes at the step dt instead of dt/2, by the same random
    numbers. ``tol`` is the expected L1 error wanted at every time.
    """
    require_times(times)
    wanted = tolerance(tol, method.tol)
    loud = loudest(system)
    kT = temperature_reached(loud, start, float(np.max(times)))
    reach = Reach(kT, largest_energy(system, start) + REACHED * kT)
    dt, failures = motion_step(method, loud, reach, error=wanted)
    mirror = effects_of(system).mirror and (start.kind != "state" or start.rest)
    paths = -(-method.paths // LANES) * LANES

    def read(states: Array) -> list[Array]:
        q, p = np.split(states, 2, axis=1)
        return [values_of(system, c, q, p) for c in observable]

    axis = partial(axis_of, system)
    histograms = Counted(observable, len(times), read, axis, mirror=mirror)

    def counted(number: int) -> float:
        rows = ensembles(origin, times, paths, number, dt)
        for k, (fine, coarse) in enumerate(rows):
            histograms.add(k, times[k], fine, coarse)
            done = ROUNDS * len(times)
            progress(min(done, number * len(times) + k + 1), done, "transient")
        return inf if wanted is None else histograms.error

    with working(method, system, wanted, start) as (_, watch, origin):
        least = ROUNDS if wanted is None else 1
        watch.until(counted, least=least, most=MAX_TRAJECTORIES // paths)
        failures += watch.interruption()
    return answer_of(
        histograms,
        times,
        at,
        dt,
        settings={"seed": method.seed, "scheme": method.scheme},
        failures=failures,
        tol=inf if wanted is None else wanted,
    )


def ensembles(
    origin: Origin, times: Array, paths: int, number: int, dt: float
) -> Iterator[tuple[Array, Array | None]]:
    """Yield the states (paths, 2n) at each time, at steps of dt/2 and of ``dt``.

    The second is None where the step has no error: it is then as long as the time. Where the watch
    of the origin ends it there are no more; in the first round it raises ``InvalidInput``.
    """
    system, seed = origin.system, (origin.seed + number * OTHER_SEED) % 2**64
    stepped = needs_steps(system) or system.modulation is not None
    q, p = origin.drawn(paths, number)
    states = [np.hstack([q, p]) for _ in range(2 if stepped else 1)]
    words, now = [0, 0], 0.0
    for time in times:
        if time > now:
            steps = ceil((time - now) / dt) if stepped else 1
            parts = ceil(steps / CHUNK)
            stride = ceil(steps / parts)
            long = (time - now) / (parts * stride)
            for k, many in enumerate((2, 1) if stepped else (1,)):
                q, p = np.split(states[k], 2, axis=1)
                with left_out():
                    ensemble = ensemble_from(
                        system, q, p, long / many, seed, halved=k == 1, word=words[k],
                        workers=origin.workers, modulation=system.modulation, begin=now,
                    )  # fmt: skip
                for done in range(parts):
                    ensemble.advance(stride * many, stride=stride * many)
                    if origin.watch and origin.watch.ends():
                        if number:  # what there is will do
                            return
                        share = (now + (time - now) * (done + 1) / parts) / times[-1]
                        origin.watch.require("the first round", share)
                states[k] = in_rows(ensemble.last)[:, : 2 * system.n]
                words[k] = ensemble.next_word
        now = float(time)
        yield states[0], states[1] if stepped else None
