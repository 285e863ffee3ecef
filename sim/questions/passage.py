"""First passage by simulation: failure times, some censored; their moments, rate and P(T > t)."""

from collections.abc import Callable, Mapping, Sequence
from math import ceil, inf, nan, sqrt
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from fpk.answer.certificate import Measured, certify, tolerance
from fpk.answer.dynamics import Passage, require_times
from fpk.answer.quantities import Number
from fpk.answer.question import Asked
from fpk.numeric.arrays import Array, Flags
from fpk.numeric.errors import require
from fpk.numeric.machine import pause_working_time
from fpk.system.modulation import Modulation
from sim.questions import limits
from sim.questions.passing import reader_of
from sim.questions.rounds import MOST_SUMS, Watch, seed_of, working
from sim.sample.ensemble import Reader, ensemble_from
from sim.sample.settings import Settings
from sim.step.arrays import LANES, MAX_BATCHES, MAX_TRAJECTORIES, in_blocks, in_rows
from sim.step.random import stream_of
from sim.step.step_size import loudest, relaxation_time

HOPELESS = 8.0
"""A simulation without a ``time`` ends after 1/8 of its longest time if nothing has failed: in the
rest 8 · 3 failures or fewer (95 %) are expected, too few for an estimate."""

LEAST_TAIL_FAILURES = 100
"""Least number of failures in the tail for a certified failure rate and extrapolation by it."""

LARGEST_BIAS, CHANCE = 0.5, 3.0
"""Largest relative change of a number from dt to dt/2 that still bounds its bias at dt/2; largest
change by chance, in standard errors."""

Run = tuple[Any, int, Callable[[Any], Reader], tuple[int, ...]]
"""An ensemble, its steps in a step of the coarser simulation, a function that makes its reader, and
the failure times that it writes: 0 of the finer simulation, 1 of the coarser."""


def sample_passage(method: Settings, asked: Asked) -> Passage:
    """Return the first passage of ``asked.limit`` at dt/2; the change from dt is in the error.

    ``paths`` trajectories are simulated until all have failed, or until the ``horizon``; more
    rounds follow until ``asked.tol``, the relative error of the mean, or ``seconds``.
    """
    system, limit, start, times = asked.system, asked.limit, asked.start, require_times(asked.times)
    tol, modulation, loud = tolerance(asked.tol, method.tol), system.modulation, loudest(system)
    reach = limits.motion_reach(loud, limit, start, method.time or inf)
    dt, failures = limits.motion_step(method, loud, reach, error=tol)
    first = limits.first_step(dt, times, reach.start, method.step_factor)
    last, (constant, end) = float(np.max(times, initial=0.0)), noise_times(modulation)
    longest = horizon(method, dt, last, end)
    # With modulated noise failures may begin late.
    hopeless = method.time or max(longest / HOPELESS, last, min(constant, longest))
    at_once = MOST_SUMS // limits.CHUNK_STEPS  # a chunk takes less than a second
    paths = -(-min(method.paths, at_once) // LANES) * LANES
    energies = limits.energies_of(limit, system.n)

    def begun(number: int) -> tuple[list[Run], Flags, Array]:
        q, p = origin(paths, number)
        past = limits.states_beyond(system, limit, q, p)
        require(not np.all(past), "start", str(start), f"is beyond the limit {limit}")
        seed = seed_of(method.seed, number)
        read = lambda motion: reader_of(system, limit, motion.dt, motion.begin)  # noqa: E731
        options: Any = {"energies": energies, "workers": workers, "modulation": modulation}
        with pause_working_time():  # both with the same random numbers
            both = (0.5 * first, False), (first, True)
            pair = [ensemble_from(system, q, p, h, seed, halved=x, **options) for h, x in both]
        stream = stream_of(seed, number, of_starts=True)
        chance = stream.exponential(size=(paths, limits.energies_at(system, limit).size))
        return [(e, 2 - k, read, (k,)) for k, e in enumerate(pair)], past, chance

    with working(method, system, tol, start) as (workers, watch, origin):
        rounds = ceil(method.paths / paths), MAX_TRAJECTORIES // at_once
        steps = first, dt, limits.CHUNK_STEPS, longest, hopeless
        known = relaxation_time(system), {"scheme": method.scheme, "seed": method.seed}, failures
        return passage_in_rounds(asked, watch, rounds, begun, steps, *known)


def noise_times(modulation: Modulation | None) -> tuple[float, float]:
    """Return the times after which the noise is constant and not 0, and is 0; inf if never."""
    if modulation is None:
        return 0.0, inf
    end = float(modulation.times[-1])
    return (end, inf) if modulation.last else (inf, end)


def horizon(method: Settings, dt: float, last: float, end: float = inf) -> float:
    """Return the longest time of a trajectory: ``time`` of the method, or by its ``most_steps``.

    The latter count the steps ``dt`` and dt/2; the time is then at most the ``end`` of the noise,
    and at least ``last``, the last output time.
    """
    return method.time or max(min(method.most_steps / 3.0 * dt, end), last)


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
    """Return the first passage of trajectories in ``rounds``, the least and the largest number.

    ``begun(number)`` returns the runs of a round, flags of trajectories beyond the limit at time 0,
    and exponential random numbers (paths, limits) for the readers. ``steps``: first and longest
    step of the coarser simulation, number of steps at once, last time, and last time without any
    failure. ``memory``: see ``passage_of``.
    """
    (first, dt, chunk, longest, hopeless), rows = steps, list[Array]()

    def error_after(number: int) -> float:
        runs, past, chances = begun(number)
        paths, lanes = past.size, np.arange(past.size)
        chance = [in_blocks(chances) for _ in range(2)]
        found = [in_blocks(np.where(past, 0.0, inf)[:, None]) for _ in range(2)]
        failed = np.full((2, paths), inf)
        for step, made in limits.stages(first, dt, longest, most=chunk):
            if step / runs[-1][1] != runs[-1][0].dt:
                runs = [(e.onward(step / many), many, make, k) for e, many, make, k in runs]
            for ensemble, many, make, which in runs:
                arrays, read = [a[k] for k in which for a in (found, chance)], make(ensemble)
                ensemble.advance(many * made, *arrays, read=read, passed=arrays[0])
            failed[:, lanes] = [in_rows(times)[: lanes.size, 0] for times in found]
            running = np.isinf(failed[:, lanes]).any(axis=0)
            alive, time = int(np.count_nonzero(running)), runs[-1][0].time
            share = max(1.0 - alive / paths, min(1.0, time / longest))
            asked.progress(int(1000 * share), 1000, "first passage")
            nothing = not np.isfinite(failed).any() and time >= hopeless
            if not alive or nothing or watch.ends():
                break
            if 2 * alive <= len(found[0]) * LANES and len(found[0]) > 1:
                left = np.flatnonzero(running)
                lanes = lanes[left]
                for ensemble, *_ in runs:
                    ensemble.keep(left)
                found, chance = ([in_blocks(in_rows(a)[left]) for a in x] for x in (found, chance))
        until = np.full(paths, min(longest, time))
        # Passages in the part of the last step beyond the horizon do not count.
        failed[failed > until] = inf
        rows.append(np.vstack([failed, until]))
        # Approximate relative standard error of the mean: times are nearly exponential.
        return 1.1 / sqrt(max(1, sum(np.count_nonzero(fine < inf) for fine, _, _ in rows)))

    failures = [*failures, *watch.until(error_after, least=rounds[0], most=rounds[1])]
    settings = {"dt": 0.5 * dt, "coarse dt": dt, **settings}
    return passage_of(np.hstack(rows), asked, watch.tol, first, memory, settings, failures)


def estimates(time: Array, until: Array, times: Array, begin: float) -> Array:
    """Return E T, var T, the failure rate after ``begin``, P(T > t) at ``times``: (3 + times,).

    Paths fail at ``time`` (paths,), or are censored at ``until`` (paths,). P(T > t) by Kaplan and
    Meier (J. Amer. Stat. Assoc. 53, 1958, 457); beyond the last time it decays with the failure
    rate, failures over time at risk (NaN if that time is 0), or is constant if the rate is not > 0.
    Moments are ∫ P dt and ∫ 2 t P dt, inf if ``begin`` is inf.
    """
    seen = np.minimum(time, until)
    order = np.argsort(seen, kind="stable")
    seen, failed = seen[order], (time <= until)[order]
    survival = np.cumprod(np.append(1.0, 1.0 - failed / np.arange(seen.size, 0, -1)))
    first, second = (float(np.sum(survival[:-1] * np.diff(seen**k, prepend=0.0))) for k in (1, 2))
    exposure = float(np.sum(np.maximum(seen - begin, 0.0)))
    events = int(np.count_nonzero(failed & (seen > begin)))
    rate, last, left = events / exposure if exposure > 0.0 else nan, seen[-1], survival[-1]
    at = survival[np.searchsorted(seen, times, side="right")]
    if left > 0.0:
        mean = 1.0 / rate if rate > 0.0 else inf
        first += left * mean
        second += 2.0 * left * mean * (last + mean)
        at = at * np.exp(-np.maximum(times - last, 0.0) / mean)
    if not max(first, begin) < inf:  # when the noise ends, some never fail
        first = second = inf
    return np.array([first, second - first**2 if first < inf else inf, rate, *at])


def tail_begin(time: Array, until: Array, memory: float) -> float:
    """Return the time from which on the failure rate is constant within its sampling error.

    Failures at ``time``, censored at ``until``, (paths,). It is the earliest time from which the
    rate agrees with the rates from all later times within ``CHANCE`` errors (Lepski's rule), plus
    ``memory``, but leaves ``LEAST_TAIL_FAILURES``; 0 unless more than twice as many have failed.
    """
    seen = np.minimum(time, until)
    events = np.sort(seen[time <= until])
    if events.size < 2 * LEAST_TAIL_FAILURES + 1:
        return 0.0
    latest = float(events[-LEAST_TAIL_FAILURES - 1])
    begins = latest * np.linspace(0.0, 1.0, 20)
    if memory < latest:
        begins = np.union1d(np.linspace(0.0, min(8.0 * memory, latest), 20), begins)
    counts = np.array([np.count_nonzero(events > b) for b in begins])
    rates = counts / np.array([np.sum(np.maximum(seen - b, 0.0)) for b in begins])
    variances = rates**2 / counts
    for k, rate in enumerate(rates):
        # The later sample is part of the earlier: the variance of the difference is the difference.
        spread = np.sqrt(np.maximum(variances[k:] - variances[k], 0.0))
        if np.all(np.abs(rates[k:] - rate) <= CHANCE * spread + 1e-12 * rate):
            return min(float(begins[k]) + memory, latest)
    return latest


def with_errors(
    sampled: Array, times: Array, begin: float
) -> tuple[Array, Array, Array, list[str]]:
    """Return ``estimates`` at half the step, their errors, their |differences| to the step, words.

    ``sampled`` (3, paths): see ``passage_of``; ``times``, ``begin``: see ``estimates``. Errors: the
    jackknife over groups, and the difference between the two steps, added in squares, with inf in
    place of NaN. The words are against certification, if the two steps differ too much.
    """
    fine, coarse, until = sampled
    best = estimates(fine, until, times, begin)
    # The jackknife: √((G − 1)/G Σ (left out − mean)²), G = MAX_BATCHES.
    group = np.arange(fine.size) % MAX_BATCHES
    rows = [
        estimates(fine[k], until[k], times, begin) for k in (group != g for g in range(MAX_BATCHES))
    ]
    with np.errstate(invalid="ignore"):
        chance, alive = np.sqrt(np.var(rows, axis=0) * (MAX_BATCHES - 1)), best[3:]
        at_least = np.sqrt(np.maximum(alive * (1.0 - alive), 0.0) / fine.size)
        chance[3:] = np.maximum(chance[3:], np.maximum(at_least, 1.0 / fine.size))
        bias = np.abs(estimates(coarse, until, times, begin) - best)
        error = np.hypot(chance, bias)
        size = np.append(np.abs(best[:3]), np.minimum(alive, 1.0 - alive))
        rough = np.flatnonzero(bias > LARGEST_BIAS * size + CHANCE * chance)
    names = ["mean", "variance", "failure rate", *(f"P(T <= {t:g})" for t in times)]
    remedy = "at twice the step, too much to tell what is left; use a smaller dt"
    words = [f"the {names[k]} changes by {bias[k]:.2g} {remedy}" for k in rough[:1]]
    return best, np.where(np.isnan(error), inf, error), bias, words


def most_events(events: int) -> float:
    """Return the upper 95 % bound of a Poisson mean when ``events`` were counted."""
    return float(gammaincinv(events + 1.0, 0.95))


def passage_of(
    sampled: Array,
    asked: Asked,
    tol: float | None,
    step: float,
    memory: float,
    settings: Mapping[str, Any],
    failures: Sequence[str] = (),
) -> Passage:
    """Return first passage from ``sampled`` times (3, paths), certified for ``tol``.

    Rows: failure times at half the step and at the step, inf if censored at the time in row three.
    ``step``: the first step of the coarser simulation; errors are inf if half of the failures come
    within a few of them. After the time ``memory``, or when half have failed, a trajectory no
    longer depends on its start: if the simulation is shorter and some trajectories live, moments,
    rate and later P(T > t) are not known. Without a failure, unless the noise ends, the mean is the
    mean time simulated, its error inf, and the rate 0, its error the 95 % bound. ``failures``:
    words against certification. Raises ``InvalidInput`` if all trajectories start beyond the limit.
    """
    times, (settled, _) = asked.times, noise_times(asked.system.modulation)
    (fine, _, until), failed = sampled, sampled[0] <= sampled[2]
    remedy = "all trajectories begin beyond it; take a higher one"
    require(np.any(fine != 0.0), "limit", str(asked.limit), remedy)
    paths, events, followed = fine.size, int(np.count_nonzero(failed)), float(np.max(until))
    exposure = float(np.sum(np.minimum(fine, until)))
    # When half have failed, the others no longer depend on the start.
    memory = min(memory, float(np.median(np.where(failed, fine, inf))))
    begin = max(tail_begin(fine, until, memory), settled)
    best, error, bias, words = with_errors(sampled, times, begin)
    if (begin < memory or followed < settled + memory) and events < paths:
        # A rate that depends on the start cannot be extrapolated.
        best[:3], error[:3] = (nan if settled < inf else best[:3]), inf
        error[3:][times > followed] = inf
    after = fine[failed & (fine > 0.0)]
    # In few steps σ of the energy, constant over a step in the reader, changes too much.
    steps = float(np.median(after)) / step if after.size and step > 0.0 else inf
    if steps < 0.5 * limits.STEPS_SINCE_START:
        error[:] = inf
        use = f"too few to see how; use dt = {steps * step / limits.STEPS_SINCE_START:.2g}"
        words = [f"half of the failures come within {steps:.2g} steps of dt = {step:.2g}, {use}"]
    late = int(np.count_nonzero(failed & (fine > begin)))
    if settled < inf and events < paths and late < LEAST_TAIL_FAILURES:
        few = f"none of {paths} trajectories passed the limit by t = {followed:.4g}"
        if events:
            few = f"{paths - events} of {paths} trajectories had not failed by t = {followed:.4g}"
            few = f"{few}, and {late} failures in the tail are too few to go on from"
        most = f"{most_events(events) / exposure:.2g} at most (95 %); simulate for longer"
        words.append(f"{few}: the mean failure rate until then is {most}")
    # Relative to the mean; if some never fail, absolute error of the probabilities.
    never = np.max(error[3:], initial=0.0) if settled == inf else inf
    relative = float(error[0] / best[0] if best[0] < inf else never)
    lowest = float(np.min(best[3:], initial=0.0))
    measured = Measured(relative, None, lowest, None, 1.0 - events / paths)
    measured = measured.with_failures(*failures, *words)
    if not events and settled < inf:  # no failures: bounds only
        best[:3], error[:3] = (exposure / paths, inf, 0.0), (inf, inf, most_events(0) / exposure)
    settings = {**settings, "trajectories": paths, "not failed": paths - events}
    settings["followed until"] = float(np.max(np.minimum(fine, until)))
    if begin < inf:
        settings["failure rate from"] = begin
    if 0 < events < paths and best[0] < inf:
        settings["continued"] = "the moments, at the failure rate, where trajectories end first"
    if events:
        settings["step bias of the mean"] = float(bias[0])
        settings["step bias of the rate"] = float(bias[2])
    mean, variance, rate = (Number(float(best[k]), float(error[k])) for k in range(3))
    certificate = certify(measured, tol=inf if tol is None else tol, sampled=True)
    numbers = mean, variance, rate if rate.value == rate.value else None, times, best[3:], error[3:]
    known = (None, None) if settled < inf else (1.0 - best[3:], error[3:])  # of P(T <= t)
    return Passage(*numbers, "sampling", certificate, None, settings, *known)
