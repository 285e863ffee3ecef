"""Repetitions of splitting on workers, at two steps, until the error is small enough."""

from functools import partial
from math import ceil, inf, isfinite

import numpy as np

from fpk.clock import working_time
from fpk.cores import usable_cores
from fpk.errors import InvalidInput, NotCertified
from fpk.limit import Limit
from fpk.method import Progress, silent
from fpk.modulation import require_constant_noise
from fpk.start import Start
from fpk.system import System
from sim.checkpoint import Checkpoint, checkpoint_of, interruptible
from sim.motion.rounds import Watch
from sim.random import stream_of
from sim.splitting.algorithm import Problem, Repetition, split
from sim.splitting.arrays import LEVELS
from sim.splitting.estimate import Repetitions, estimated
from sim.splitting.full import system_problem
from sim.splitting.score import ScoreFunction
from sim.splitting.settings import (
    LEAST_REPETITIONS,
    NOT_IN_REPETITION,
    RareFailure,
    Splitting,
)
from sim.workers import Workers, workers_of

MOST_STEPS = 2**32
"""Steps of a path at most: a stream has words for 2**40 divided by a few."""


def rare_failure(
    system: System,
    limit: Limit,
    start: Start,
    time: float,
    *,
    score: ScoreFunction | None = None,
    settings: Splitting | None = None,
    progress: Progress = silent,
) -> RareFailure:
    """Return P(T <= ``time``), T the first passage of ``limit`` from ``start`` by Eq. (6).

    ``score`` None: that of the least action of the averaged linear system. Any score gives the same
    mean; a good one, as ln P of an averaged equation is, gives a smaller error. Of |q_i| it takes
    the least potential energy at that displacement. ::

        rare_failure(system, parse_limit("H=4", system.n), REST, 10.0)

    Raises ``InvalidInput`` for a start at or beyond the limit or a time that is not finite and > 0,
    ``NotApplicable`` where no noise acts, ``NotCertified`` where ``seconds`` or Ctrl-C leave too
    few repetitions.
    """
    own = settings or Splitting()
    if not (isfinite(time) and time > 0.0):
        raise InvalidInput("time", time, "must be a finite number > 0")
    require_constant_noise(system.modulation)
    problem = system_problem(system, limit, start, time, dt=own.dt, score=score)
    return failure_of(problem, own, progress)


def repetition(
    problem: Problem, settings: Splitting, fine: int, number: int, left: float = inf
) -> Repetition:
    """Return one repetition at the step dt / 2**``fine``; each has streams of its own.

    It is not finished, its probability not a number, where more than ``left`` seconds are needed.
    """
    begin = working_time()
    stream = stream_of(settings.seed, 2 * number + fine)
    steps, seed = step_count(problem) * 2**fine, int(stream.integers(2**63))
    replicas = problem.replicas(settings.replicas, steps, seed, stream)
    over = lambda: working_time() - begin > left  # noqa: E731
    result = split(replicas, LEVELS, settings.killed, stream, over)
    return result._replace(steps=replicas.moved)


def step_count(problem: Problem) -> int:
    """Return the number of the longer steps in the time."""
    steps = ceil(problem.time / problem.dt * (1.0 - 1e-12))
    if not 1 <= steps <= MOST_STEPS:
        raise InvalidInput("dt", problem.dt, f"makes {steps:g} steps; use at most {MOST_STEPS}")
    return steps


def failure_of(problem: Problem, settings: Splitting, progress: Progress) -> RareFailure:
    """Return the probability of failure in ``problem``; see ``rare_failure``."""
    steps = step_count(problem)
    s = settings
    checkpoint = checkpoint_of(s.checkpoint, (problem, s), "splitting", less=NOT_IN_REPETITION)
    done = Repetitions()
    with (
        workers_of(s.cluster, s.threads or usable_cores()) as workers,
        checkpoint.alone(),
        interruptible(s.partial) as checkpoint.stopped,
    ):
        done.restore(checkpoint.load())
        _repeat(problem, settings, done, workers=workers, checkpoint=checkpoint, progress=progress)
    whole = done.whole
    if whole < LEAST_REPETITIONS:
        raise NotCertified(
            f"{whole} repetitions were finished in {done.seconds:.3g} s, and {LEAST_REPETITIONS}"
            " are needed: allow more seconds or take fewer replicas"
        )
    return estimated(done, whole, dt=0.5 * problem.time / steps, settings=s)


def _repeat(
    problem: Problem,
    settings: Splitting,
    done: Repetitions,
    *,
    workers: Workers,
    checkpoint: Checkpoint,
    progress: Progress,
) -> None:
    """Make rounds of repetitions until the error is reached or the time is over."""
    step = 0.5 * problem.time / step_count(problem)
    begin = working_time() - done.seconds
    watch = Watch(settings.seconds, checkpoint.stopped, settings.tol, begin)

    def repeated(number: int) -> float | None:
        wanted = (number + 1) * settings.repetitions
        done.grow(wanted)
        left = np.argwhere(np.isnan(done.made[0, :, :wanted]).T).tolist()
        for first in range(0, len(left), workers.threads):
            tasks = left[first : first + workers.threads]
            most = settings.seconds - (working_time() - begin)
            calls = [partial(_numbered, problem, settings, most, *task) for task in tasks]
            for repetition, fine, result in workers.as_finished(calls):
                done.made[:, fine, repetition] = result
                done.seconds = working_time() - begin
                checkpoint.save(done)
            progress(done.whole, wanted, "splitting")
            if watch.ends():
                return None
        return estimated(done, wanted, dt=step, settings=settings).relative_error

    watch.until(repeated, most=1 if settings.tol is None else inf)


def _numbered(
    problem: Problem, settings: Splitting, left: float, number: int, fine: int
) -> tuple[int, int, Repetition]:
    return number, fine, repetition(problem, settings, fine, number, left)
