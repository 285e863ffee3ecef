"""Steps of motions in time, short enough to see what happens between two of them."""

from collections.abc import Iterator
from math import ceil, inf, pi

import numpy as np

from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable
from fpk.system import System, effects_of
from sim.montecarlo import MonteCarlo
from sim.motion.limits import Reach
from sim.schemes import SCHEMES
from sim.step_size import chosen_step, highest_frequency, stability_limit, step_for, temperature

STEPS_PER_PERIOD = 20
"""Steps, of the coarser of both simulations, in the shortest natural period."""

STEP_PER_DECAY = 0.2
"""Step, of the coarser simulation, in units of the fastest decay of a velocity."""

STEP_TO_LIMIT = 0.1
"""Step, of the coarser simulation, in units of ``time_to_limit`` t. q leaves the cubic between two
steps h by (√3/8) (h/t)^1.5 standard deviations at t, 0.7 % at this step: less than the sampling
error of 8192 trajectories."""

STEPS_SINCE_START = 8
"""Steps, of the coarser simulation, that have been made at least by a time that is asked for."""

TOO_LONG = 4.0
"""Steps of one's own, in units of the longest that is chosen, beyond which nothing is certified:
the difference from half of it may then be less than the error."""

STATIONARY = Reach()


def require_times(times: Array, *, least: float = 0.0) -> None:
    """Raise ``InvalidInput`` for times that do not ascend from ``least`` or later."""
    if (
        np.any(~np.isfinite(times))
        or np.any(np.diff(times, prepend=least - 1.0) <= 0.0)
        or np.any(times < least)
    ):
        raise InvalidInput("times", times, f"must be finite, ascend, and be {least:g} or later")


def needs_steps(system: System) -> bool:
    """Return whether the step has an error at all: without contact and terms it is exact."""
    effects = effects_of(system)
    return effects.contact or effects.state_damping


def longest_step(system: System, reach: Reach = STATIONARY) -> float:
    """Return the step in which velocities change little enough to see what is between two steps."""
    period = 2.0 * pi / highest_frequency(system)
    decay = float(np.max(np.abs(np.linalg.eigvals(system.damping / system.mass))))
    return min(
        period / STEPS_PER_PERIOD,
        STEP_PER_DECAY / decay if decay > 0.0 else inf,
        STEP_TO_LIMIT * reach.limit,
        chosen_step(system, energy=reach.energy, kT=reach.kT),
    )


def motion_step(
    method: MonteCarlo,
    system: System,
    reach: Reach = STATIONARY,
    *,
    error: float | None = None,
    too_long: float = TOO_LONG,
) -> tuple[float, list[str]]:
    """Return the longer of the steps of a motion within ``reach``, and why it is not certified.

    ``error`` is as of ``step_for``. Words are there for a step of one's own that is ``too_long``.

    Raises ``InvalidInput`` for a step that is unstable, and for another scheme than exact_flow,
    which alone can repeat a motion at half the step.
    """
    if method.scheme != "exact_flow":
        raise InvalidInput("scheme", method.scheme, "motions in time take exact_flow")
    if method.checkpoint is not None:
        raise InvalidInput("checkpoint", method.checkpoint, "motions in time save no state")
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: the motion is not random")
    kT, energy = temperature(system) if reach.kT is None else reach.kT, reach.energy
    kT = kT if kT < inf else 2.0 * energy  # of undamped motion up to the limit
    longest, error = longest_step(system, reach), error or method.paths**-0.5
    dt = method.dt or method.step_factor * min(longest, step_for(system, error, kT=kT))
    limit = stability_limit(system, SCHEMES[method.scheme], energy=energy, kT=kT)
    if not 0.0 < dt < limit and not method.allow_unstable:
        remedy = f"must be > 0 and below the stability limit {limit:.4g} of {method.scheme}"
        raise InvalidInput("dt", dt, remedy)
    words = f"between steps as long as dt = {dt:g} not all is seen; use {longest:.2g}"
    return dt, [words] if dt > too_long * longest else []


def first_step(dt: float, times: Array, start: float = inf, factor: float = 1.0) -> float:
    """Return the step up to ``dt`` that is short beside ``times`` > 0 and ``Reach.start``."""
    asked = float(np.min(times[times > 0.0], initial=inf)) / STEPS_SINCE_START
    return min(dt, factor * min(asked, STEP_TO_LIMIT * start))


def stages(first: float, dt: float, end: float, *, most: int) -> Iterator[tuple[float, int]]:
    """Yield steps, and how many of each, ``most`` at once, that lead from time 0 to ``end``.

    They begin with ``first`` and double up to ``dt`` where they stay below the time since the start
    over ``STEPS_SINCE_START``: a motion is seen at any time by steps that are short beside it.
    """
    now, step = 0.0, first
    while now < end * (1.0 - 1e-12):
        until = min(2.0 * STEPS_SINCE_START * step, end) if step < dt else end
        left = max(1, ceil((until - now) / step * (1.0 - 1e-12)))
        now += left * step
        for done in range(0, left, most):
            yield step, min(most, left - done)
        step = min(2.0 * step, dt)
