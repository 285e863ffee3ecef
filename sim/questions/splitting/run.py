"""Adaptive multilevel splitting of paths, in repetitions at two steps.

Cerou and Guyader, Stoch. Anal. Appl. 25, 2007, 417, in the unbiased form of Brehier, Gazeau,
Goudenege, Lelievre and Rousset, Ann. Appl. Probab. 26, 2016, 3559: at each level Z all replicas
whose score has not exceeded Z are killed, ties included; the estimate is the product of the shares
that survive. A killed replica is replaced by a copy of a survivor up to the first time when its
score exceeds Z, and continued with new noise. For a Markov chain in discrete time and any score the
mean of the estimate is exactly P.
"""

from dataclasses import dataclass
from functools import partial
from math import ceil, exp, hypot, inf, isfinite, log, nan
from pathlib import Path
from typing import Any

import numpy as np

from fpk.answer.method import Progress, silent
from fpk.answer.names import Limit, Start
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified, require
from fpk.numeric.machine import usable_cores, working_time
from fpk.system.modulation import require_constant_noise
from fpk.system.system import System
from sim.questions import limits
from sim.questions.passage import most_events
from sim.questions.rounds import Watch, initial_states
from sim.questions.splitting import kernel
from sim.questions.splitting.kernel import SCORE_LEVELS, Replicas, ScoreFunction, SystemProblem
from sim.sample.settings import NOT_IN_STATE, check_settings
from sim.sample.workers import checkpoint_of, interruptible, workers_of
from sim.step.arrays import MAX_TRAJECTORIES
from sim.step.random import stream_of
from sim.step.step_size import STEP_PER_RATE, chosen_step, temperature

Score = ScoreFunction | None

LEAST_REPETITIONS = 8
"""Least number of repetitions for an estimate of the error from their spread."""

LARGEST_SPREAD = 0.3
"""Largest standard error of a mean, over the mean, that is stated from the spread of a few
repetitions; above it the error is inf."""


@dataclass(frozen=True)
class Splitting:
    """Settings of splitting; times are in the system's unit, except for ``seconds``.

    A repetition has ``replicas`` paths, of which each level kills ``killed`` or more.
    ``repetitions`` are made at the step dt and as many at dt/2; with ``tol`` this is repeated until
    the relative error is ``tol`` or less, at most for ``seconds`` of wall time. ``dt`` None: a step
    chosen for the system. ``threads``, ``cluster``, ``checkpoint`` and ``partial``: see
    ``MonteCarlo``; the numbers do not depend on them.

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
        """Check all numbers; raise ``InvalidInput`` if one cannot be used."""
        replicas = "replicas", 2, 8190  # times 2048 levels: a seed has 2**24 streams
        others = ("killed", 1, self.replicas - 1), ("repetitions", LEAST_REPETITIONS, 2**20)
        check_settings(self, ("dt", "tol", "seconds"), replicas, *others)


@dataclass(frozen=True)
class RareFailure:
    """The probability that a limit is passed before a time, with its error.

    ``probability`` is the mean of ``values`` (repetitions,) at the step ``dt``. ``error``: its
    standard error, and ``bias``, the mean at 2 dt minus this mean, or the standard error of the
    difference if larger, added in squares. It is inf if the repetitions scatter so much that their
    mean may be off by more than the spread shows: use more replicas. ``upper_bound`` holds with
    95 % confidence; if the error is inf, it follows from the unsplit paths alone. If no replica
    failed, the probability is 0 with this bound as its error. ``extinct``: number of repetitions in
    which a level killed all replicas. ``log_probability`` is correct even if exp underflows. ::

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
    values: Array
    extinct: int
    levels: float  # mean number of levels of a repetition
    dt: float

    @property
    def relative_error(self) -> float:
        """The error in units of the probability; inf if the probability is 0."""
        return self.error / self.probability if self.probability > 0.0 else inf


def split(
    replicas: Any, failure: int, killed: int, stream: np.random.Generator, until: float = inf
) -> tuple[float, int, int]:
    """Return ln of the estimated P(score >= ``failure``), the number of levels, and early failures.

    Early failures are replicas that fail before any is killed. ``replicas`` have ``best`` and
    ``renew`` (see ``Replicas``), which changes them; each level kills the ``killed`` worst, and
    ties; survivors to be copied are drawn from ``stream``. The logarithm is −inf if a level kills
    all replicas, NaN if the value ``until`` of ``working_time`` has passed.
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
    system: System, limit: Limit, start: Start, time: float, *, dt: float | None, score: Score
) -> SystemProblem:
    """Return the problem of failure at ``limit`` before ``time``; None: chosen ``dt``, ``score``.

    Raises as ``rare_failure`` does, and ``InvalidInput`` for ``dt`` beyond ``limits.TOO_LONG``
    times the chosen step.
    """
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: whether the limit is passed is no chance")
    # Some states of a random start may lie beyond the limit.
    states = () if start.kind == "noise" else initial_states(system, start, 0, 64)
    if states and np.all(limits.states_beyond(system, limit, *states)):
        raise InvalidInput("start", str(start), f"must lie within the limit {limit}")
    # The default score: the least action of each energy.
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
        words = "must be left out where there are several limits"
        require(len(scores) == 1, "score", score, words)
        scores = [score]
    energies = [lambda x, top=top: top * x**2 for top in tops]
    tables = kernel.score_tables(scores, energies, time)
    if limit.kind == "v":
        tables = np.repeat(tables, len(limit.ends), axis=0)
    reach = limits.motion_reach(system, limit, start, time)
    soon = min(reach.limit, reach.start) if start.kind == "state" else reach.limit
    longest = chosen_step(system, energy=reach.energy, kT=reach.kT)
    longest = min(longest, STEP_PER_RATE * soon, time / limits.STEPS_SINCE_START)
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
    """Return P(T <= ``time``), T the time of first passage of ``limit`` from ``start`` by Eq. (6).

    ``score`` None: minus the least action of the averaged linear system. Any score gives the same
    mean; a good score, such as ln P of an averaged equation, gives a smaller error. For a limit on
    q_i or v_i its energies are those of that displacement or velocity. ::

        rare_failure(system, parse_limit("H=4", system.n), REST, 10.0)

    Raises ``InvalidInput`` for a start at or beyond the limit, a time that is not finite and > 0,
    or a ``score`` for several limits; ``NotApplicable`` without noise or with modulated noise;
    ``NotCertified`` if ``seconds`` or Ctrl-C leave fewer than ``LEAST_REPETITIONS`` repetitions.
    """
    own = settings or Splitting()
    require(0.0 < time < inf, "time", time, "must be a finite number > 0")
    require_constant_noise(system.modulation)
    problem = system_problem(system, limit, start, time, dt=own.dt, score=score)
    return sample_failure(problem, own, progress)


def repetition(
    problem: SystemProblem, settings: Splitting, seconds: float, number: int, fine: int
) -> tuple[int, int, tuple[float, int, int]]:
    """Return ``number``, ``fine`` and the result of this repetition at the step dt / 2**``fine``.

    The result is that of ``split``, whose ln P is NaN if ``seconds`` of wall time did not suffice.
    """
    until, stream = working_time() + seconds, stream_of(settings.seed, 2 * number + fine)
    steps, seed = step_count(problem) * 2**fine, int(stream.integers(2**63))
    replicas = Replicas(problem, settings.replicas, steps, seed, stream)
    return number, fine, split(replicas, SCORE_LEVELS, settings.killed, stream, until)


def step_count(problem: SystemProblem) -> int:
    """Return the number of the longer steps in the time; ``InvalidInput`` for more than 2**32."""
    steps: int = ceil(problem.time / problem.dt * (1.0 - 1e-12))
    most = 2**56 // MAX_TRAJECTORIES
    require(1 <= steps <= most, "dt", problem.dt, f"makes {steps:g} steps; use at most {most}")
    return steps


def sample_failure(problem: SystemProblem, settings: Splitting, progress: Progress) -> RareFailure:
    """Return the probability of failure in ``problem``; see ``rare_failure``."""
    dt, s = 0.5 * problem.time / step_count(problem), settings
    checkpoint = checkpoint_of(s.checkpoint, (problem, s), "splitting", less=NOT_IN_STATE)
    # Results of the repetitions at dt and dt/2, (results, 2, made); NaN until one is finished.
    made, seconds = np.zeros((3, 2, 0)), 0.0

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
        return failure_estimate(made[:, :, :wanted], dt, s).relative_error

    def finished() -> int:
        """Return the number n of which the repetitions 0 to n − 1 are finished at both steps."""
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
            " are needed: allow more seconds"
        )
    return failure_estimate(made[:, :, :whole], dt, s)


def mean_and_error(log_values: Array) -> tuple[float, float]:
    """Return the mean of exp(``log_values``) (repetitions,) and its standard error.

    Estimates of splitting are nearly log-normal. A small sample with a large spread lacks the
    largest values, and its mean and deviation are too small. The error is therefore the larger of
    the usual standard error and ``mean √((e^{s²}/(1 − e) − 1)/count)``, s² the variance of the
    logarithms and e the share of zeros; inf if it exceeds ``LARGEST_SPREAD`` times the mean, which
    may then be wrong by orders of magnitude. Both are 0 if all values are 0.
    """
    values = np.exp(log_values)
    mean, error = float(values.mean()), float(values.std(ddof=1))
    positive = log_values[np.isfinite(log_values)]
    if positive.size == 0:
        return 0.0, 0.0
    most = 500.0  # so that exp does not overflow
    spread = min(float(positive.var(ddof=1)), most) if positive.size > 1 else most
    square = np.exp(spread) * values.size / positive.size - 1.0
    error = max(error, mean * float(np.sqrt(square))) / float(np.sqrt(values.size))
    return mean, error if error <= LARGEST_SPREAD * mean else inf


def failure_estimate(made: Array, dt: float, settings: Splitting) -> RareFailure:
    """Return the probability from repetitions ``made`` (3, 2, count) at 2 ``dt`` and ``dt``.

    The rows are ln P, levels, early failures; see ``split``. If the bias falls at least as fast as
    the step, it is at most the difference of the two means. A difference below its standard error
    may be small by chance: then this error is taken for it.
    """
    (coarse, fine), levels, failures = made
    paths, unit = settings.replicas * fine.size, float(np.max(made[0]))
    unit = unit if np.isfinite(unit) else 0.0
    (at_long, long_error), (mean, own) = (mean_and_error(x - unit) for x in (coarse, fine))
    own = own or mean / paths  # as if one of all paths had not failed
    bias, scale = at_long - mean, exp(unit)
    error = hypot(own, max(abs(bias), hypot(own, long_error)))
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
        values=np.exp(fine),
        extinct=int(np.sum(~np.isfinite(fine))),
        levels=float(levels[1].mean()),
        dt=dt,
    )
