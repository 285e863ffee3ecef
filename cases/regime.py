"""Which theory fits a system: compatibility (8), clearance against motion, frequencies."""

from dataclasses import dataclass

import numpy as np

from fpk.errors import NotApplicable
from fpk.linear import natural_frequencies, stationary_covariance
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


@dataclass(frozen=True)
class Regime:
    """What decides between the theories; ``incompatible``: why (8) fails, None where it holds."""

    natural_frequencies: tuple[float, ...]
    incompatible: str | None
    stops: tuple[StopClearance, ...]

    @property
    def contacts_negligible(self) -> bool | None:
        """Whether every clearance exceeds twice the rms displacement, section 6.3."""
        known = [s.beyond_rule for s in self.stops]
        return None if None in known else all(known)


def regime_of(system: System, incompatible: str | None) -> Regime:
    """Return the regime of ``system``; ``incompatible`` is the refusal of the exact theory."""
    return Regime(
        natural_frequencies=tuple(float(w) for w in natural_frequencies(system)),
        incompatible=incompatible,
        stops=_stops(system),
    )


def _stops(system: System) -> tuple[StopClearance, ...]:
    rms: list[float | None]
    try:
        covariance = np.asarray(stationary_covariance(system))
        rms = [float(np.sqrt(v)) for v in np.diag(covariance)[: system.n]]
    except NotApplicable:
        rms = [None] * system.n
    return tuple(
        StopClearance(
            mass=stop.mass + 1,
            side=stop.side,
            clearance=stop.clearance,
            rms=scale,
            ratio=stop.clearance / scale if scale else None,
        )
        for stop in system.stops
        for scale in [rms[stop.mass]]
    )
