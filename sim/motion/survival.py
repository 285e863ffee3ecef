"""First passage from sampled failure times, and whether they are enough to certify it."""

from collections.abc import Sequence
from math import inf, nan

import numpy as np
from scipy.special import gammaincinv

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.errors import InvalidInput
from fpk.evolution import Passage
from fpk.modulation import Modulation
from fpk.number import Number
from sim.motion.failure_times import LEAST_FAILURES, Times, errors_of, estimates, tail_begin

FEWEST_STEPS = 4.0
"""Steps within which half of the failures may come at the least: what is assumed to be constant in
a step, the noise of the energy above all, changes by a quarter in each, and the bias is then
measured by the difference between two steps."""

LARGEST_BIAS, CHANCE = 0.5, 3.0
"""Difference between two steps, in units of a number, beyond which it does not show the error, and
its standard errors that may be chance: a bias that falls with the step leaves as much, half of the
number, at half the step."""


def passage_of(
    sampled: Times,
    times: Array,
    *,
    limit: str,
    step: float,
    memory: float,
    tol: float,
    failures: Sequence[str],
    settled: float = 0.0,
    settings: dict[str, str | float | int],
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
    fine, until = sampled.fine, sampled.until
    if np.all(fine == 0.0):
        words = "all trajectories begin beyond it; take a higher one"
        raise InvalidInput("limit", limit, words)
    # Where half have failed those that live are the same from then on, whatever the start.
    memory = min(memory, float(np.median(np.where(fine <= until, fine, inf))))
    begin = max(tail_begin(fine, until, memory), settled)
    best = estimates(fine, until, times, begin)
    if settled == inf:  # some never fail, even where none of them is in the sample
        best[:2] = inf
    error, bias = errors_of(sampled, times, begin, best)
    exposure = float(np.sum(np.minimum(fine, until)))
    followed = float(np.max(until))
    rough = _too_rough(times, best, error, bias)
    soon = begin < memory or followed < settled + memory
    if soon and sampled.failed < fine.size:
        # A rate that the start is in says nothing of later.
        best[:3], error[:3] = (nan if settled < inf else best[:3]), inf
        error[3:][times > followed] = inf
    if too_soon := _too_soon(fine[fine <= until], step):
        error[:] = inf
    # Relative to the mean; where some never fail, absolute of probabilities.
    never = np.max(error[3:], initial=0.0) if settled == inf else inf
    measured = Measured(
        l1_error=float(error[0] / best[0] if best[0] < inf else never),
        mass_defect=None,
        minimum=float(np.min(best[3:], initial=0.0)),
        residual=None,
        tail_mass=1.0 - sampled.failed / fine.size,
        failures=(
            *failures,
            *(too_soon or rough),
            *(_too_few(sampled, begin, exposure) if settled < inf else ()),
        ),
    )
    if (
        not sampled.failed and settled < inf
    ):  # nothing to state but bounds: all lived through their time
        best[:3], error[:3] = (exposure / fine.size, inf, 0.0), (inf, inf, _bound(0) / exposure)
    return Passage(
        mean=Number(float(best[0]), float(error[0])),
        variance=Number(float(best[1]), float(error[1])),
        rate=Number(float(best[2]), float(error[2])) if best[2] == best[2] else None,
        times=times,
        survival=best[3:],
        survival_error=error[3:],
        error_kind="sampling",
        certificate=certify(measured, tol=tol, sampled=True),
        settings=settings | _seen(sampled, begin, bias, best[0] < inf),
        failure=None if settled < inf else 1.0 - best[3:],
        failure_error=None if settled < inf else error[3:],
    )


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


def _seen(sampled: Times, begin: float, bias: Array, known: bool) -> dict[str, str | float | int]:
    """Numbers of trajectories and failures, the time that was followed, and the step's ``bias``."""
    paths, events = sampled.fine.size, sampled.failed
    seen: dict[str, str | float | int] = {
        "trajectories": paths,
        "not failed": paths - events,
        "followed until": float(np.max(np.minimum(sampled.fine, sampled.until))),
    }
    if begin < inf:
        seen["failure rate from"] = begin
    if 0 < events < paths and known:
        seen["continued"] = "the moments, at the failure rate, where trajectories end first"
    if sampled.coarse is not None and events:
        seen |= {"step bias of the mean": float(bias[0]), "step bias of the rate": float(bias[2])}
    return seen


def _too_soon(failed: Array, step: float) -> list[str]:
    """Words where half of the times > 0 at which trajectories ``failed`` lie within few steps."""
    typical = float(np.median(failed[failed > 0.0])) if np.any(failed > 0.0) else inf
    if typical >= FEWEST_STEPS * step:
        return []
    return [
        f"half of the failures come within {typical / step:.2g} steps of dt = {step:.2g},"
        f" too few to see how; use dt = {typical / (2.0 * FEWEST_STEPS):.2g}"
    ]


def _too_rough(times: Array, best: Array, error: Array, bias: Array) -> list[str]:
    """Words where a number changes so much with the step that this says nothing of its error.

    ``best``, ``error`` and the part of it that is the ``bias`` of the step are as of ``errors_of``.
    """
    size = np.append(np.abs(best[:3]), np.minimum(best[3:], 1.0 - best[3:]))
    with np.errstate(invalid="ignore"):
        rough = bias > LARGEST_BIAS * size + CHANCE * np.sqrt(error**2 - bias**2)
    names = ["mean", "variance", "failure rate", *(f"P(T <= {t:g})" for t in times)]
    return [
        f"the {names[k]} changes by {bias[k]:.2g} at twice the step, too much to tell"
        " what is left; use a smaller dt"
        for k in np.flatnonzero(rough)[:1]
    ]


def _too_few(sampled: Times, begin: float, exposure: float) -> list[str]:
    """Words where some have not failed, and few have after ``begin``; ``exposure`` is that of all.

    It is the sum of the times for which trajectories were followed, in which the failures came.
    """
    paths, unfailed = sampled.fine.size, sampled.fine.size - sampled.failed
    late = int(np.count_nonzero((sampled.fine <= sampled.until) & (sampled.fine > begin)))
    if not unfailed or late >= LEAST_FAILURES:
        return []
    end = f"by t = {np.max(sampled.until):.4g}"
    few = (
        f"{unfailed} of {paths} trajectories had not failed {end}, and {late} failures in the tail"
        " are too few to go on from"
        if sampled.failed
        else f"none of {paths} trajectories passed the limit {end}"
    )
    most = _bound(sampled.failed) / exposure
    words = f"the mean failure rate until then is {most:.2g} at most (95 %)"
    return [f"{few}: {words}; simulate for longer, or split"]


def _bound(events: int) -> float:
    """Upper bound, at 95 %, of the expected number of which ``events`` came (Poisson)."""
    return float(gammaincinv(events + 1.0, 0.95))
