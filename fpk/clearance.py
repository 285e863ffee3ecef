"""Clearance against motion: when contacts may be left out, section 6.3."""

from dataclasses import dataclass

import numpy as np

from fpk.errors import NotApplicable
from fpk.linear import stationary_covariance
from fpk.system import System

CLEARANCE_RULE = 2.0
"""Section 6.3: contacts may be neglected beyond this many root mean squares of the motion."""


@dataclass(frozen=True)
class StopClearance:
    """One stop: its clearance in units of the motion that the mass would have without contact.

    ``mass`` counts from 1; ``rms`` and ``ratio`` are None where the motion has no stationary state.
    """

    mass: int
    side: str
    clearance: float
    rms: float | None
    ratio: float | None

    @property
    def beyond_rule(self) -> bool | None:
        """Whether the rule of section 6.3 lets this contact be neglected."""
        return None if self.ratio is None else self.ratio > CLEARANCE_RULE


def stop_clearances(system: System) -> tuple[StopClearance, ...]:
    """Return every stop with its clearance over the rms displacement of the linear system."""
    rms: list[float | None]
    try:
        covariance = stationary_covariance(system)
        rms = [float(np.sqrt(v)) for v in np.diag(covariance)[: system.n]]
    except NotApplicable:
        rms = [None] * system.n
    return tuple(
        StopClearance(
            mass=stop.mass,
            side=stop.side,
            clearance=stop.clearance,
            rms=scale,
            ratio=stop.clearance / scale if scale else None,
        )
        for stop in system.stops
        for scale in [rms[stop.index]]
    )
