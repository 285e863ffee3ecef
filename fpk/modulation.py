"""Noise whose strength varies with time: e(t)² D."""

from dataclasses import dataclass

import numpy as np

from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable


@dataclass(frozen=True, eq=False)
class Modulation:
    """The factor e(t) on the noise: linear between ``times`` and constant after the last.

    ``times`` ascend from 0; ``factor`` >= 0 ends with 1, so that the ``noise_intensity`` of a
    system is that of the end and all that is stationary is what it is without modulation.

    Raises ``InvalidInput`` for anything else.
    """

    times: Array
    factor: Array

    def __post_init__(self) -> None:
        """Check both lists and keep them read-only."""
        for key in ("times", "factor"):
            try:
                array = np.array(getattr(self, key), dtype=float)
            except (TypeError, ValueError):
                array = np.array(np.nan)
            if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
                raise InvalidInput(key, getattr(self, key), "must be a list of finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        if self.times[0] != 0.0 or np.any(np.diff(self.times) <= 0.0):
            raise InvalidInput("times", self.times, "must begin with 0 and ascend")
        if self.factor.size != self.times.size:
            raise InvalidInput(
                "factor", self.factor, f"must have {self.times.size} entries, one per time"
            )
        if np.any(self.factor < 0.0):
            raise InvalidInput("factor", self.factor, "must not be negative")
        if self.factor[-1] != 1.0:
            remedy = "must end with 1; noise_intensity is that of the end"
            raise InvalidInput("factor", self.factor, remedy)

    def __call__(self, time: Array) -> Array:
        """Return e at times >= 0 of any shape."""
        return np.asarray(np.interp(time, self.times, self.factor))

    def energy(self, time: float) -> float:
        """Return ∫_0^time e² dt."""
        t = np.unique(np.append(self.times[self.times < time], time))
        e = self(t)
        # The mean of the square of a linear function.
        squares = (e[1:] ** 2 + e[1:] * e[:-1] + e[:-1] ** 2) / 3.0
        return float(np.diff(t) @ squares)


def require_constant_noise(modulation: Modulation | None) -> None:
    """Raise ``NotApplicable`` where there is a modulation: for methods of constant noise."""
    if modulation is not None:
        raise NotApplicable("the noise is modulated, which this route does not take into account")
