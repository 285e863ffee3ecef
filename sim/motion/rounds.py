"""Trajectories of the stationary state, followed in rounds until their answer is good enough."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.clock import left_out
from fpk.method import Progress
from fpk.system import System
from sim.arrays import LANES
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.motion.motion import Motion, Reader, in_rows
from sim.motion.stationary import interruption, not_met, working
from sim.random import OTHER_SEED

MOST_STEPS, MOST_SAMPLES = 1 << 22, 64
"""Steps of all trajectories, and samples of each, after which the wall time is looked at: some ten
milliseconds, and a tenth of a second where ``MOST_SUMS`` numbers are summed."""

MOST_SUMS = 1 << 23
"""Numbers that the windows of one round hold, 64 MB; of two blocks at the least, for an error."""


@dataclass(frozen=True)
class Window:
    """A number of ``samples`` of every trajectory, and ``read``, which turns a block into numbers.

    ``numbers`` is the shape of what ``read`` fills from the samples of one block.
    """

    samples: int
    numbers: tuple[int, ...]
    read: Reader


def in_rounds(
    method: MonteCarlo,
    system: System,
    wanted: float | None,
    window: Window,
    motions: Sequence[dict[str, Any]],
    estimate: Callable[[list[Array], Array], float],
    *,
    what: str,
    progress: Progress,
) -> tuple[int, list[str]]:
    """Follow trajectories until ``estimate`` is content; return how many, and what went wrong.

    ``motions`` are the settings of simulations with the same random numbers. Raises
    ``InvalidInput`` where the time is over in the first round. Of each round
    ``estimate`` is given the numbers (blocks, …) of each and the mean squares of (q, p) at its end;
    what it returns is the error of all there is, in the unit of the tolerance ``wanted``.
    """
    paths = -(-method.paths // LANES) * LANES
    size = len(motions) * int(np.prod(window.numbers))
    own = max(2, min(paths // LANES, MOST_SUMS // size)) * LANES
    number, error = 0, inf
    with working(method, system, wanted) as (workers, watch, origin):
        while number * own < paths or not_met(method, wanted, error):
            seed = (method.seed + number * OTHER_SEED) % 2**64
            q, p = origin.drawn(own, number)
            with left_out():
                running = [Motion(system, q, p, seed=seed, workers=workers, **m) for m in motions]
            sums = [np.zeros((own // LANES, *window.numbers)) for _ in motions]
            piece = max(1, min(MOST_SAMPLES, MOST_STEPS // (own * running[0].stride)))
            while (done := running[0].samples) < window.samples and not (done and watch.ends()):
                for motion, array in zip(running, sums, strict=True):
                    motion.advance(min(piece, window.samples - done), window.read, array)
            if running[0].samples < window.samples:
                if not number:
                    watch.require(f"the first {own} windows", running[0].samples / window.samples)
                break
            states = in_rows(running[0].last)[:, : 2 * system.n]
            number += 1
            error = estimate(sums, np.mean(states**2, axis=0))
            progress(min(number * own, paths), paths, what)
            if watch.ends():
                break
        failures = interruption(watch)
        if number * own < LEAST_PATHS:
            failures.append(f"it ended after {number * own} trajectories of {LEAST_PATHS}")
    return number * own, failures
