"""Degrees of the Hermite polynomials and of the functions of y that stand with each of them."""

from dataclasses import dataclass
from math import ceil

from averaging.phase_space.equation.frame import Frame

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
    (``Space.counted``); ``outer`` the number of polynomials in y beyond the last stop.
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


def fitting(frame: Frame) -> Degrees:
    """Return the degrees of the solutions that a reference is fitted to."""
    if frame.system.damping_terms or frame.n == 1:
        return lowest(frame)
    return Degrees(13, 5, 14) if frame.n == 2 else Degrees(9, 3, 10)


def lowest(frame: Frame) -> Degrees:
    """Return the degrees of the first solution."""
    n, terms = frame.n, bool(frame.system.damping_terms)
    if n == 1:
        # Without terms damping and noise of one mass are in proportion: the start is the solution.
        return Degrees(16, 0, 18) if terms else Degrees(9, 0, 10)
    if n == 2:
        return Degrees(16, 6, 18) if terms else Degrees(17, 6, 18)
    return Degrees(11, 4, 12)


def finer(frame: Frame, degrees: Degrees, rise: int) -> Degrees:
    """Return the degrees of the next solution; ``rise`` is that of the degree in the others.

    The less that rises, the more N does, which then is what errors come from. N stays odd: the
    density of the contact displacement is nearer than with an even one beside it.

    Damping terms make all coordinates as unlike a Gaussian as a stop makes its mass: degrees in the
    others and in y rise with that in the velocity of the contact mass. Errors then oscillate with
    the degree, and more slowly the higher it is: steps that grow with it see that.
    """
    n, d = frame.n, degrees
    if frame.system.damping_terms:
        if n == 1:
            half = round(0.7 * d.total)
            return Degrees(2 * half, 0, 2 * half + 2)
        half = round(0.625 * d.total)
        return Degrees(2 * half, round(0.75 * half), half + 10)
    if n == 1:
        return Degrees(d.total + 8, 0, d.outer + 4)
    if n == 2:
        return Degrees(d.total + 10 - 2 * rise, d.others + rise, d.outer + 4)
    # The degree in the others is what errors of three masses come from.
    step = 1 if rise else 2
    return Degrees(d.total + 2 * step, d.others + min(rise, 1), d.outer + step)
