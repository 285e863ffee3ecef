"""Adaptive multilevel splitting of paths, in repetitions at two steps until the error is small.

Cerou and Guyader, Stoch. Anal. Appl. 25, 2007, 417, in the unbiased form of Brehier, Gazeau,
Goudenege, Lelievre and Rousset, Ann. Appl. Probab. 26, 2016, 3559: at each level Z all replicas
whose score has not exceeded Z are killed, ties included, and their share counts. Each is replaced
by a copy of a survivor up to the first time at which its score exceeds Z, and by new noise from
there. For a Markov chain in discrete time and any score the probability has the mean P exactly.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from math import ceil, exp, hypot, inf, isfinite, log, nan
from pathlib import Path
from typing import Any

import numpy as np

from fpk.answer.method import Progress, silent
from fpk.answer.names import Limit, Start
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.numeric.machine import usable_cores, working_time
from fpk.system.modulation import require_constant_noise
from fpk.system.system import System
from sim.questions import limits
from sim.questions.passage import most_events
from sim.questions.rounds import Watch, drawn_states
from sim.questions.splitting import kernel
from sim.questions.splitting.kernel import LEVELS, SHARES, ScoreFunction, SystemProblem
from sim.sample.settings import check_settings
from sim.sample.workers import checkpoint_of, interruptible, workers_of
from sim.step.random import stream_of
from sim.step.step_size import chosen_step, temperature

LEAST_REPETITIONS = 8
"""Repetitions below which their spread says too little of the error."""

NOT_IN_REPETITION = {
    "Splitting.threads": "the random numbers belong to a repetition",
    "Splitting.cluster": "wherever it is made",
    "Splitting.checkpoint": "it says where the repetitions are stored",
    "Splitting.partial": "it says what Ctrl-C does, after which one goes on",
    "Splitting.repetitions": "it says how many are made, each of which is numbered",
    "Splitting.tol": "so does this",
    "Splitting.seconds": "and this",
}
"""Fields on which a finished repetition does not depend."""

MOST_STEPS = 2**32
"""Steps of a path at most: a stream has words for 2**40 divided by a few."""

RESOLVED = 0.3
"""Relative standard error up to which the spread of a few repetitions tells it."""


@dataclass(frozen=True)
class Splitting:
    """How rare failure is sampled; times in the unit of time of the system, but for ``seconds``.

    A repetition has so many ``replicas``, of which each level kills ``killed`` at least.
    ``repetitions`` are made at the step dt and as many at dt/2, then as many again until the
    relative error is ``tol`` or ``seconds`` of wall time have passed; without ``tol`` no more are
    made. ``dt`` None: that of the system. ``threads``, ``cluster``, ``checkpoint`` and ``partial``
    as of ``MonteCarlo``: the numbers depend on none of them.

    A small one::

        Splitting(replicas=64, repetitions=8, seed=1)

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    replicas: int = 512
    killed: int = 32
    repetitions: int = 16
    seed: int = 1
    dt: float | None = None
    tol: float | None = None
    seconds: float = 60.0
    threads: int | None = None
    cluster: str | None = None
    checkpoint: Path | None = None
    partial: bool = False

    def __post_init__(self) -> None:
        """Check every field."""
        replicas = "replicas", 2, 8190  # a seed has words for 2**24 pieces of paths
        others = ("killed", 1, self.replicas - 1), ("repetitions", LEAST_REPETITIONS, 2**20)
        check_settings(self, ("dt", "tol", "seconds"), replicas, *others)


@dataclass(frozen=True)
class RareFailure:
    """The probability that a limit is passed before a time, and how well it is known.

    ``probability`` is the mean of ``values`` (repetitions,) at the step ``dt``; ``error`` is one
    standard error of it and the difference ``bias`` of the mean at 2 dt from it, or the standard
    error of that if it is larger, added in squares. It is inf where the repetitions are so
    scattered that their mean may be off by more than they show: take more replicas.
    ``upper_bound`` holds with 95 % confidence. Where the error is inf it is that of the paths from
    the start alone; so it is where no replica has failed: the probability is then given as 0, with
    that bound as its error. ``extinct`` repetitions had no replica left. ``log_probability`` is
    right where the probability is too small to be a number. ::

        settings = Splitting(replicas=64, repetitions=8, seed=1)
        rare = rare_failure(system, parse_limit("H=2", 2), REST, 5.0, settings=settings)
        rare.probability, rare.error, rare.upper_bound
    """

    probability: float
    error: float
    upper_bound: float
    log_probability: float
    sampling_error: float  # one standard error
    bias: float
    bias_error: float  # one standard error
    values: Array
    extinct: int
    levels: float  # mean number of levels
    dt: float
    steps: int  # all that were simulated
    seconds: float  # their wall time
    settings: Mapping[str, str | float | int] = field(default_factory=dict)

    @property
    def relative_error(self) -> float:
        """The error in units of the probability; inf where that is 0."""
        return self.error / self.probability if self.probability > 0.0 else inf


def split(
    replicas: Any, failure: int, killed: int, stream: np.random.Generator, until: float = inf
) -> tuple[float, int, int]:
    """Return ln of the estimated probability that a path's score reaches ``failure``, and levels.

    Third come the replicas that failed before any was killed. ``replicas`` are as
    ``CompiledReplicas``; each level kills ``killed`` of them at least, and ties. The logarithm is
    −inf where no replica is left, not a number where it takes beyond the working time ``until``.
    """
    log_probability, levels = 0.0, 0
    failed = int(np.sum(replicas.best >= failure))
    while working_time() <= until:
        best = replicas.best
        level = int(np.partition(best, killed - 1)[killed - 1])
        if level >= failure:
            return log_probability + log(np.mean(best >= failure)), levels, failed
        dead, alive = np.flatnonzero(best <= level), np.flatnonzero(best > level)
        if alive.size == 0:
            return -inf, levels, failed
        log_probability += log(alive.size / best.size)
        replicas.renew(dead, alive[stream.integers(alive.size, size=dead.size)], level)
        levels += 1
    return nan, levels, failed


def system_problem(
    system: System,
    limit: Limit,
    start: Start,
    time: float,
    *,
    dt: float | None,
    score: ScoreFunction | None,
) -> SystemProblem:
    """Return the problem with its step, chosen as in a plain simulation, and its score.

    Raises as ``rare_failure``, and ``InvalidInput`` for a ``dt`` that is ``limits.TOO_LONG``.
    """
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: whether the limit is passed is no chance")
    # A share of a random start may have failed at once.
    states = () if start.kind == "noise" else drawn_states(system, start, 0, 64)
    if states and np.all(limits.beyond(system, limit, *states)):
        raise InvalidInput("start", str(start), f"must lie below the limit {limit}")
    # By default the score of least action of each coordinate.
    tops = limits.energies_at(system, limit)
    if limit.kind == "modal":
        noise = limits.modal_rates(system, limit, system.noise_matrix)
        decay = limits.modal_rates(system, limit, system.damping)
    else:
        tops, kT = np.min(tops, keepdims=True), temperature(system)
        noise = np.mean(np.diag(system.noise_matrix) / system.mass, keepdims=True)
        decay = noise / kT if isfinite(kT) else np.zeros(1)
    scores: list[ScoreFunction] = [
        partial(kernel.least_action, limit=energy, noise=float(D), decay=float(c))
        for energy, D, c in zip(tops, noise, decay, strict=True)
    ]
    if score is not None:
        if len(scores) > 1:
            raise InvalidInput("score", score, "must be left out where there are several limits")
        scores = [score]
    tables = kernel.score_tables(scores, [top * SHARES**2 for top in tops], time)
    reach = limits.reach_of(system, limit, start, time)
    soon = min(reach.limit, reach.start) if start.kind == "state" else reach.limit
    longest = chosen_step(system, energy=reach.energy, kT=reach.kT)
    longest = min(longest, limits.STEP_TO_LIMIT * soon, time / limits.STEPS_SINCE_START)
    if dt is not None and dt > limits.TOO_LONG * longest:
        raise InvalidInput("dt", dt, f"is too long to see a passage; use {longest:.2g}")
    return SystemProblem(system, limit, start, time, dt or longest, tables)


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
    problem: Any, settings: Splitting, left: float, number: int, fine: int
) -> tuple[int, int, tuple[float, ...]]:
    """Return one repetition at the step dt / 2**``fine``: its ``number``, ``fine``, its result.

    That is the result of ``split``, within ``left`` seconds, and the steps made, with streams of
    its own. ``problem`` is a dataclass as ``SystemProblem``.
    """
    until, stream = working_time() + left, stream_of(settings.seed, 2 * number + fine)
    steps, seed = step_count(problem) * 2**fine, int(stream.integers(2**63))
    replicas = problem.replicas(settings.replicas, steps, seed, stream)
    result = split(replicas, LEVELS, settings.killed, stream, until)
    return number, fine, (*result, int(replicas.paths.moved.sum()))


def step_count(problem: Any) -> int:
    """Return the number of the longer steps in the time."""
    steps: int = ceil(problem.time / problem.dt * (1.0 - 1e-12))
    if not 1 <= steps <= MOST_STEPS:
        raise InvalidInput("dt", problem.dt, f"makes {steps:g} steps; use at most {MOST_STEPS}")
    return steps


def failure_of(problem: Any, settings: Splitting, progress: Progress) -> RareFailure:
    """Return the probability of failure in ``problem``; see ``rare_failure``."""
    dt, s = 0.5 * problem.time / step_count(problem), settings
    checkpoint = checkpoint_of(s.checkpoint, (problem, s), "splitting", less=NOT_IN_REPETITION)
    # The numbers of repetitions at dt and dt/2, (numbers, 2, made); NaN where one is not finished.
    made, seconds = np.zeros((4, 2, 0)), 0.0

    def repeated(number: int) -> float | None:
        nonlocal made, seconds
        wanted = (number + 1) * s.repetitions
        missing = (0, 0), (0, 0), (0, max(0, wanted - made.shape[2]))
        made = np.pad(made, missing, constant_values=nan)
        left = np.argwhere(np.isnan(made[0, :, :wanted]).T).tolist()
        for first in range(0, len(left), workers.threads):
            most = s.seconds - (working_time() - watch.begin)
            tasks = left[first : first + workers.threads]
            calls = [partial(repetition, problem, s, most, *task) for task in tasks]
            for index, fine, result in workers.as_finished(calls):
                made[:, fine, index] = result
                seconds = working_time() - watch.begin
                checkpoint.save({"made": made, "seconds": np.array(seconds)})
            progress(finished(), wanted, "splitting")
            if watch.ends():
                return None
        return estimated(made[:, :, :wanted], dt, seconds, s).relative_error

    def finished() -> int:
        """How many of the first repetitions are finished at both steps."""
        return int(np.argmax(np.append(np.isnan(made[0]).any(axis=0), True)))

    with (
        workers_of(s.cluster, s.threads or usable_cores()) as workers,
        checkpoint.alone(),
        interruptible(s.partial) as checkpoint.stopped,
    ):
        if saved := checkpoint.load():
            made, seconds = saved["made"], float(saved["seconds"])
        watch = Watch(s.seconds, checkpoint.stopped, s.tol, working_time() - seconds)
        watch.until(repeated, most=1 if s.tol is None else inf)
    if (whole := finished()) < LEAST_REPETITIONS:
        raise NotCertified(
            f"{whole} repetitions were finished in {seconds:.3g} s, and {LEAST_REPETITIONS}"
            " are needed: allow more seconds or take fewer replicas"
        )
    return estimated(made[:, :, :whole], dt, seconds, s)


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
    most = 500.0  # so that it stays a number
    spread = min(float(positive.var(ddof=1)), most) if positive.size > 1 else most
    square = np.exp(spread) * values.size / positive.size - 1.0
    error = max(error, mean * float(np.sqrt(square))) / float(np.sqrt(values.size))
    return mean, error if error <= RESOLVED * mean else inf


def estimated(made: Array, dt: float, seconds: float, settings: Splitting) -> RareFailure:
    """Return the probability from repetitions ``made`` (numbers, 2, count) at 2 ``dt`` and ``dt``.

    The bias at dt/2 is at most the difference from dt where it falls as dt or faster. A difference
    below its own standard error counts as that: it may be small by chance.
    """
    (coarse, fine), levels, failures, steps = made
    paths, unit = settings.replicas * fine.size, float(np.max(made[0]))
    unit = unit if np.isfinite(unit) else 0.0
    (at_long, long_error), (mean, own) = (mean_and_error(x - unit) for x in (coarse, fine))
    own = own or mean / paths  # as if one of all paths had not failed
    bias, scale = at_long - mean, exp(unit)
    bias_error = hypot(own, long_error)
    error = hypot(own, max(abs(bias), bias_error))
    bound = (mean + 1.645 * error) * scale
    if not mean > 0.0 or error == inf:
        bound = min(1.0, most_events(int(failures[1].sum())) / paths)
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
        steps=int(np.nansum(steps)),
        seconds=seconds,
        settings={k: v for k, v in asdict(settings).items() if isinstance(v, (int, float, str))},
    )
