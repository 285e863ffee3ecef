"""Inverse Laplace transforms of functions whose singularities lie on the negative real axis."""

from math import acosh, ceil, log, pi, sin
from typing import NamedTuple

import numpy as np

from fpk.numeric.arrays import EPS, Array, Complexes, Integers

SPREAD = 10.0
"""Largest ratio of the times that share one contour: 75 points, where one time has 46."""
PHI = 0.5
"""Inclination of the hyperbola. Faster converging ones (1.17) lie flat along the negative axis,
where the transform of what has drifted for a time t_0 grows as e^(−z t_0): that cancels to
less than a millionth where many masses start from rest."""
GROWTH = 6.0
"""z t where the contour crosses the real axis, times 1/(1 − sin φ): e^3.1 multiplies round-off."""


class Contour(NamedTuple):
    """Points ``z`` and ``factors`` e^(z t) w (times, points) for f(t) = Im Σ e^(z t) w F(z).

    The trapezoidal rule on the hyperbola z(θ) = μ (1 + sin(iθ − φ)) around the negative real axis,
    of which the half with Im z > 0 is enough: f is real. For errors of the rule and of where it
    ends see J. A. C. Weideman and L. N. Trefethen, Math. Comp. 76 (2007) 1341, section 4.
    ``places`` are the places of the times among those asked for.
    """

    places: Integers
    z: Complexes
    factors: Complexes


def contours(times: Array, *, more: int = 0) -> list[Contour]:
    """Return contours for ``times`` > 0 in any order, with ``more`` points than round-off asks.

    The rule errs by e^(μt − 2πφ/h), and ends where e^(z t) is round-off at the first time.
    """
    order, found, digits = np.argsort(times, kind="stable"), [], -log(EPS)
    while order.size:
        first = times[order[0]]
        together = order[times[order] <= SPREAD * first]
        order = order[together.size :]
        last = float(times[together[-1]])
        mu, reach = GROWTH / last, digits * last / float(first) + GROWTH
        step = 2.0 * pi * PHI / (GROWTH + digits)
        points = ceil(acosh(reach / (GROWTH * sin(PHI))) / step)
        step *= points / (points + more)
        theta = step * (np.arange(points + more) + 0.5)
        z = mu * (1.0 + np.sin(1j * theta - PHI))
        weights = step / pi * mu * 1j * np.cos(1j * theta - PHI)
        factors = np.exp(np.multiply.outer(times[together], z)) * weights
        found.append(Contour(together, z, factors))
    return found
