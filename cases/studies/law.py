"""The law of sampling of one scheme: error by step and sample, and the cheapest of both."""

from dataclasses import dataclass
from math import sqrt

from cases.studies.levels import Level
from cases.studies.timing import Timing
from sim.montecarlo import LEAST_PATHS, MonteCarlo

ERRORS = tuple(10.0**-k for k in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0))
"""Errors for which the cheapest (dt, N) is given."""
MAX_PATHS = 2.0**20
BYTES_A_PATH = 48.0
"""State of a path: a few numbers of eight bytes; histograms are small beside it."""


@dataclass(frozen=True)
class Law:
    """Error of one scheme, L1 = A/√(paths x time) + B dtʳ, and seconds = c (paths x time)/dt.

    ``noise`` A, ``bias`` B with the ``order`` r of theory, ``bias_resolved`` False where B is an
    upper bound; ``step`` c in seconds; ``largest`` the largest stable step; ``relaxation`` the time
    that burn-in counts in.
    """

    scheme: str
    noise: float
    bias: float
    bias_resolved: bool
    order: int
    step: float
    largest: float
    relaxation: float

    def error(self, sampled: float, dt: float) -> float:
        """L1 error expected of ``sampled`` = paths x time at the step ``dt``."""
        return self.noise / sqrt(sampled) + self.bias * dt**self.order

    def cheapest(self, error: float) -> tuple[float, float]:
        """Return (dt, paths x time) that reach ``error`` in the least time.

        Minimising c W/dt under A/√W + B dtʳ = ε leaves the bias the share 1/(2r + 1) of ε.
        """
        r = self.order
        dt = self.largest
        if self.bias > 0.0:
            dt = min(dt, (error / ((2.0 * r + 1.0) * self.bias)) ** (1.0 / r))
        left = error - self.bias * dt**r
        return dt, (self.noise / left) ** 2

    def seconds(self, sampled: float, dt: float) -> float:
        """Return the time of a run on one thread, burn-in of the fewest paths included."""
        return self.step * (sampled + LEAST_PATHS * MonteCarlo.burn_in * self.relaxation) / dt

    def point(self, error: float) -> Level:
        """Return the cheapest settings for ``error`` with their price by the law, not run."""
        dt, sampled = self.cheapest(error)
        paths = max(float(LEAST_PATHS), min(sampled / self.relaxation, MAX_PATHS))
        timing = Timing(self.seconds(sampled, dt), 0.0, 0, 0.0, 0.0, paths * BYTES_A_PATH)
        return Level(
            f"{paths:.2g} paths, time {max(sampled / paths, dt):.2g}, dt {dt:.2g}",
            {"L1": error},
            error,
            timing,
            modelled=True,
        )
