"""First passage from failure times, some cut short: estimates, their errors, the certificate."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan

import numpy as np
from scipy.special import gammaincinv

from fpk.answer.certificate import Measured, certify
from fpk.answer.evolution import Passage
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.system.modulation import Modulation
from sim.step.arrays import GROUPS

LEAST_FAILURES = 100
"""Failures in the tail below which its rate, and what is continued by it, is not certified."""

CONSISTENT = 3.0
"""Standard errors within which two failure rates agree (Lepski's rule)."""

FEWEST_STEPS = 4.0
"""Steps within which half of the failures may come at the least: what is assumed to be constant in
a step, the noise of the energy above all, changes by a quarter in each."""

LARGEST_BIAS, CHANCE = 0.5, 3.0
"""Difference between two steps, in units of a number, beyond which it does not show the error, and
its standard errors that may be chance: a bias that falls with the step leaves as much, half of the
number, at half the step."""


@dataclass(frozen=True, eq=False)
class Times:
    """When trajectories failed, inf where not, and until when each was followed, both (paths,).

    ``fine`` were found at half the step of ``coarse``, by the same random numbers where the two
    can be coupled.
    """

    fine: Array
    coarse: Array
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
    begins = latest * np.linspace(0.0, 1.0, 20)
    if memory < latest:
        begins = np.union1d(np.linspace(0.0, min(8.0 * memory, latest), 20), begins)
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


def passage_of(
    sampled: Times,
    times: Array,
    *,
    limit: str,
    step: float,
    memory: float,
    tol: float,
    failures: Sequence[str],
    settings: dict[str, str | float | int],
    settled: float = 0.0,
) -> Passage:
    """Return first passage from ``sampled`` times, with one standard error of each number.

    Errors are those of leaving out groups, the difference between both steps added in quadrature:
    it is at least the error at half the step where that falls with the step. ``step`` is the longer
    one, the first where steps grow: where trajectories fail within few of them errors are inf and
    nothing is certified.
    ``memory`` is the time after which a trajectory has forgotten its start, that in which half fail
    where that is less: moments, rate and later P(T > t) are not known where all were followed for
    less and some live. ``settled`` is the time from which on the noise is constant, inf where there
    is none then: who lives then never fails.

    Raises ``InvalidInput`` for a ``limit`` (its name) beyond which all begin.
    """
    fine, until, paths = sampled.fine, sampled.until, sampled.fine.size
    if np.all(fine == 0.0):
        raise InvalidInput("limit", limit, "all trajectories begin beyond it; take a higher one")
    events, followed = sampled.failed, float(np.max(until))
    exposure = float(np.sum(np.minimum(fine, until)))
    # Where half have failed those that live are the same from then on, whatever the start.
    memory = min(memory, float(np.median(np.where(fine <= until, fine, inf))))
    begin = max(tail_begin(fine, until, memory), settled)
    best = estimates(fine, until, times, begin)
    if settled == inf:  # some never fail, even where none of them is in the sample
        best[:2] = inf

    # By the jackknife: √((G − 1)/G Σ (left out − mean)²), G of ``GROUPS``; inf where there is none.
    group, rows = np.arange(paths) % GROUPS, []
    for g in range(GROUPS):
        others = group != g
        rows.append(estimates(fine[others], until[others], times, begin))
    with np.errstate(invalid="ignore"):
        error = np.sqrt(np.var(rows, axis=0) * (GROUPS - 1))
        at_least = np.sqrt(np.maximum(best[3:] * (1.0 - best[3:]), 0.0) / paths)
        error[3:] = np.maximum(error[3:], np.maximum(at_least, 1.0 / paths))
        bias = np.abs(estimates(sampled.coarse, until, times, begin) - best)  # of the step
        error = np.hypot(error, bias)
        error = np.where(np.isnan(error), inf, error)
        size = np.append(np.abs(best[:3]), np.minimum(best[3:], 1.0 - best[3:]))
        rough = bias > LARGEST_BIAS * size + CHANCE * np.sqrt(error**2 - bias**2)

    words, names = list[str](), ["mean", "variance", "failure rate"]
    names += [f"P(T <= {t:g})" for t in times]
    for k in np.flatnonzero(rough)[:1]:
        words.append(
            f"the {names[k]} changes by {bias[k]:.2g} at twice the step, too much to tell"
            " what is left; use a smaller dt"
        )
    if (begin < memory or followed < settled + memory) and events < paths:
        # A rate that the start is in says nothing of later.
        best[:3], error[:3] = (nan if settled < inf else best[:3]), inf
        error[3:][times > followed] = inf
    failed = fine[(fine <= until) & (fine > 0.0)]
    if failed.size and (typical := float(np.median(failed))) < FEWEST_STEPS * step:
        error[:] = inf
        words = [
            f"half of the failures come within {typical / step:.2g} steps of dt = {step:.2g},"
            f" too few to see how; use dt = {typical / (2.0 * FEWEST_STEPS):.2g}"
        ]
    late = int(np.count_nonzero((fine <= until) & (fine > begin)))
    if settled < inf and events < paths and late < LEAST_FAILURES:
        few = (
            f"{paths - events} of {paths} trajectories had not failed by t = {followed:.4g}, and"
            f" {late} failures in the tail are too few to go on from"
            if events
            else f"none of {paths} trajectories passed the limit by t = {followed:.4g}"
        )
        most = _bound(events) / exposure
        words.append(
            f"{few}: the mean failure rate until then is {most:.2g} at most (95 %); simulate for"
            " longer, or split"
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
        best[:3], error[:3] = (exposure / paths, inf, 0.0), (inf, inf, _bound(0) / exposure)
    settings = settings | {"trajectories": paths, "not failed": paths - events}
    settings["followed until"] = float(np.max(np.minimum(fine, until)))
    if begin < inf:
        settings["failure rate from"] = begin
    if 0 < events < paths and best[0] < inf:
        settings["continued"] = "the moments, at the failure rate, where trajectories end first"
    if events:
        settings |= {
            "step bias of the mean": float(bias[0]),
            "step bias of the rate": float(bias[2]),
        }
    return Passage(
        mean=Number(float(best[0]), float(error[0])),
        variance=Number(float(best[1]), float(error[1])),
        rate=Number(float(best[2]), float(error[2])) if best[2] == best[2] else None,
        times=times,
        survival=best[3:],
        survival_error=error[3:],
        error_kind="sampling",
        certificate=certify(measured, tol=tol, sampled=True),
        settings=settings,
        failure=None if settled < inf else 1.0 - best[3:],
        failure_error=None if settled < inf else error[3:],
    )


def _bound(events: int) -> float:
    """Upper bound, at 95 %, of the expected number of which ``events`` came (Poisson)."""
    return float(gammaincinv(events + 1.0, 0.95))


def settled_at(modulation: Modulation | None) -> float:
    """Return from when on the noise is constant; inf where there is none from then on."""
    if modulation is None:
        return 0.0
    return float(modulation.times[-1]) if modulation.last else inf


def followed_for(most: float, last: float, modulation: Modulation | None) -> float:
    """Return how long paths are followed: ``most``, but to the ``last`` time asked for at least.

    No longer than that after the end of a noise that ends with 0: motion then only decays.
    """
    if modulation is not None and not modulation.last:
        most = min(most, float(modulation.times[-1]))
    return max(most, last)
