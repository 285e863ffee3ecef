"""Degrees of the Hermite polynomials and of the functions of y that stand with each of them."""

from dataclasses import dataclass
from math import ceil

LEAST = 0.5
"""Least number of polynomials beyond a stop at high levels of a high degree in the velocity of the
contact mass alone, as it is the stop that makes these, over the most."""
LEAST_MIXED = 0.3
"""Least number of them of any degrees, over the most."""
FEWER = 1.2
"""Polynomials beyond a stop that each degree in the other variables takes away."""


@dataclass(frozen=True)
class Degrees:
    """How fine an expansion is: highest level, degree in the amplitudes of the others, panels.

    ``total`` is the largest |k|, ``others`` the largest that a product of the other masses counts
    (``Others.counted``); ``outer`` the number of polynomials in y beyond the last stop.
    """

    total: int
    others: int
    outer: int

    def others_at(self, level: int) -> int:
        """Highest sum of the degrees in the others at a level.

        At the highest levels it falls by two a level: errors of densities stay as they are without
        these products of high degrees, and a fifth of the work is saved.
        """
        return min(level, 2 * self.others, 2 * (self.total - level))

    @property
    def least(self) -> int:
        """Least number of polynomials beyond a stop."""
        return int(LEAST_MIXED * self.outer)

    def beyond(self, level: int, others: int) -> int:
        """Number of polynomials beyond a stop, of |k| = ``level`` and a degree in the others.

        Motion turns degrees in y into those in velocities, so that what matters is their sum: the
        higher those of the velocities, the fewer polynomials. Levels go in pairs, as the
        derivatives of the functions of one are those of the next.
        """
        alone = max(self.outer - level // 2 * 2, int(LEAST * self.outer))
        return max(alone - int(FEWER * others), self.least)

    def between(self, width: float, *, beyond: bool) -> int:
        """Number of polynomials of a panel between stops, odd; one without end has ``outer`` + 1.

        ``width`` is in standard deviations of the weight without stops. ``beyond`` says that a stop
        is touched there, whose energy a narrow panel has, too: the number rises with ``outer``, so
        that what it leaves is seen in the distance of two solutions.
        """
        count = 6.0 + (0.12 * width + 0.25 * beyond) * self.outer
        return 2 * ceil(0.5 * min(count, self.outer)) + 1

    def fewer(self, most: int, beyond: int) -> int:
        """Number of polynomials of a panel between stops that goes with ``beyond``; odd.

        It falls half as fast: with fewer, errors were ten times larger between distant stops.
        """
        return 2 * int(0.25 * most * (1.0 + beyond / self.outer)) + 1
