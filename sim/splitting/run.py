"""Repetitions of splitting on workers, at two steps, until the error is small enough."""

from dataclasses import asdict, dataclass, field
from functools import partial
from math import ceil, exp, hypot, inf, isfinite, log
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from fpk.arrays import Array
from fpk.errors import InvalidInput, NotCertified
from fpk.limit import Limit
from fpk.machine import usable_cores, working_time
from fpk.method import Progress, silent
from fpk.modulation import require_constant_noise
from fpk.start import Start
from fpk.system import System
from sim.checkpoint import checkpoint_of, interruptible
from sim.motion.rounds import Watch
from sim.random import stream_of
from sim.splitting.algorithm import Problem, Repetition, split
from sim.splitting.arrays import LEVELS
from sim.splitting.full import system_problem
from sim.splitting.score import ScoreFunction
from sim.splitting.settings import (
    LEAST_REPETITIONS,
    NOT_IN_REPETITION,
    RareFailure,
    Splitting,
)
from sim.workers import workers_of

MOST_STEPS = 2**32
"""Steps of a path at most: a stream has words for 2**40 divided by a few."""

DOUBT = 0.05
"""Probability with which the upper bound may be too low."""

DEVIATIONS = 1.645
"""Standard deviations that a normal variable exceeds with that probability."""

RESOLVED = 0.3
"""Relative standard error up to which the spread of a few repetitions tells it."""

LARGEST_SPREAD = 500.0
"""Variance of ln P at most from which an error is made, so that it stays a number."""


@dataclass(eq=False)
class Repetitions:
    """The fields of repetitions at dt and dt/2, (fields, 2, made); NaN where one is not finished.

    ``saved`` and ``restore`` are what a checkpoint needs.
    """

    made: Array = field(default_factory=lambda: np.zeros((len(Repetition._fields), 2, 0)))
    seconds: float = 0.0

    def grow(self, count: int) -> None:
        """Make room for ``count`` repetitions at each step."""
        missing = (0, 0), (0, 0), (0, max(0, count - self.made.shape[2]))
        self.made = np.pad(self.made, missing, constant_values=np.nan)

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return everything, as arrays."""
        return {"made": self.made, "seconds": np.array(self.seconds)}

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """Go on from what ``saved`` returned, from the beginning if that is nothing."""
        if saved:
            self.made, self.seconds = saved["made"], float(saved["seconds"])

    @property
    def whole(self) -> int:
        """How many of the first repetitions are finished at both steps."""
        missing = np.isnan(self.made[0]).any(axis=0)
        return int(np.argmax(missing)) if missing.any() else missing.size


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
    dt, s = 0.5 * problem.time / step_count(problem), settings
    checkpoint = checkpoint_of(s.checkpoint, (problem, s), "splitting", less=NOT_IN_REPETITION)
    done = Repetitions()

    def repeated(number: int) -> float | None:
        wanted = (number + 1) * s.repetitions
        done.grow(wanted)
        left = np.argwhere(np.isnan(done.made[0, :, :wanted]).T).tolist()
        for first in range(0, len(left), workers.threads):
            tasks = left[first : first + workers.threads]
            most = s.seconds - (working_time() - watch.begin)
            calls = [partial(_numbered, problem, s, most, *task) for task in tasks]
            for index, fine, result in workers.as_finished(calls):
                done.made[:, fine, index] = result
                done.seconds = working_time() - watch.begin
                checkpoint.save(done)
            progress(done.whole, wanted, "splitting")
            if watch.ends():
                return None
        return estimated(done, wanted, dt=dt, settings=s).relative_error

    with (
        workers_of(s.cluster, s.threads or usable_cores()) as workers,
        checkpoint.alone(),
        interruptible(s.partial) as checkpoint.stopped,
    ):
        done.restore(checkpoint.load())
        watch = Watch(s.seconds, checkpoint.stopped, s.tol, working_time() - done.seconds)
        watch.until(repeated, most=1 if s.tol is None else inf)
    whole = done.whole
    if whole < LEAST_REPETITIONS:
        raise NotCertified(
            f"{whole} repetitions were finished in {done.seconds:.3g} s, and {LEAST_REPETITIONS}"
            " are needed: allow more seconds or take fewer replicas"
        )
    return estimated(done, whole, dt=dt, settings=s)


def _numbered(
    problem: Problem, settings: Splitting, left: float, number: int, fine: int
) -> tuple[int, int, Repetition]:
    return number, fine, repetition(problem, settings, fine, number, left)


def mean_and_error(log_values: Array) -> tuple[float, float]:
    """Return the mean of exp(``log_values``) (repetitions,) and its standard error.

    Estimates of splitting are nearly log-normal. Of few with a large spread the largest ones are
    missing, and mean and deviation are both too small: the error is that by the variance s² of the
    logarithms, with a share e of zeros ``mean √((e^{s²}/(1 − e) − 1)/count)``, where it is the
    larger one; and inf where it exceeds ``RESOLVED``, as the mean may then be off by decades.
    """
    values = np.exp(log_values)
    mean, error = float(values.mean()), float(values.std(ddof=1))
    positive = log_values[np.isfinite(log_values)]
    if positive.size == 0:
        return 0.0, 0.0
    spread = float(positive.var(ddof=1)) if positive.size > 1 else LARGEST_SPREAD
    square = np.exp(min(spread, LARGEST_SPREAD)) * values.size / positive.size - 1.0
    error = max(error, mean * float(np.sqrt(square))) / float(np.sqrt(values.size))
    return mean, error if error <= RESOLVED * mean else inf


def estimated(done: Repetitions, count: int, *, dt: float, settings: Splitting) -> RareFailure:
    """Return the probability from the first ``count`` repetitions, ``dt`` being the shorter step.

    The bias at dt/2 is at most the difference from dt where it falls as dt or faster. A difference
    below its own standard error counts as that: it may be small by chance.
    """
    (coarse, fine), levels, failures, _ = done.made[:, :, :count]
    unit = float(np.max([coarse, fine]))
    unit = unit if np.isfinite(unit) else 0.0
    (at_long, long_error), (mean, own) = (mean_and_error(x - unit) for x in (coarse, fine))
    own = own or mean / (settings.replicas * count)  # as if one of all paths had not failed
    bias, scale = at_long - mean, exp(unit)
    bias_error = hypot(own, long_error)
    error = hypot(own, max(abs(bias), bias_error))
    bound = (mean + DEVIATIONS * error) * scale
    if not mean > 0.0 or error == inf:
        failed, paths = float(failures[1].sum()), settings.replicas * count
        bound = float(betaincinv(failed + 1.0, paths - failed, 1.0 - DOUBT))  # Clopper, Pearson
    return RareFailure(
        probability=mean * scale,
        error=error * scale if mean > 0.0 else bound,
        upper_bound=bound,
        log_probability=log(mean) + unit if mean > 0.0 else -inf,
        sampling_error=own * scale,
        bias=bias * scale,
        bias_error=bias_error * scale,
        values=np.exp(fine),
        extinct=int(np.sum(~np.isfinite(fine))),
        levels=float(levels[1].mean()),
        dt=dt,
        steps=int(np.nansum(done.made[3])),
        seconds=done.seconds,
        settings={k: v for k, v in asdict(settings).items() if isinstance(v, (int, float, str))},
    )
