"""Steps of motions in time, short enough to see what happens between two of them."""

from dataclasses import replace
from math import inf, pi

import numpy as np

from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable
from fpk.system import System
from sim.montecarlo import MonteCarlo
from sim.schemes import SCHEMES
from sim.step_size import chosen_step, highest_frequency, stability_limit, step_for

STEPS_PER_PERIOD = 20
"""Steps, of the coarser of both simulations, in the shortest natural period."""

STEP_PER_DECAY = 0.2
"""Step, of the coarser simulation, in units of the fastest decay of a velocity."""


def require_times(times: Array, *, least: float = 0.0) -> None:
    """Raise ``InvalidInput`` for times that do not ascend from ``least`` or later."""
    if (
        np.any(~np.isfinite(times))
        or np.any(np.diff(times, prepend=least - 1.0) <= 0.0)
        or np.any(times < least)
    ):
        raise InvalidInput("times", times, f"must be finite, ascend, and be {least:g} or later")


def loudest(system: System) -> System:
    """Return the system under constant noise, as strong as its modulation makes it at the most."""
    if system.modulation is None:
        return system
    most = system.modulation.largest * system.noise_intensity
    return replace(system, noise_intensity=most, modulation=None)


def longest_step(system: System) -> float:
    """Return the step in which velocities change little enough to see what is between two steps."""
    period = 2.0 * pi / highest_frequency(system)
    decay = float(np.max(np.abs(np.linalg.eigvals(system.damping / system.mass))))
    return min(period / STEPS_PER_PERIOD, STEP_PER_DECAY / decay if decay > 0.0 else inf)


def motion_step(
    method: MonteCarlo, system: System, *, energy: float = 0.0, error: float | None = None
) -> float:
    """Return the longer of the steps of a motion up to ``energy``; ``error`` as of ``step_for``.

    Raises ``InvalidInput`` for a step that is unstable, and for another scheme than exact_flow,
    which alone can repeat a motion at half the step.
    """
    if method.scheme != "exact_flow":
        raise InvalidInput("scheme", method.scheme, "motions in time take exact_flow")
    if method.checkpoint is not None:
        raise InvalidInput("checkpoint", method.checkpoint, "motions in time save no state")
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: the motion is not random")
    dt = method.dt or method.step_factor * min(
        longest_step(system),
        chosen_step(system, energy=energy),
        step_for(system, error or method.paths**-0.5),
    )
    limit = stability_limit(system, SCHEMES[method.scheme], energy=energy)
    if not 0.0 < dt < limit and not method.allow_unstable:
        remedy = f"must be > 0 and below the stability limit 2/ω = {limit:.4g} of {method.scheme}"
        raise InvalidInput("dt", dt, remedy)
    return dt
