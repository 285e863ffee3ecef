"""Failure times, some cut short: estimates of moments, failure rate, reliability; their errors."""

from dataclasses import dataclass
from math import inf, nan

import numpy as np

from fpk.arrays import Array, Flags, Integers

GROUPS = 64
"""Groups of trajectories that are left out, one at a time, for errors (jackknife)."""

TAILS = 20
"""Times from which failure rates are compared, to see from where on there is one rate."""

LEAST_FAILURES = 100
"""Failures in the tail below which its rate, and what is continued by it, is not certified."""

CONSISTENT = 3.0
"""Standard errors within which two failure rates agree (Lepski's rule)."""


@dataclass(frozen=True, eq=False)
class Times:
    """When trajectories failed, inf where not, and until when each was followed, both (paths,).

    ``fine`` were found at half the step of ``coarse``, by the same random numbers where the two
    can be coupled; ``coarse`` None where the times have no error of a step.
    """

    fine: Array
    coarse: Array | None
    until: Array

    @property
    def failed(self) -> int:
        """How many failed."""
        return int(np.count_nonzero(self.fine <= self.until))


def estimates(time: Array, until: Array, times: Array, begin: float) -> Array:
    """Return E T, var T, the failure rate after ``begin``, and P(T > t) at ``times``.

    P(T > t) by Kaplan and Meier (J. Amer. Stat. Assoc. 53, 1958, 457), who need no time of those
    that have not failed; beyond the last time it falls at the failure rate, failures over the time
    under risk after ``begin``. The moments are integrals of it: ∫ P dt and ∫ 2 t P dt.
    """
    seen = np.minimum(time, until)
    order = np.argsort(seen, kind="stable")
    seen, failed = seen[order], (time <= until)[order]
    risk = np.arange(seen.size, 0, -1)
    survival = np.cumprod(1.0 - failed / risk)
    before = np.concatenate([[1.0], survival[:-1]])
    first = float(np.sum(before * np.diff(seen, prepend=0.0)))
    second = float(np.sum(before * np.diff(seen**2, prepend=0.0)))
    exposure = float(np.sum(np.maximum(seen - begin, 0.0)))
    events = int(np.count_nonzero(failed & (seen > begin)))
    rate, last, left = events / exposure if exposure > 0.0 else nan, seen[-1], survival[-1]
    if left > 0.0:
        mean = 1.0 / rate if rate > 0.0 else inf
        first += left * mean
        second += 2.0 * left * mean * (last + mean)
    at = np.concatenate([[1.0], survival])[np.searchsorted(seen, times, side="right")]
    beyond = np.maximum(times - last, 0.0)
    if left > 0.0 and rate > 0.0:
        at = at * np.exp(-rate * beyond)
    return np.array([first, second - first**2 if first < inf else inf, rate, *at])


def tail_begin(time: Array, until: Array, memory: float) -> float:
    """Return the time from which there is one failure rate, as far as the sample shows.

    The earliest from which the rate agrees with those from all later times within ``CONSISTENT``
    errors, and ``memory`` more, in which what the start has left falls below the error; no later
    than leaves ``LEAST_FAILURES``.
    """
    seen, failed = np.minimum(time, until), time <= until
    events = np.sort(seen[failed])
    if events.size < 2 * LEAST_FAILURES + 1:
        return 0.0
    latest = float(events[-LEAST_FAILURES - 1])
    begins = latest * np.linspace(0.0, 1.0, TAILS)
    if memory < latest:
        begins = np.union1d(np.linspace(0.0, min(8.0 * memory, latest), TAILS), begins)
    counts = np.array([np.count_nonzero(events > b) for b in begins])
    exposure = np.array([np.sum(np.maximum(seen - b, 0.0)) for b in begins])
    rates = counts / exposure
    errors = rates / np.sqrt(counts)
    for k in range(begins.size):
        # Of a part of the sample the variance of the difference is the difference of variances.
        spread = np.sqrt(np.maximum(errors[k:] ** 2 - errors[k] ** 2, 0.0))
        if np.all(np.abs(rates[k:] - rates[k]) <= CONSISTENT * spread + 1e-12 * rates[k]):
            return min(float(begins[k]) + memory, latest)
    return latest


def errors_of(sampled: Times, times: Array, begin: float, best: Array) -> tuple[Array, Array]:
    """Errors of the ``estimates`` ``best``, inf where there is none, and the part by the step."""
    # By the jackknife: √((G − 1)/G Σ (left out − mean)²), G of ``GROUPS``.
    group: Integers = np.arange(sampled.fine.size) % GROUPS
    rows = []
    for g in range(GROUPS):
        others: Flags = group != g
        rows.append(estimates(sampled.fine[others], sampled.until[others], times, begin))
    with np.errstate(invalid="ignore"):
        error = np.sqrt(np.var(rows, axis=0) * (GROUPS - 1))
    survival, paths = best[3:], sampled.fine.size
    at_least = np.sqrt(np.maximum(survival * (1.0 - survival), 0.0) / paths)
    error[3:] = np.maximum(error[3:], np.maximum(at_least, 1.0 / paths))
    bias = np.zeros(best.size)
    if sampled.coarse is not None:
        with np.errstate(invalid="ignore"):
            bias = np.abs(estimates(sampled.coarse, sampled.until, times, begin) - best)
    error = np.hypot(error, bias)
    return np.where(np.isnan(error), inf, error), bias
