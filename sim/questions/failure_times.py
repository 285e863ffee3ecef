"""First passage from failure times, some cut short: estimates, their errors, the certificate."""

from collections.abc import Mapping, Sequence
from math import inf, nan
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from fpk.answer.certificate import Measured, certify
from fpk.answer.evolution import Passage
from fpk.answer.quantities import Number
from fpk.answer.question import Asked
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.system.modulation import Modulation
from sim.questions.limits import STEPS_SINCE_START
from sim.step.arrays import GROUPS

LEAST_FAILURES = 100
"""Failures in the tail below which its rate, and what is continued by it, is not certified."""

LARGEST_BIAS, CHANCE = 0.5, 3.0
"""Difference between two steps, in units of a number, beyond which it does not show the error: a
bias that falls with the step leaves as much, half of the number, at half the step. And standard
errors that a difference of two estimates may have by chance."""


def settled_at(modulation: Modulation | None) -> float:
    """Return from when on the noise is constant; inf where there is none from then on."""
    if modulation is None:
        return 0.0
    return float(modulation.times[-1]) if modulation.last else inf


def estimates(time: Array, until: Array, times: Array, begin: float) -> Array:
    """Return E T, var T, the failure rate after ``begin``, and P(T > t) at ``times``.

    Paths fail at ``time``, those that live are followed ``until``. P(T > t) by Kaplan and Meier (J.
    Amer. Stat. Assoc. 53, 1958, 457), who need no time of those that have not failed; beyond the
    last time it falls at the failure rate, failures over the time under risk after ``begin``. The
    moments are its integrals, ∫ P dt and ∫ 2 t P dt; they are inf where ``begin`` is.
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
    if not max(first, begin) < inf:  # without noise some never fail, none of the sample perhaps
        first = second = inf
    return np.array([first, second - first**2 if first < inf else inf, rate, *at])


def tail_begin(time: Array, until: Array, memory: float) -> float:
    """Return the time from which there is one failure rate, as far as the sample shows.

    The earliest from which the rate agrees with those from all later times within ``CHANCE`` errors
    (Lepski's rule), and ``memory`` more, in which what the start has left falls below the error; no
    later than leaves ``LEAST_FAILURES``.
    """
    seen = np.minimum(time, until)
    events = np.sort(seen[time <= until])
    if events.size < 2 * LEAST_FAILURES + 1:
        return 0.0
    latest = float(events[-LEAST_FAILURES - 1])
    begins = latest * np.linspace(0.0, 1.0, 20)
    if memory < latest:
        begins = np.union1d(np.linspace(0.0, min(8.0 * memory, latest), 20), begins)
    counts = np.array([np.count_nonzero(events > b) for b in begins])
    rates = counts / np.array([np.sum(np.maximum(seen - b, 0.0)) for b in begins])
    variances = rates**2 / counts
    for k, rate in enumerate(rates):
        # Of a part of the sample the variance of the difference is the difference of variances.
        spread = np.sqrt(np.maximum(variances[k:] - variances[k], 0.0))
        if np.all(np.abs(rates[k:] - rate) <= CHANCE * spread + 1e-12 * rate):
            return min(float(begins[k]) + memory, latest)
    return latest


def passage_of(
    sampled: Array,
    asked: Asked,
    tol: float | None,
    step: float,
    memory: float,
    settings: Mapping[str, Any],
    failures: Sequence[str] = (),
) -> Passage:
    """Return first passage from ``sampled`` times (3, paths), rows as of ``passage.followed``.

    ``step`` is the longer one, the first where steps grow: where half of the failures come within
    few of them errors are inf and nothing is certified. ``memory`` is the time after which a
    trajectory has forgotten its start, that in which half fail where that is less: moments, rate
    and later P(T > t) are not known where all were followed for less and some live.

    Raises ``InvalidInput`` for a limit beyond which all begin.
    """
    times, settled = asked.times, settled_at(asked.system.modulation)
    (fine, _, until), failed = sampled, sampled[0] <= sampled[2]
    if np.all(fine == 0.0):
        remedy = "all trajectories begin beyond it; take a higher one"
        raise InvalidInput("limit", str(asked.limit), remedy)
    paths, events, followed = fine.size, int(np.count_nonzero(failed)), float(np.max(until))
    exposure = float(np.sum(np.minimum(fine, until)))
    # Where half have failed those that live are the same from then on, whatever the start.
    memory = min(memory, float(np.median(np.where(failed, fine, inf))))
    begin = max(tail_begin(fine, until, memory), settled)
    best, error, bias, words = with_errors(sampled, times, begin)
    if (begin < memory or followed < settled + memory) and events < paths:
        # A rate that the start is in says nothing of later.
        best[:3], error[:3] = (nan if settled < inf else best[:3]), inf
        error[3:][times > followed] = inf
    after = fine[failed & (fine > 0.0)]
    # Within so few steps the noise of the energy, taken for constant in a step, changes too much.
    steps = float(np.median(after)) / step if after.size and step > 0.0 else inf
    if steps < 0.5 * STEPS_SINCE_START:
        error[:] = inf
        words = [
            f"half of the failures come within {steps:.2g} steps of dt = {step:.2g},"
            f" too few to see how; use dt = {steps * step / STEPS_SINCE_START:.2g}"
        ]
    late = int(np.count_nonzero(failed & (fine > begin)))
    if settled < inf and events < paths and late < LEAST_FAILURES:
        few = f"none of {paths} trajectories passed the limit by t = {followed:.4g}"
        if events:
            few = f"{paths - events} of {paths} trajectories had not failed by t = {followed:.4g}"
            few = f"{few}, and {late} failures in the tail are too few to go on from"
        words.append(
            f"{few}: the mean failure rate until then is {most_events(events) / exposure:.2g} at"
            " most (95 %); simulate for longer, or split"
        )
    # Relative to the mean; where some never fail, absolute of probabilities.
    never = np.max(error[3:], initial=0.0) if settled == inf else inf
    measured = Measured(
        l1_error=float(error[0] / best[0] if best[0] < inf else never),
        mass_defect=None,
        minimum=float(np.min(best[3:], initial=0.0)),
        residual=None,
        tail_mass=1.0 - events / paths,
        failures=(*failures, *words),
    )
    if not events and settled < inf:  # nothing to state but bounds: all lived through their time
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
    numbers = mean, variance, rate if rate.value == rate.value else None
    known = (None, None) if settled < inf else (1.0 - best[3:], error[3:])  # of P(T <= t)
    reliability = times, best[3:], error[3:]
    return Passage(*numbers, *reliability, "sampling", certificate, None, settings, *known)


def with_errors(
    sampled: Array, times: Array, begin: float
) -> tuple[Array, Array, Array, list[str]]:
    """Return the ``estimates`` at half the step, their errors, those of the step, and doubts.

    Errors are those of leaving out groups, the difference between both steps added in quadrature:
    it is at least the error at half the step where that falls with the step.
    """
    fine, coarse, until = sampled
    best = estimates(fine, until, times, begin)
    # The jackknife: √((G − 1)/G Σ (left out − mean)²), G of ``GROUPS``; inf where there is none.
    group, rows = np.arange(fine.size) % GROUPS, []
    for others in (group != g for g in range(GROUPS)):
        rows.append(estimates(fine[others], until[others], times, begin))
    with np.errstate(invalid="ignore"):
        chance = np.sqrt(np.var(rows, axis=0) * (GROUPS - 1))
        alive = best[3:]
        at_least = np.sqrt(np.maximum(alive * (1.0 - alive), 0.0) / fine.size)
        chance[3:] = np.maximum(chance[3:], np.maximum(at_least, 1.0 / fine.size))
        bias = np.abs(estimates(coarse, until, times, begin) - best)
        error = np.hypot(chance, bias)
        size = np.append(np.abs(best[:3]), np.minimum(alive, 1.0 - alive))
        rough = np.flatnonzero(bias > LARGEST_BIAS * size + CHANCE * chance)
    names = ["mean", "variance", "failure rate", *(f"P(T <= {t:g})" for t in times)]
    words = [
        f"the {names[k]} changes by {bias[k]:.2g} at twice the step, too much to tell"
        " what is left; use a smaller dt"
        for k in rough[:1]
    ]
    return best, np.where(np.isnan(error), inf, error), bias, words


def most_events(events: int) -> float:
    """Return the bound, at 95 %, of the expected number of which ``events`` came (Poisson)."""
    return float(gammaincinv(events + 1.0, 0.95))
