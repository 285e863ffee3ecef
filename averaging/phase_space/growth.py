"""Degrees of the solutions of rising accuracy, so that all directions have like errors."""

import numpy as np

from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame

TOP_LEVELS = 4
"""Highest levels whose size is that of what the levels above them would have."""
LARGE, NEGLIGIBLE = 0.5, 0.2
"""Size of the highest degrees in the others, relative to that of the highest levels, from which the
degree in the others rises by a whole step, and below which it does not rise. On Fig. 6 with eight
other stops two degrees more in the others changed densities by 0.03 or less of what ten levels more
changed them by at sizes below 0.2, by 0.25 or less below 0.5, and by 0.07 to 4.6 beyond. The
size is small where a near stiff stop turns the contact mass round faster than the others move."""


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


def rise_of(e: Expansion) -> int:
    """Return by how much the degree in the others is to rise: 2, 1 or 0 where little is there."""
    edge = np.concatenate([o.counted for o in e.others]) == e.degrees.others
    others = float(np.sqrt(sum(np.sum(u[edge[: len(u)]] ** 2) for u in e.levels)))
    return sum(others > share * size_of_top(e) for share in (LARGE, NEGLIGIBLE))


def size_of_top(e: Expansion) -> float:
    """Return the size of the highest levels of a solution, of mass 1."""
    return float(np.sqrt(sum(float(np.sum(u**2)) for u in e.levels[-TOP_LEVELS:])))
