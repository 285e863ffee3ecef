"""Rates at which a displacement crosses levels, from the joint density of (q, p)."""

import numpy as np
from scipy.ndimage import maximum_filter1d

from averaging.phase_space.dynamics.answer import Answer, Compared, Options, adapted, deviations
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import marginal
from averaging.phase_space.refinement import Ladder
from fpk.arrays import Array
from fpk.method import Progress
from fpk.observable import Coordinate
from fpk.quadrature import gauss_grid

AT_ONCE = 16
"""Levels that are treated at once: arrays are as large as this times all points of p and y."""
POINTS = 20
"""Gauss points of a panel of p, which is a standard deviation and more."""
GRID, WINDOW = 181, 11
"""Levels between the ends of the support at which the distance of crossing rates is sampled, and
over how many of them its largest value is taken: it does not vanish where the error is not small.
"""


def crossings(frame: Frame, row: int, at: Array, options: Options) -> Answer:
    """Return the rates of upcrossing of the levels ``at``; their scale is σ_v/(2πσ_q).

    The distance is the largest one about a level. What flows past the level is added to the error.
    """
    q, p = (Coordinate("q", row),), (Coordinate("p", row),)

    def compare(ladder: Ladder, progress: Progress) -> Compared:
        (ends,), _ = marginal(frame, ladder.finest, q)
        grid = np.linspace(ends[0], ends[-1], GRID)
        (fine, net), (coarse, _) = (
            crossing_rates(frame, e, row, np.append(grid, at))
            for e in (ladder.finest, ladder.coarser)
        )
        distance = np.abs(fine - coarse)
        about = np.interp(at, grid, maximum_filter1d(distance[:GRID], WINDOW))
        sizes = deviations(frame, ladder.finest, row)
        return Compared(
            fine[GRID:],
            np.maximum(about, distance[GRID:]),
            np.array(sizes[1] / (2.0 * np.pi * sizes[0])),
            added=np.abs(net[GRID:]),
        )

    return adapted(frame, [q, p], compare, options)


def crossing_rates(frame: Frame, e: Expansion, row: int, at: Array) -> tuple[Array, Array]:
    """Return ∫_0^∞ v f(a, p) dp, v = p/m, at the levels a of ``at``, and ∫ v f(a, p) dp.

    The first is the rate of upcrossings (Rice); the second, all probability that flows past a
    level, vanishes in a stationary state, and is an error of the first.
    """
    axes, pdf = marginal(frame, e, (Coordinate("q", row), Coordinate("p", row)))
    _, [(p, w)] = gauss_grid([np.union1d(axes[1], 0.0)], points=POINTS)
    flux = w * p / frame.system.mass[row]
    up, net = np.zeros(at.size), np.zeros(at.size)
    for start in range(0, at.size, AT_ONCE):
        part = slice(start, start + AT_ONCE)
        density = pdf(at[part, None], p)
        up[part], net[part] = density @ np.maximum(flux, 0.0), density @ flux
    return up, net
