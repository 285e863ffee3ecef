"""Rates at which a displacement crosses levels, from the joint density of (q, p)."""

import numpy as np

from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import marginal
from fpk.arrays import Array
from fpk.observable import Coordinate
from fpk.quadrature import gauss_grid

AT_ONCE = 16
"""Levels that are treated at once: arrays are as large as this times all points of p and y."""
POINTS = 20
"""Gauss points of a panel of p, which is a standard deviation and more."""


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
